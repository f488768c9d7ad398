"""Records of the simulated rig as files, and feeds that play what a test writes down."""

from __future__ import annotations

import math
import queue
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from classic_ml.io import TestDescription, read_raw, read_test_description
from classic_ml.io.series import write_series
from classic_ml.reduction import Reduction, reduce_record
from classic_ml.reduction_settings import ReductionSettings
from comparisons.live.feeds import Arrival, Closed, Feed, Opened
from comparisons.live.monitor import Monitor
from comparisons.live.pieces import Piece, Pieces, reduce_longest
from comparisons.live.session import Session
from comparisons.rig import simulate, write_run

END = Closed("the end of the play", for_good=True)


@dataclass(frozen=True)
class LiveRecord:
    """A raw record on disk, its rows, and what `reduce` makes of it."""

    folder: Path

    @property
    def raw(self) -> Path:
        return self.folder / "raw.csv"

    @property
    def test_path(self) -> Path:
        return self.folder / "test.toml"

    @cached_property
    def test(self) -> TestDescription:
        return read_test_description(self.test_path)

    @cached_property
    def rows(self) -> list[bytes]:
        """The header and the rows, without their line ends."""
        return self.raw.read_bytes().splitlines()

    @cached_property
    def series(self) -> bytes:
        """The series file that the reduction of the whole file gives."""
        return series_of(self.raw, self.test_path)


def series_of(raw: Path, test: Path) -> bytes:
    out = raw.with_name(f"{raw.stem}-reduced.csv")
    write_series(reduce_record(*read_raw(raw, test)).series, out)
    return out.read_bytes()


def made_record(folder: Path, case: str = "985", seed: int = 0, seconds: float = 3.0) -> LiveRecord:
    write_run(simulate(case, seed=seed, duration_s=seconds), folder)
    return LiveRecord(folder)


def changed(record: LiveRecord, folder: Path, old: str, new: str) -> LiveRecord:
    """Return a record with another description."""
    folder.mkdir()
    text = record.test_path.read_text("utf-8")
    assert text.count(old) == 1
    (folder / "test.toml").write_text(text.replace(old, new), "utf-8")
    (folder / "raw.csv").write_bytes(record.raw.read_bytes())
    return LiveRecord(folder)


class Played:
    """A session that is played to its end, and what it said."""

    def __init__(self, record: LiveRecord, folder: Path, feed: Feed, timeout_s: float) -> None:
        self.record, self.out = record, folder / "live.csv"
        self.said, self.feed_words = "", set[str]()
        folder.mkdir(exist_ok=True)
        self.monitor = Monitor(record.test, ReductionSettings(), folder)
        self.pieces = Pieces(folder / "live.raw.csv")
        test = record.test
        self.session = Session(test, feed, self.pieces, self.monitor, [self], timeout_s)
        self.session.run()

    def say(self, event: str) -> None:
        self.said += event + "\n"

    def show(self, document: dict[str, Any]) -> None:
        self.feed_words.add(document["fields"][0]["value"])

    def reduce(self) -> tuple[Piece, Reduction]:
        piece, reduction = reduce_longest(
            self.pieces.pieces, self.record.test_path, ReductionSettings(), self.session.entry()
        )
        write_series(reduction.series, self.out)
        return piece, reduction


def play(
    record: LiveRecord,
    folder: Path,
    *arrivals: Arrival,
    comes_back: bool = True,
    end: bool = True,
    timeout_s: float = math.inf,
) -> Played:
    """Run a session over arrivals; the first connection is opened, and the last closed, here."""
    feed = Feed("waiting for the play", lambda feed: None, comes_back)
    feed.arrivals = queue.Queue()
    for arrival in (Opened(), *arrivals, *([END] if end else [])):
        feed.arrivals.put(arrival)
    return Played(record, folder, feed, timeout_s)
