"""Long work shows how far it is on a terminal, and is silent where stderr is none."""

from __future__ import annotations

import io
import sys

import pytest

from surge_core.progress import shown_count, shown_over, shown_steps


def put(patch: pytest.MonkeyPatch, stream: io.StringIO) -> io.StringIO:
    """Put a stream in the place of stderr, once pytest has put its own there."""
    patch.setattr(sys, "stderr", stream)
    return stream


def work() -> list[str]:
    """Run one of each bar."""
    with shown_steps(2) as begin:
        begin("reading")
        begin("fitting")
    with shown_count("counting", unit="row", total=3) as count:
        count()
        count(2)
    return list(shown_over(iter("abc"), unit="letter", words="spelling"))


def test_nothing_is_drawn_into_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = put(monkeypatch, io.StringIO())
    assert work() == ["a", "b", "c"]
    assert pipe.getvalue() == ""
