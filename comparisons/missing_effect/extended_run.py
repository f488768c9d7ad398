"""The free run of a lag model with effects over one record, and its measured starts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.ports import Ports
from surge_core.types import BoolArray, FloatArray, IntArray

# The start of a lag of second order is read from so many of its short times, and rows at least.
START_TIMES = 2.0
LEAST_START_ROWS = 4


@dataclass(frozen=True)
class FreeRun:
    """A model on the rows of one record, in the references of the model.

    ``at`` is the row of the record that each sample stands for.
    """

    data: LagData
    fit: Fit
    at: IntArray

    @property
    def scored(self) -> BoolArray:
        """Samples in a segment, beside those that lead to it."""
        return self.data.weight > 0.0

    @cached_property
    def free(self) -> FloatArray:
        """ψ' at every sample, each run from rest."""
        return self.fit.output(self.data)

    def started(self, labels: IntArray) -> FloatArray:
        """Return what the measured starts add: it dies away with the lag.

        Where the labels of the record's rows change within a run, it starts again.
        """
        out = np.zeros(self.free.size)
        for run in self.data.slices:
            rows = np.arange(run.start, run.stop)[self.scored[run]]
            marks = labels[self.at[rows]]
            starts = [0, *(np.flatnonzero(np.diff(marks) != 0) + 1)]
            for first, stop in zip(starts, [*starts[1:], rows.size], strict=True):
                out[rows[first:stop]] = self._from_start(rows[first:stop])
        return out

    def one_step(self) -> tuple[FloatArray, BoolArray]:
        """Return each sample predicted from the measured one before it, and where there is one."""
        free, gain = self.free, self._gain
        known = np.zeros(free.size, dtype=np.bool_)
        for run in self.data.slices:
            known[run.start + 1 : run.stop] = self.scored[run][:-1] & self.scored[run][1:]
        now = np.flatnonzero(known)
        before = now - 1
        left = gain[now] / gain[before] * np.exp(self._age[before] - self._age[now])
        out = free.copy()
        out[now] += left * (self.data.measured[before] - free[before])
        return out, known

    @cached_property
    def _ports(self) -> Ports:
        return self.fit.structure.ports(self.data, self.fit.nonlinear)

    @property
    def _gain(self) -> FloatArray:
        gain = self._ports.out_gain
        return np.ones(self.data.n_samples) if gain is None else gain

    def _from_start(self, piece: IntArray) -> FloatArray:
        """Return what the measured start of a piece adds to its rows."""
        begin, gain = piece[0], self._gain[piece]
        lasting = np.exp(self._age[begin] - self._age[piece])
        off = self.data.measured[piece] - self.free[piece]
        if self._ports.a2_s2 == 0.0:
            return np.asarray(off[0] / gain[0] * gain * lasting)
        # ψ' and its rate: two numbers, of which one row measures but one.
        modes = gain[:, None] * np.column_stack([lasting, self._second_mode(piece)])
        n = min(self._start_rows, piece.size)
        sizes = np.linalg.lstsq(modes[:n], off[:n], rcond=1e-6)[0]
        return np.asarray(modes @ sizes)

    def _second_mode(self, piece: IntArray) -> FloatArray:
        """Return the other way in which a lag of second order forgets, beside the slow one."""
        slow_s, fast_s, turn = self._times
        since_s = (piece - piece[0]) * self.data.sample_period_s
        if turn > 0.0:
            return np.asarray(np.exp(-since_s / slow_s) * np.sin(turn * since_s))
        return np.asarray(np.exp(-since_s / fast_s))

    @property
    def _start_rows(self) -> int:
        """First rows from which the start is read; one but for a lag of second order."""
        _, fast_s, turn = self._times
        lasts_s = 1.0 / turn if turn > 0.0 else fast_s
        return max(LEAST_START_ROWS, round(START_TIMES * lasts_s / self.data.sample_period_s))

    @cached_property
    def _times(self) -> tuple[float, float, float]:
        """Slow and fast time constant, in seconds, and angular frequency where the lag swings."""
        tau_s, a2_s2 = self.fit.tau_s, self._ports.a2_s2
        if a2_s2 == 0.0:
            return tau_s, 0.0, 0.0
        inside = tau_s**2 - 4.0 * a2_s2
        if inside < 0.0:
            return 2.0 * a2_s2 / tau_s, 0.0, float(np.sqrt(-inside)) / (2.0 * a2_s2)
        slow_s = 0.5 * (tau_s + float(np.sqrt(inside)))
        return slow_s, a2_s2 / slow_s, 0.0

    @cached_property
    def _age(self) -> FloatArray:
        """Time since the first row, at each sample, in units of the (slower) time constant."""
        slow_s, _, turn = self._times
        steps = np.full(self.data["phi"].size, self.data.step_s / slow_s)
        if self._ports.tau_factor is not None and turn == 0.0:
            steps = steps / self._ports.tau_factor
        return np.asarray(np.cumsum(steps)[self.data.rows])
