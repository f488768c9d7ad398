"""What is in a file of channels, and what it is to a test.toml."""

from __future__ import annotations

from classic_ml.inspect.draft import draft_test_toml
from classic_ml.inspect.facts import (
    ChannelFacts,
    ChannelMatch,
    ClockFacts,
    Inspection,
    TestMatch,
    inspect_file,
    match_test,
)

__all__ = [
    "ChannelFacts",
    "ChannelMatch",
    "ClockFacts",
    "Inspection",
    "TestMatch",
    "draft_test_toml",
    "inspect_file",
    "match_test",
]
