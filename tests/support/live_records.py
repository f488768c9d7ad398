"""Records of the simulated rig as files, and a feed that plays what a test writes down."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from classic_ml.readers import TestDescription, read_raw, read_test_description
from classic_ml.readers.series_files import write_series
from classic_ml.reduction import reduce_record
from comparisons.live.display import Display
from comparisons.live.ending import Result, reduce_pieces
from comparisons.live.feed import Arrival, Closed, Data, Feed, Opened
from comparisons.live.latency import LatencyMeter
from comparisons.live.running_estimate import Estimator, NoEstimate
from comparisons.live.session import Session
from comparisons.live.session_parts import SessionParts
from comparisons.live.state import Event
from comparisons.live.text_lines import TextDecoder
from comparisons.rig import simulate, write_run


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
    def content(self) -> bytes:
        return self.raw.read_bytes()

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(self.content.split(b"\n", 1)[0].decode().split(","))

    @cached_property
    def values(self) -> np.ndarray:
        return np.loadtxt(self.raw, delimiter=",", skiprows=1)

    @cached_property
    def lines(self) -> list[bytes]:
        """The rows, with their line ends."""
        return self.content.splitlines(keepends=True)[1:]

    @property
    def header(self) -> bytes:
        return self.content.splitlines(keepends=True)[0]

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


class PlayedFeed(Feed):
    """Arrivals from a list; numbers stand for seconds of silence."""

    def __init__(self, arrivals: Iterable[Arrival | bytes | float], ends: bool = True) -> None:
        super().__init__()
        self._play = iter(arrivals)
        self._ends = ends
        self._quiet_until_s = 0.0

    @property
    def waiting(self) -> str:
        return "waiting for the play"

    def _run(self) -> None:
        return

    def next(self, timeout_s: float) -> Arrival | None:
        quiet_s = self._quiet_until_s - time.monotonic()
        if quiet_s > 0.0:
            time.sleep(min(timeout_s, quiet_s))
            return None
        item = next(self._play, None)
        if isinstance(item, bytes):
            return Data(item, time.monotonic())
        if isinstance(item, float):
            self._quiet_until_s = time.monotonic() + item
            return None
        if item is None:
            return Closed("the end of the play", for_good=True) if self._ends else None
        return item


@dataclass
class Played:
    """A session that was played to its end."""

    session: Session
    events: list[Event]
    out: Path
    meter: LatencyMeter
    record: LiveRecord

    @property
    def told(self) -> str:
        return "\n".join(event.text for event in self.events)

    def results(self) -> list[Result]:
        return reduce_pieces(self.session, self.record.test_path, self.out)


def play(
    record: LiveRecord,
    folder: Path,
    arrivals: Iterable[Arrival | bytes | float],
    *,
    screens: Sequence = (),
    budget_s: float = 0.2,
    estimator: Estimator | None = None,
    decoder: type = TextDecoder,
    timeout_s: float = 30.0,
    ends: bool = True,
    begun: Callable[[Session], object] = lambda session: None,
) -> Played:
    events: list[Event] = []
    meter = LatencyMeter(budget_s)
    display = Display(screens, meter)
    session = Session(
        SessionParts(
            record.test,
            PlayedFeed([Opened(), *arrivals], ends),
            decoder,
            folder / "spool.csv",
            NoEstimate() if estimator is None else estimator,
            display,
            meter,
            events.append,
            timeout_s,
        )
    )
    begun(session)
    try:
        session.run()
    finally:
        display.close()
    return Played(session, events, folder / "series.csv", meter, record)


def cut(content: bytes, rng: np.random.Generator, mean: float = 700.0) -> list[bytes]:
    """Cut bytes anywhere, in pieces of about so many."""
    n_cuts = int(len(content) / mean)
    places = np.sort(rng.integers(0, len(content) + 1, n_cuts)).tolist()
    return [content[a:b] for a, b in zip([0, *places], [*places, len(content)], strict=True)]
