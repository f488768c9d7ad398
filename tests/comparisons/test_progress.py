"""Long work shows how far it is on a terminal, and is silent where stderr is none."""

from __future__ import annotations

import io
import sys

import pytest
<<<<<<< HEAD
from comparison_data import made_series
from comparisons.cli.progress import shown_count, shown_over, shown_steps
from raw_data import make_test

from classic_ml.readers.series_files import write_series
from comparisons.cli import main
from comparisons.rig import SensorSettings, simulate, write_run

pty = pytest.importorskip("pty", reason="no pseudo-terminals here")
termios = pytest.importorskip("termios", reason="no pseudo-terminals here")
=======

from surge_core.progress import shown_count, shown_over, shown_steps
>>>>>>> show


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


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


def test_bars_are_drawn_on_a_terminal_and_taken_away(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = put(monkeypatch, Terminal())
    assert work() == ["a", "b", "c"]
    for words in ("reading", "counting", "spelling"):
        assert words in terminal.getvalue()
    assert terminal.getvalue().rsplit("\r", 1)[1].strip() == ""


def test_nothing_is_drawn_into_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = put(monkeypatch, io.StringIO())
    assert work() == ["a", "b", "c"]
    assert pipe.getvalue() == ""


def test_the_stages_of_the_demo_are_lines_in_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = put(monkeypatch, io.StringIO())
    with shown_steps(2, lines=True) as begin:
        begin("reading")
        assert pipe.getvalue() == "[1/2] reading\n"
        begin("fitting")
    assert pipe.getvalue() == "[1/2] reading\n[2/2] fitting\n"


def test_a_bar_goes_away_when_the_work_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = put(monkeypatch, Terminal())

    def fail() -> None:
        with shown_steps(3) as begin:
            begin("that fails")
            raise RuntimeError("no")

    with pytest.raises(RuntimeError):
        fail()
    assert terminal.getvalue().rsplit("\r", 1)[1].strip() == ""
