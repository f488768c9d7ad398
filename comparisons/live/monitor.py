"""From rows in order to what is known of the machine, batch by batch."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pandas as pd

from classic_ml.io import TestDescription, read_raw
from classic_ml.records import Record
from classic_ml.reduction import near_stall_shifts
from classic_ml.reduction_settings import ReductionSettings
from comparisons.live.detection import Sighting, SurgeDetector
from comparisons.live.estimate import Estimate, estimate_of
from comparisons.live.operating_point import SETTLED_S, points_of
from surge_core.errors import InputError

# What the feed is called in messages.
FEED = "the feed"
# What the map shows: six seconds, at most 200 points a second.
TRAIL_S, TRAIL_HZ = 6.0, 200.0
# What the provisional estimate is made of: the last half minute.
WINDOW_S = 30.0
# Fewer rows no reader takes for a record.
LEAST_ROWS = 100


class Monitor:
    """Follow the machine: operating point, stall and surge, running estimate.

    Rows are read like files, from a folder of their own (``scratch``).
    """

    def __init__(self, test: TestDescription, settings: ReductionSettings, scratch: Path) -> None:
        rate_hz = test.sample_rate_hz
        self._test, self._settings, self._scratch = test, settings, scratch
        self._worker = ThreadPoolExecutor(1, "estimate")
        self._future: Future[Estimate] | None = None
        self._wanted = False
        self._recent: deque[bytes] = deque(maxlen=max(6 * LEAST_ROWS, round(WINDOW_S * rate_hz)))
        self._batch = max(LEAST_ROWS, round(rate_hz))
        self._before = max(LEAST_ROWS, round(SETTLED_S * rate_hz))
        self._stride = max(1, round(rate_hz / TRAIL_HZ))
        # Whether rows of this feed could be read at all.
        self._read = False
        self._problem = ""
        self._is_matched = bool(test.near_stall_shifts)
        self.detector = SurgeDetector(test)
        # Time, φ and ψ' of the last seconds, thinned out.
        self.trail: deque[tuple[float, ...]] = deque(maxlen=round(TRAIL_S * rate_hz / self._stride))
        self.head = b""  # Header and units of the rows
        self.point: dict[str, float] = {}  # The newest operating point
        self.estimate: Estimate | None = None  # The newest one
        self.restart()

    def restart(self) -> None:
        """Begin again behind a gap; what was found so far stays."""
        self._recent.clear()
        self.detector.restart()
        # Rows of this piece, and those whose operating point is known.
        self._n_rows = self._n_points = 0

    def take(self, lines: Sequence[bytes]) -> list[str]:
        """Take rows, without their line ends, that follow on those before.

        The next `update` looks at them; what is returned was shown by rows beyond those that are
        looked at together.
        """
        notes: list[str] = []
        for start in range(0, len(lines), self._batch):
            some = lines[start : start + self._batch]
            self._recent.extend(some)
            self._n_rows += len(some)
            if self._n_rows - self._n_points > self._batch:
                notes += self.update()
        return notes

    def update(self) -> list[str]:
        """Look at the rows that have come since; return a sentence on each thing worth saying.

        The first rows of all must be such as can be read.
        """
        if self._n_rows < LEAST_ROWS or self._n_rows - self._n_points < 2:
            return []
        n = min(len(self._recent), self._n_rows - self._n_points + self._before)
        notes: list[str] = []
        try:
            record = self._record(list(islice(self._recent, len(self._recent) - n, None)))
            self._read = True
            notes += self._matched(record)
            points = points_of(record, self._test, self._n_points - (self._n_rows - n))
            self._problem = ""
        except InputError as error:
            if not self._read:
                raise
            if not self._problem:
                notes.append(f"no operating point: {error}")
            self._problem = str(error)
        else:
            for sighting in self.detector.take(points):
                notes.append(_said(sighting))
                self._wanted = self._wanted or sighting.kind == "cycle"
            self._remember(points)
        self._n_points = self._n_rows - 1
        return notes

    def poll(self) -> list[str]:
        """Look for a new running estimate, and begin the next one behind a cycle."""
        notes: list[str] = []
        if self._future is not None and self._future.done():
            notes = self._estimated(self._future.result())
            self._future = None
        if self._wanted and self._future is None:
            self._wanted = False
            # Read here: the rows change, and the scratch file is one.
            try:
                record = self._record(list(self._recent))
            except InputError as error:
                return notes + self._estimated(Estimate(str(error)))
            self._future = self._worker.submit(estimate_of, record, self._test, self._settings)
        return notes

    def close(self) -> list[str]:
        """End the estimates; return what the last one showed."""
        self._wanted = False
        self._worker.shutdown()
        return self.poll()

    @property
    def machine(self) -> str:
        """``"surge"``, ``"in stall"``, ``"stable"`` or ``"not known"``."""
        if not self.point:
            return "not known"
        if self.detector.surging:
            return "surge"
        return "in stall" if self.detector.in_stall else "stable"

    def _record(self, lines: list[bytes]) -> Record:
        """Return the last rows of this piece as the record that they are read as from a file."""
        file = self._scratch / "rows.csv"
        file.write_bytes(self.head + b"\n".join(lines) + b"\n")
        try:
            record, _ = read_raw(file, self._test)
        except InputError as error:
            where = error.where.replace(str(file), FEED)
            raise InputError(
                where, expected=error.expected, found=error.found, remedy=error.remedy
            ) from None
        return replace(record, source=FEED)

    def _matched(self, newest: Record) -> list[str]:
        """Match at near stall once the reading of the facility has passed."""
        reading, rate_hz = self._test.near_stall, self._test.sample_rate_hz
        last_s = newest.time_at_s(newest.n_samples - 1)
        if self._is_matched or last_s < reading.to_s + 0.5 / rate_hz:
            return []
        # Once, whether it can be matched or not.
        self._is_matched = True
        try:
            shifts = near_stall_shifts(self._record(list(self._recent)), self._test)
        except InputError as error:
            return [f"the near-stall match failed: {error}"]
        self._test = replace(self._test, near_stall_shifts=shifts)
        return ["matched to the near-stall reading of the facility"]

    def _remember(self, points: pd.DataFrame) -> None:
        if points.empty:
            return
        self.point = {str(name): float(value) for name, value in points.iloc[-1].items()}
        kept = points[["time_s", "phi", "psi_p"]][-self._n_points % self._stride :: self._stride]
        self.trail.extend(map(tuple, kept.to_numpy().tolist()))

    def _estimated(self, estimate: Estimate) -> list[str]:
        known = self.estimate is not None and not self.estimate.why_not
        if known and estimate.why_not:
            # The estimate before it stays.
            return []
        self.estimate = estimate
        return [] if known or estimate.why_not else [f"first estimate of τ: {estimate.words}"]


def _said(sighting: Sighting) -> str:
    late = f", reported {1e3 * (sighting.seen_s - sighting.at_s):.0f} ms later"
    if sighting.kind == "surge":
        return f"surge: the flow runs backwards from {sighting.at_s:.3f} s on{late}"
    if sighting.kind == "cycle":
        return (
            f"cycle {sighting.number} ended at {sighting.at_s:.3f} s{late}; period "
            f"{1e3 * sighting.period_s:.0f} ms, {1.0 / sighting.period_s:.2f} Hz"
        )
    if sighting.kind == "stall":
        return f"in stall from {sighting.at_s:.3f} s on{late}"
    return f"the surge is over: the flow last ran backwards at {sighting.at_s:.3f} s"
