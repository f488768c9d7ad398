"""From rows in order to what is known of the machine, batch by batch."""

from __future__ import annotations

from collections import deque
from contextlib import suppress

import numpy as np

from classic_ml.description import PressureChannel, TestDescription
from classic_ml.units import COUNT
from comparisons.live.columns import FeedColumns, described_columns
from comparisons.live.detection import Sighting, SurgeDetector
from comparisons.live.estimate import Estimate
from comparisons.live.faulty_channels import FaultyChannels
from comparisons.live.near_stall import NearStallMatch
from comparisons.live.operating_point import (
    CUTOFF_HZ,
    CausalChain,
    OperatingPoints,
    low_pass_delay_s,
)
from comparisons.live.running_estimate import Estimator, NoEstimate
from comparisons.live.state import Point, tau_words
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["Monitor", "Note", "warm_up"]

# The map and the traces: six seconds, at most 200 points a second.
TRAIL_S = 6.0
TRAIL_HZ = 200.0

Note = tuple[str, str]


class Monitor:
    """Follow the machine: operating point, stall and surge, running estimate.

    Parameters
    ----------
    columns : FeedColumns
        The channels.
    estimator : Estimator
        Where the running estimate is made.
    """

    def __init__(self, columns: FeedColumns, estimator: Estimator) -> None:
        rate_hz = columns.test.sample_rate_hz
        self._columns = columns
        self._match = NearStallMatch(columns)
        self._chain = CausalChain(columns, self._match)
        self._faults = FaultyChannels(columns)
        self._detector = SurgeDetector(columns.test)
        self._estimator = estimator
        self._stride = max(1, round(rate_hz / TRAIL_HZ))
        self._phase = 0
        self._trail: deque[tuple[float, ...]] = deque(
            maxlen=round(TRAIL_S * rate_hz / self._stride)
        )
        self._last_problem = ""
        self.point: Point | None = None
        self.estimate: Estimate | None = None

    def take(self, time_s: FloatArray, readings: FloatArray) -> list[Note]:
        """Take rows that follow on those before, and tell what they showed.

        Parameters
        ----------
        time_s : ndarray of shape (n,)
            Clock.
        readings : ndarray of shape (n, n_channels)
            Counts, Pa and K.

        Returns
        -------
        list of tuple of str
            Kind and sentence of each thing worth telling.
        """
        notes: list[Note] = []
        while time_s.size:
            # Cut where the match or the faulty channels change, and each holds from the next row
            # on: what is found does not depend on how the rows were cut before.
            n = min(self._match.rows_to_go(time_s), self._faults.rows_to_go)
            notes += self._block(time_s[:n], readings[:n])
            time_s, readings = time_s[n:], readings[n:]
        return notes

    def _block(self, time_s: FloatArray, readings: FloatArray) -> list[Note]:
        self._chain.left_out = self._faults.left_out
        points = self._chain.take(time_s, readings)
        notes: list[Note] = []
        if self._chain.problem and self._chain.problem != self._last_problem:
            notes.append(("record", f"no operating point: {self._chain.problem}"))
        self._last_problem = self._chain.problem
        for sighting in self._detector.take(points):
            notes.append((sighting.kind, _told(sighting)))
            if sighting.kind == "cycle":
                self._estimator.ask()
        self._remember(points)
        self._estimator.take(time_s, readings)
        notes += self._matched(time_s, readings)
        return notes + [("record", text) for text in self._faults.take(time_s, readings)]

    def restart(self) -> None:
        """Begin anew behind a gap; what was found so far stays."""
        for part in (self._match, self._chain, self._detector, self._faults, self._estimator):
            part.restart()

    def poll(self) -> list[Note]:
        """Look for a new running estimate."""
        estimate = self._estimator.poll()
        if estimate is None:
            return []
        if estimate.why_not and self.estimate is not None and not self.estimate.why_not:
            # Behind a gap the reading near stall is missing: the estimate before it stays.
            return []
        first = self.estimate is None or bool(self.estimate.why_not)
        self.estimate = estimate
        if first and not estimate.why_not:
            return [("estimate", f"first estimate of τ: {tau_words(estimate)}")]
        return []

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
    def trail(self) -> tuple[tuple[float, ...], ...]:
        """The last seconds, thinned out."""
        return tuple(self._trail)

    @property
    def shown(self) -> str:
        """How the operating point is made."""
        delay_ms = 1e3 * low_pass_delay_s(self._columns.test.sample_rate_hz)
        low_pass = (
            f"causal low-pass at {CUTOFF_HZ:g} Hz, {delay_ms:.1f} ms late" if delay_ms else "as is"
        )
        if self._match.shifts is not None:
            matched = "matched at near stall"
        elif self._match.problem:
            matched = f"not matched at near stall: {self._match.problem}"
        else:
            matched = "not yet matched at near stall"
        out = sorted(self._faults.left_out)
        return f"{low_pass}; {matched}" + (f"; without {', '.join(out)}" if out else "")

    def _matched(self, time_s: FloatArray, readings: FloatArray) -> list[Note]:
        if not self._match.take(time_s, readings):
            return []
        if self._match.problem:
            return [("record", f"the near-stall match failed: {self._match.problem}")]
        return [("record", "matched to the near-stall reading of the facility")]

    def _remember(self, points: OperatingPoints) -> None:
        if not len(points):
            return
        ratio = points.pressure_ratio
        names = (points.time_s, points.Wc25_kg_s, ratio, points.phi, points.psi_p, points.Nc_frac)
        self.point = Point(*(float(values[-1]) for values in names))
        rows = slice(-self._phase % self._stride, None, self._stride)
        self._phase += len(points)
        columns = (points.time_s, points.phi, points.psi_p, points.Wc25_kg_s, ratio)
        kept = np.column_stack([values[rows] for values in columns])
        self._trail.extend(tuple(row) for row in kept.tolist())


def _told(sighting: Sighting) -> str:
    late = f", told {1e3 * sighting.delay_s:.0f} ms later"
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


def warm_up(test: TestDescription) -> None:
    """Run a stretch of made-up rows through a monitor, so that the first real ones need not wait
    for packages to load and kernels to compile.

    Parameters
    ----------
    test : TestDescription
        The test.
    """
    columns = described_columns(test)
    n_rows = round(test.sample_rate_hz) + 2
    rows = np.zeros((n_rows, len(columns.channels)))
    for number, name in enumerate(test.channel_names):
        probe = next((p for p in test.pressures if p.name == name), None)
        rows[:, number] = 300.0 if probe is None else _resting(probe)
    # Rows that nothing was measured for may be refused; by then all is loaded.
    with suppress(InputError):
        Monitor(columns, NoEstimate()).take(np.arange(n_rows) / test.sample_rate_hz, rows)


def _resting(probe: PressureChannel) -> float:
    """Return a reading at which a probe pair shows a little flow."""
    if probe.record_unit != COUNT:
        return 1e5
    return 0.5 * (probe.zero_count + probe.calibrate_count)
