"""Records of the simulated rig as files, and feeds that play what a test writes down."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from classic_ml import write_series
from classic_ml.readers import TestDescription, read_raw, read_test_description
from classic_ml.reduction import ReductionSettings, reduce_record
from comparisons.live.feeds import Arrival, Closed, Feed, Opened
from comparisons.live.monitor import Monitor
from comparisons.live.pieces import Pieces, Result, reduce_pieces
from comparisons.live.session import Session
from comparisons.live.state import Event
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
    def names(self) -> list[str]:
        return self.header.decode().strip().split(",")

    @cached_property
    def lines(self) -> list[bytes]:
        """The rows, with their line ends."""
        return self.raw.read_bytes().splitlines(keepends=True)[1:]

    @cached_property
    def header(self) -> bytes:
        return self.raw.read_bytes().splitlines(keepends=True)[0]

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


def cut(data: bytes, seed: int, mean: int) -> list[bytes]:
    """Cut bytes anywhere, as a network does."""
    rng = np.random.default_rng(seed)
    places = np.unique(np.cumsum(rng.integers(1, 2 * mean, len(data) // mean + 1)))
    edges = [0, *places[places < len(data)].tolist(), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


@dataclass
class Played:
    """A session that was played to its end."""

    session: Session
    record: LiveRecord
    folder: Path
    events: list[Event]

    @property
    def said(self) -> str:
        return "\n".join(event.text for event in self.events)

    @property
    def out(self) -> Path:
        return self.folder / "live.csv"

    def results(self) -> list[Result]:
        return reduce_pieces(
            self.session.pieces.pieces,
            self.record.test_path,
            self.out,
            ReductionSettings(),
            self.session.entry(),
        )


def play(
    record: LiveRecord, folder: Path, arrivals: Iterable[Arrival], *, comes_back: bool = True
) -> Played:
    """Run a session over arrivals; the first connection is opened, and the last closed, here."""

    def read(feed: Feed) -> None:
        for arrival in (Opened(), *arrivals, END):
            feed.put(arrival)

    scratch = folder / "scratch"
    scratch.mkdir(parents=True)
    events: list[Event] = []
    session = Session(
        record.test,
        Feed("waiting for the play", read, comes_back),
        Pieces(folder / "live.raw.csv"),
        Monitor(record.test, ReductionSettings(), scratch, estimates=False),
        tell=events.append,
    )
    session.run()
    return Played(session, record, folder, events)
