"""From rows in order to what is known of the machine, batch by batch."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from classic_ml.readers import TestDescription
from classic_ml.records import Record
from classic_ml.reduction import ReductionSettings, near_stall_shifts
from comparisons.live.detection import Sighting, SurgeDetector
from comparisons.live.estimate import Estimate, estimate_of
from comparisons.live.operating_point import (
    CUTOFF_HZ,
    SETTLED_S,
    OperatingPoints,
    low_pass_delay_s,
    points_of,
)
from comparisons.live.pieces import read_rows
from comparisons.live.state import Point, tau_words
from surge_core.errors import InputError

__all__ = ["Monitor", "Note"]

# The map and the traces: six seconds, at most 200 points a second.
TRAIL_S, TRAIL_HZ = 6.0, 200.0
# What the provisional estimate is made of: the last half minute.
WINDOW_S = 30.0
# Fewer rows no reader takes for a record.
LEAST_ROWS = 100

Note = tuple[str, str]


class Monitor:
    """Follow the machine: operating point, stall and surge, running estimate.

    Parameters
    ----------
    test : TestDescription
        The test.
    settings : ReductionSettings
        The switches of the running estimate.
    scratch : path
        Folder for rows that are read like files.
    estimates : bool
        Whether there is to be a running estimate.
    """

    def __init__(
        self,
        test: TestDescription,
        settings: ReductionSettings,
        scratch: Path,
        *,
        estimates: bool = True,
    ) -> None:
        rate_hz = test.sample_rate_hz
        self._test, self._settings, self._scratch = test, settings, scratch
        self._worker = ThreadPoolExecutor(1, "estimate") if estimates else None
        self._future: Future[Estimate] | None = None
        self._wanted = False
        self._detector = SurgeDetector(test)
        self._recent: deque[bytes] = deque(maxlen=max(6 * LEAST_ROWS, round(WINDOW_S * rate_hz)))
        self._batch = max(LEAST_ROWS, round(rate_hz))
        self._before = max(LEAST_ROWS, round(SETTLED_S * rate_hz))
        self._stride = max(1, round(rate_hz / TRAIL_HZ))
        self.trail: deque[tuple[float, ...]] = deque(maxlen=round(TRAIL_S * rate_hz / self._stride))
        # Whether rows of this feed could be read at all.
        self._read = False
        self._problem = ""
        self._match = "matched as test.toml says" if test.near_stall_shifts else ""
        self.head = b""
        self.point: Point | None = None
        self.estimate: Estimate | None = None
        self.restart()

    def restart(self) -> None:
        """Begin again behind a gap; what was found so far stays."""
        self._recent.clear()
        self._detector.restart()
        # Rows of this piece, and those whose operating point is known.
        self._n_rows = self._n_points = 0

    def take(self, lines: Sequence[bytes]) -> list[Note]:
        """Take rows that follow on those before; they are looked at by the next `update`.

        Parameters
        ----------
        lines : sequence of bytes
            Rows without their line ends.

        Returns
        -------
        list of tuple of str
            What was shown by rows beyond those that are looked at together.
        """
        notes: list[Note] = []
        for start in range(0, len(lines), self._batch):
            some = lines[start : start + self._batch]
            self._recent.extend(some)
            self._n_rows += len(some)
            if self._n_rows - self._n_points > self._batch:
                notes += self.update()
        return notes

    def update(self) -> list[Note]:
        """Look at the rows that have come since the last time.

        Returns
        -------
        list of tuple of str
            Kind and sentence of each thing worth saying.

        Raises
        ------
        InputError
            When the first rows of all cannot be read.
        """
        if self._n_rows < LEAST_ROWS or self._n_rows - self._n_points < 2:
            return []
        n = min(len(self._recent), self._n_rows - self._n_points + self._before)
        notes: list[Note] = []
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
                notes.append(("record", f"no operating point: {error}"))
            self._problem = str(error)
        else:
            for sighting in self._detector.take(points):
                notes.append((sighting.kind, _said(sighting)))
                self._wanted = self._wanted or sighting.kind == "cycle"
            self._remember(points)
        self._n_points = self._n_rows - 1
        return notes

    def poll(self) -> list[Note]:
        """Look for a new running estimate, and begin the next one behind a cycle."""
        notes: list[Note] = []
        if self._future is not None and self._future.done():
            notes = self._estimated(self._future.result())
            self._future = None
        if self._worker is not None and self._wanted and self._future is None:
            lines, n, test = list(self._recent), self._n_rows, self._test
            self._wanted = False
            self._future = self._worker.submit(
                estimate_of,
                lambda: self._record(lines, n, "estimate.csv"),
                test,
                self._settings,
            )
        return notes

    def close(self) -> list[Note]:
        """End the estimates; return what the last one showed."""
        self._wanted = False
        if self._worker is not None:
            self._worker.shutdown()
        return self.poll()

    @property
    def machine(self) -> str:
        """State of the machine, in words."""
        if self.point is None:
            return "not known"
        stall = "in stall" if self._detector.in_stall else "unstalled"
        if self._detector.surging:
            return f"surge, {stall}"
        return stall if self._detector.in_stall else "stable"

    @property
    def n_cycles(self) -> int:
        """Complete surge cycles."""
        return self._detector.n_cycles

    @property
    def period_s(self) -> float:
        """Their median period."""
        return self._detector.period_s

    @property
    def shown(self) -> str:
        """How the operating point is made."""
        delay_ms = 1e3 * low_pass_delay_s(self._test.sample_rate_hz)
        low_pass = f"causal low-pass at {CUTOFF_HZ:g} Hz, {delay_ms:.1f} ms late"
        matched = self._match or "not yet matched at near stall"
        return f"{low_pass if delay_ms else 'as is'}; {matched}"

    def _record(self, lines: list[bytes], n_rows: int = 0, name: str = "rows.csv") -> Record:
        """Return the last rows of the first ``n_rows`` of this piece as a record."""
        record = read_rows(self.head, lines, self._test, self._scratch / name)
        start_s = self._test.file.start_s
        if start_s is None:
            return record
        # The clock is set at the first row of all, not at that of these rows.
        begun = (n_rows or self._n_rows) - len(lines)
        return replace(record, start_s=start_s + begun / self._test.sample_rate_hz)

    def _matched(self, newest: Record) -> list[Note]:
        """Match at near stall once the reading of the facility has passed."""
        reading, rate_hz = self._test.near_stall, self._test.sample_rate_hz
        last_s = newest.time_at_s(newest.n_samples - 1)
        if self._match or last_s < reading.to_s + 0.5 / rate_hz:
            return []
        try:
            shifts = near_stall_shifts(self._record(list(self._recent)), self._test)
        except InputError as error:
            self._match = f"not matched at near stall: {error}"
            return [("record", f"the near-stall match failed: {error}")]
        self._test = replace(self._test, near_stall_shifts=shifts)
        self._match = "matched at near stall"
        return [("record", "matched to the near-stall reading of the facility")]

    def _remember(self, points: OperatingPoints) -> None:
        if not points.time_s.size:
            return
        shown = ("time_s", "Wc25_kg_s", "pressure_ratio", "phi", "psi_p", "Nc_frac")
        self.point = Point(*(float(getattr(points, name)[-1]) for name in shown))
        rows = slice(-self._n_points % self._stride, None, self._stride)
        drawn = ("time_s", "phi", "psi_p", "Wc25_kg_s", "pressure_ratio")
        kept = np.column_stack([getattr(points, name)[rows] for name in drawn])
        self.trail.extend(map(tuple, kept.tolist()))

    def _estimated(self, estimate: Estimate) -> list[Note]:
        known = self.estimate is not None and not self.estimate.why_not
        if estimate.why_not and known:
            # The estimate before it stays.
            return []
        self.estimate = estimate
        if known or estimate.why_not:
            return []
        return [("estimate", f"first estimate of τ: {tau_words(estimate)}")]


def _said(sighting: Sighting) -> str:
    late = f", reported {1e3 * sighting.delay_s:.0f} ms later"
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
