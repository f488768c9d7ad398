"""What is in a file of channels, and what it is to a test.toml."""

from __future__ import annotations

from classic_ml.inspect.draft import draft_test_toml
from classic_ml.inspect.facts import ChannelFacts, ClockFacts, Inspection, inspect_file
from classic_ml.inspect.match import ChannelMatch, TestMatch, match_test

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
