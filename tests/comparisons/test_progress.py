"""Long work shows how far it is on a terminal, and is silent where stderr is none."""

from __future__ import annotations

import io
import os
import re
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from comparison_data import made_series
from comparisons.cli.progress import shown_count, shown_over, shown_steps
from raw_data import make_test

from classic_ml.readers.series_files import write_series
from comparisons.cli import main
from comparisons.rig import SensorSettings, simulate, write_run

pty = pytest.importorskip("pty", reason="no pseudo-terminals here")
termios = pytest.importorskip("termios", reason="no pseudo-terminals here")


class Terminal:
    """What was written to a pseudo-terminal."""

    def __init__(self) -> None:
        self.text = ""


@contextmanager
def terminal(patch: pytest.MonkeyPatch, size: tuple[int, int] = (24, 100)) -> Iterator[Terminal]:
    """Put a pseudo-terminal in the place of stderr, and read what is written to it."""
    seen = Terminal()
    master, slave = pty.openpty()
    termios.tcsetwinsize(slave, size)
    pieces: list[bytes] = []

    def read() -> None:
        while True:
            try:
                piece = os.read(master, 65536)
            except OSError:
                return
            if not piece:
                return
            pieces.append(piece)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    with os.fdopen(slave, "w", encoding="utf-8") as stream, patch.context() as inner:
        inner.setattr(sys, "stderr", stream)
        assert sys.stderr.isatty()
        yield seen
    reader.join(5.0)
    os.close(master)
    seen.text = b"".join(pieces).decode("utf-8", "replace")


STUDY = """
seeds = 3
scores = ["tau_error_ms"]
[record]
duration_s = 4.0
[[method]]
name = "classic_ml_arx"
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("series")
    write_series(made_series(n=900, n_segments=3), folder / "series.csv")
    make_test(seconds=2.0, cells_lbm_s=6.0, noise_counts=1.0).write(folder)
    write_run(simulate("90", duration_s=2.0, sensors=SensorSettings.ideal()), folder / "rig")
    (folder / "study.toml").write_text(STUDY, "utf-8")
    return folder


def arguments(folder: Path, command: str) -> list[str]:
    series = str(folder / "series.csv")
    raw, test = str(folder / "raw.csv"), str(folder / "test.toml")
    rig = folder / "rig"
    study = Path(tempfile.mkdtemp(dir=folder)) / "study"
    return {
        "inspect": ["inspect", raw, "--test", test],
        "reduce": ["reduce", raw, "--test", test, "-o", str(folder / "reduced.csv")],
        "compare": ["compare", series],
        "orders": ["orders", series, "--degrees", "1", "2", "--lags", "0"],
        "structure": ["structure", series, "--bootstrap", "0", "--max-terms", "3"],
        "diagnose": ["diagnose", series, "--max-effects", "1"],
        "study": ["study", str(folder / "study.toml"), "--out", str(study), "--jobs", "1"],
        "total-system": ["total-system", str(rig / "raw.csv"), "--test", str(rig / "test.toml")],
    }[command]


# What each bar says, and how many steps it counts.
BARS = {
    "inspect": (r"\d/3", "reducing it"),
    "reduce": (r"\d/6", "reading"),
    "compare": (r"\d/\d", "fit"),
    "orders": (r"\d/8", "model"),
    "structure": (r"\d/3", "choosing terms"),
    "diagnose": (r"\d/4", "trying effects"),
    "study": (r"\d/3", "cell"),
    "total-system": (r"\d step", "fitting"),
}


@pytest.mark.parametrize("command", BARS)
def test_a_bar_is_drawn_on_a_terminal_and_taken_away(
    files: Path, command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    counted, words = BARS[command]
    with terminal(monkeypatch) as seen:
        assert main(arguments(files, command)) == 0
    assert re.search(counted, seen.text)
    assert words in seen.text
    # The last thing that happens to the line is that it is cleared.
    assert seen.text.endswith("\r")
    assert "|" not in seen.text.rsplit("\r", 2)[-2].strip()
    # What the command has to say is not mixed with it.
    assert "\r" not in capsys.readouterr().out


@pytest.mark.parametrize("command", ["inspect", "reduce", "orders"])
def test_a_bar_is_drawn_on_a_terminal_that_says_nothing_of_its_size(
    files: Path, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with terminal(monkeypatch, (0, 0)) as seen:
        assert main(arguments(files, command)) == 0
    assert re.search(BARS[command][0], seen.text)


@pytest.mark.parametrize("command", BARS)
def test_nothing_is_drawn_where_stderr_is_a_pipe(
    files: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments(files, command)) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out


def test_the_search_for_breakpoints_of_the_work_characteristic_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from comparisons.cli.work import fit_work

    record, test = make_test(cells_lbm_s=8.0, noise_counts=1.5).load()
    counted: list[object] = []

    def count(items: object) -> Iterator[object]:
        for item in items:  # type: ignore[attr-defined]
            counted.append(item)
            yield item

    quiet = fit_work(record, test)
    told = fit_work(record, test, progress=count)
    assert len(counted) > 3
    assert told.breakpoints == quiet.breakpoints


@pytest.mark.parametrize("total", [None, 3])
def test_an_iteration_is_counted_and_gives_what_it_was_given(
    monkeypatch: pytest.MonkeyPatch, total: int | None
) -> None:
    with terminal(monkeypatch) as seen:
        given = list(shown_over(iter("abc"), unit="letter", words="reading", total=total))
    assert given == ["a", "b", "c"]
    assert "reading" in seen.text
    assert "0/3" in seen.text
    assert "letter" in seen.text


def test_what_was_finished_before_tells_nothing_of_the_time_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from comparisons.cli import progress

    monkeypatch.setattr(progress, "_TICK_S", 0.01)
    million = 10**6
    with (
        terminal(monkeypatch) as seen,
        shown_count("counting", unit="cell", total=2 * million, resumed=True) as counted,
    ):
        counted(million)
        threading.Event().wait(0.2)
        counted(1)
        threading.Event().wait(0.1)
    assert "1000001/2000000" in seen.text
    # One cell took 0.2 s or more.
    rates = [float(rate) for rate in re.findall(r"([\d.]+)cell/s", seen.text)]
    assert rates
    assert max(rates) <= 5.0


def test_a_count_whose_end_is_not_known_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    with terminal(monkeypatch) as seen, shown_count("fitting", unit=" step") as counted:
        threading.Event().wait(0.15)
        counted()
    assert "1 step" in seen.text


def test_a_clock_goes_on_while_a_step_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    from comparisons.cli import progress

    monkeypatch.setattr(progress, "_TICK_S", 0.01)
    before = threading.active_count()
    with terminal(monkeypatch) as seen, shown_steps(2) as begin:
        begin("one long step")
        threading.Event().wait(0.3)
    assert seen.text.count("one long step") > 3
    assert threading.active_count() == before


@pytest.mark.parametrize("fails", [lambda: list(shown_over([1, 2])), lambda: None])
def test_a_stream_that_is_no_terminal_stays_empty(
    monkeypatch: pytest.MonkeyPatch, fails: Callable[[], object]
) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    fails()
    with shown_steps(3) as begin:
        begin("one")
        begin("two")
    assert stream.getvalue() == ""


def test_a_bar_goes_away_when_the_work_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    def work() -> None:
        with shown_steps(3) as begin:
            begin("that fails")
            raise RuntimeError("no")

    with terminal(monkeypatch) as seen, pytest.raises(RuntimeError):
        work()
    assert "that fails" in seen.text
    assert seen.text.endswith("\r")
