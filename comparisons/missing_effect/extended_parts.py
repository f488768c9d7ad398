"""Parts of a lag model with effects: effects with numbers, references, the run of a record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.ports import Ports, ages, lag_times
from comparisons.results import FitRows
from surge_core.types import BoolArray, FloatArray, IntArray

# Three effects beside one lag are as many as records of one test have ever separated.
MOST_EFFECTS = 3
# Effects that are functions of φ alone, and so bend the characteristic.
REVERSE, SHAPE = BENDING = ("reverse_flow_branch", "characteristic_shape")
# The start of a lag of second order is read from so many of its short times, and rows at least.
START_TIMES = 2.0
LEAST_START_ROWS = 4


@dataclass(frozen=True)
class AddedEffect:
    """One effect of a model, with its numbers.

    Parameters
    ----------
    effect : Effect
        Of the built-in catalogue, or one's own.
    values, stderr : tuple of float
        Its parameters in their order and units, and their standard errors; NaN where the effect
        was added and not fitted yet.
    coefficients : tuple of float
        Of the columns that it adds; empty for an effect without any, and for a ripple, whose
        phases belong to the episodes that it was fitted to.
    """

    effect: Effect
    values: tuple[float, ...]
    stderr: tuple[float, ...]
    coefficients: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """Its identifier."""
        return self.effect.name

    @property
    def nonlinear(self) -> FloatArray:
        """Values of the parameters that are no coefficients, in their order."""
        pairs = zip(self.effect.parameters, self.values, strict=True)
        return np.array([value for p, value in pairs if p.kind != "linear"])

    @property
    def acts(self) -> bool:
        """Whether it changes what the model simulates."""
        if self.effect.episodes:
            return False
        return any(self.coefficients) if self.effect.linear else self.values[0] != 0.0

    @property
    def fitted(self) -> bool:
        """Whether its numbers come from a fit."""
        return bool(np.all(np.isfinite((*self.values, *self.stderr))))

    @property
    def numbers(self) -> tuple[FittedParameter, ...]:
        """Its numbers with names and units."""
        rows = zip(self.effect.parameters, self.values, self.stderr, strict=True)
        return tuple(FittedParameter(p.name, value, error, p.unit) for p, value, error in rows)

    def to_json(self) -> dict[str, Any]:
        """Return the value as plain JSON types."""
        return {
            "effect": self.name,
            "equation": self.effect.equation,
            "parameters": [
                {**asdict(p), "value": finite(p.value), "stderr": finite(p.stderr)}
                for p in self.numbers
            ],
            "coefficients": list(self.coefficients),
        }


def on_segments(record: CoefficientSeries, segment: IntArray) -> CoefficientSeries:
    """Return a record of such segments, without the unfiltered columns that it may carry."""
    return replace(
        record,
        segment=segment,
        phi_unfiltered=None,
        psi_p_unfiltered=None,
        stalled=None,
        free_run=None,
    )


def by_record(
    rows: FitRows, records: Sequence[CoefficientSeries]
) -> Iterator[tuple[CoefficientSeries, BoolArray, IntArray]]:
    """Return each record with the rows of a comparison that are its own, and where they stand."""
    for i, record in enumerate(records):
        own = rows.record == i
        yield record, own, rows_in(record, rows.time_s[own])


def rows_in(record: CoefficientSeries, time_s: FloatArray) -> IntArray:
    """Return the rows of a record at given times of its clock, of shape (n,)."""
    at = np.rint((time_s - record.time_s[0]) / record.sample_period_s)
    return np.asarray(at.astype(np.int64))


def finite(value: float) -> float | None:
    """Return a number for JSON, None where it is not known."""
    return float(value) if math.isfinite(value) else None


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
            for piece in np.split(rows, np.flatnonzero(np.diff(marks)) + 1):
                out[piece] = self._from_start(piece)
        return out

    def one_step(self) -> tuple[FloatArray, BoolArray]:
        """Return each sample predicted from the measured one before it, and where there is one."""
        known = np.zeros(self.free.size, dtype=np.bool_)
        for run in self.data.slices:
            known[run.start + 1 : run.stop] = self.scored[run][:-1] & self.scored[run][1:]
        now, out = np.flatnonzero(known), self.free.copy()
        left = self._gain(now - 1, now) * self._lasting(now - 1, now)
        out[now] += left * (self.data.measured - self.free)[now - 1]
        return out, known

    @cached_property
    def _ports(self) -> Ports:
        return self.fit.structure.ports(self.data, self.fit.nonlinear)

    @cached_property
    def _age(self) -> FloatArray:
        return ages(self._ports, self.data, self.fit.tau_s)

    def _lasting(self, begun: int | IntArray, rows: IntArray) -> FloatArray:
        """Return what the lag leaves at some rows of what was off by one where they began."""
        return np.asarray(np.exp(self._age[begun] - self._age[rows]))

    def _gain(self, begun: int | IntArray, rows: IntArray) -> FloatArray:
        """Return the factor of the output at some rows over that where they began."""
        gain = np.broadcast_to(self._ports.out_gain, self.free.shape)
        return np.asarray(gain[rows] / gain[begun])

    def _from_start(self, piece: IntArray) -> FloatArray:
        """Return what the measured start of a piece adds to its rows."""
        off = self.data.measured[piece] - self.free[piece]
        lasting, gain = self._lasting(piece[0], piece), self._gain(piece[0], piece)
        if self._ports.a2_s2 == 0.0:
            return np.asarray(off[0] * gain * lasting)
        # ψ' and its rate: two numbers, of which one row measures but one. A lag of second order
        # forgets in two ways, the second a swing or a shorter time.
        slow_s, fast_s, turn = lag_times(self.fit.tau_s, self._ports.a2_s2)
        period_s = self.data.sample_period_s
        since_s = (piece - piece[0]) * period_s
        if turn > 0.0:
            second, lasts_s = np.exp(-since_s / slow_s) * np.sin(turn * since_s), 1.0 / turn
        else:
            second, lasts_s = np.exp(-since_s / fast_s), fast_s
        modes = np.column_stack([gain * lasting, gain * second])
        n = max(LEAST_START_ROWS, round(START_TIMES * lasts_s / period_s))
        sizes = np.linalg.lstsq(modes[:n], off[:n], rcond=1e-6)[0]
        return np.asarray(modes @ sizes)
