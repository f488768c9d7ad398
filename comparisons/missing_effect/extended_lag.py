"""A lag model with the effects that were added to it: a value that is run on other records."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.catalogue import find_effect
from comparisons.missing_effect.catalogue.workings import shape_columns
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.fit import TERMS, Fit, Structure
from comparisons.missing_effect.lag_data import FrozenReferences, LagData
from comparisons.missing_effect.loading import load_data
from comparisons.missing_effect.ports import ages, lag_times, n_powers
from comparisons.missing_effect.quantities import numbers_of
from comparisons.results import FitRows, FittedLag, evaluate_terms
from surge_core.errors import require
from surge_core.types import BoolArray, FloatArray, IntArray

# Channels of a series that an effect may need; the others follow from φ.
CHANNELS = ("T25_K", "Nc_frac")
# What the file of a plain lag says beside what a lag with effects has.
OF_PLAIN_LAGS = ("dead_time_s", "covariance", "rows", "free_run_rms")
# Three effects beside one lag are as many as records of one test have ever separated.
MOST_EFFECTS = 3
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
        Its parameters in their order and units, and their standard errors.
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
    def fitted(self) -> bool:
        """Whether its numbers come from a fit; one that was only added does nothing."""
        return bool(np.all(np.isfinite(self.values)))

    @property
    def nonlinear(self) -> FloatArray:
        """Values of the parameters that are no coefficients, in their order."""
        pairs = zip(self.effect.parameters, self.values, strict=True)
        return np.array([value for p, value in pairs if p.kind != "linear"])

    @property
    def numbers(self) -> tuple[FittedParameter, ...]:
        """Its numbers with names and units."""
        rows = zip(self.effect.parameters, self.values, self.stderr, strict=True)
        return tuple(FittedParameter(p.name, value, error, p.unit) for p, value, error in rows)

    def bend(self, phi: FloatArray, terms: Sequence[str]) -> FloatArray:
        """Return the columns that bend the characteristic of base terms at φ; none where none."""
        if self.name == "reverse_flow_branch":
            return evaluate_terms(["phi^2[phi<0]"], phi)
        if self.name == "characteristic_shape":
            intervals, low, high = self.nonlinear
            return shape_columns(phi, (low, high), int(intervals), n_powers(terms))
        return np.zeros((phi.size, 0))

    def to_json(self) -> dict[str, Any]:
        """Return the value as plain JSON types, NaN for what is not known."""
        return {
            "effect": self.name,
            "equation": self.effect.equation,
            "parameters": [asdict(p) for p in self.numbers],
            "coefficients": list(self.coefficients),
        }


@dataclass(frozen=True)
class ExtendedLag:
    """τ dψ'/dt + ψ' = Σ β_i s_i(φ) with up to three effects of the catalogue, and numbers in it.

    Parameters
    ----------
    lag : FittedLag
        τ, the terms s_i and β_i, and the characteristic with the loss in reversed flow and the free
        shape, without hysteresis. Its hold is a spline through the samples of φ, joined by lines on
        a four times finer grid: the finer form of ``"first"``.
    effects : tuple of AddedEffect
        What was added, in that order.
    references : FrozenReferences
        What the effects are measured from.
    noise_sigma, noise_innovation : float
        Standard deviation of an error of the fit, and of what is new in it.
    noise_ar : tuple of float
        Autoregression of the errors; empty where they are white.
    """

    lag: FittedLag
    effects: tuple[AddedEffect, ...]
    references: FrozenReferences
    noise_sigma: float
    noise_innovation: float
    noise_ar: tuple[float, ...]

    @property
    def estimator(self) -> str:
        """What it is called among other models."""
        return self.lag.estimator

    @property
    def target(self) -> str:
        """The coefficient that it gives."""
        return self.lag.target

    @property
    def time_constant_s(self) -> float:
        """τ, in seconds."""
        return self.lag.time_constant_s

    @property
    def valid_phi(self) -> tuple[float, float]:
        """Range of φ in which the curve can be trusted."""
        return self.lag.valid_phi

    def quasi_steady(self, phi: ArrayLike) -> FloatArray:
        """Return the characteristic at φ, at the start of the clock and the mean speed.

        With the loss in reversed flow and the free shape, without hysteresis, of shape (n,).
        """
        at = np.asarray(phi, dtype=np.float64)
        value = evaluate_terms(list(self.lag.terms), at) @ np.asarray(self.lag.coefficients)
        for one in self.effects:
            if one.fitted:
                columns = one.bend(at, self.lag.terms)
                value = value + columns @ np.array(one.coefficients[: columns.shape[1]])
        return np.asarray(value)

    def called(self, name: str) -> ExtendedLag:
        """Return the model under another name."""
        return replace(self, lag=replace(self.lag, estimator=name))

    def with_effect(self, effect: Effect | str) -> ExtendedLag:
        """Return the model with one effect more, which acts once the model is refitted.

        Parameters
        ----------
        effect : Effect or str
            An effect of one's own, or the name of one of the built-in catalogue.

        Raises
        ------
        InputError
            For a name that is unknown, and for an effect that is there already, acts on no port
            of a model, or would be the fourth.
        """
        found = find_effect(effect) if isinstance(effect, str) else effect
        there = {added.name for added in self.effects}
        fits = found.port != "noise" and found.name not in there and len(there) < MOST_EFFECTS
        expected = f"one on a port of the model that it lacks, and at most {MOST_EFFECTS} in it"
        require(fits, "effect", expected, found.name)
        unknown = (math.nan,) * len(found.parameters)
        return replace(self, effects=(*self.effects, AddedEffect(found, unknown, unknown)))

    def simulate(self, record: CoefficientSeries, labels: ArrayLike | None = None) -> FloatArray:
        """Reconstruct ψ' of a record from its φ; nothing is refitted.

        Each segment of at least 15 rows is one free run from its first measured ψ'; a lag of second
        order reads its two numbers from the first rows, as many as its short time constant lasts
        twice. A ripple is left out: its phase differs from one stall episode to the next, and in
        another record it is unknown.

        Parameters
        ----------
        record : CoefficientSeries
            Of any length; its segments, temperature, speed and clock need not be those of the fit.
        labels : array-like of int, shape (n,), optional
            Starts again from the measured ψ' wherever these change within a segment.

        Returns
        -------
        ndarray of shape (n,)
            ψ'; NaN outside the segments.

        Raises
        ------
        InputError
            When the record lacks a channel that an effect needs.
        """
        data, fit = self._on(record)
        at = _rows_in(record, data.sampled(data["time_s"]))
        marks = (record.segment if labels is None else np.asarray(labels))[at]
        ports = fit.structure.ports(data, fit.nonlinear)
        age, free = ages(ports, data, fit.tau_s), fit.output(data)
        gain = np.broadcast_to(ports.out_gain, free.shape)
        times = lag_times(fit.tau_s, ports.a2_s2)
        out = np.full(record.n_samples, np.nan)
        for run in data.slices:
            rows = np.arange(run.start, run.stop)[data.weight[run] > 0.0]
            for piece in np.split(rows, np.flatnonzero(np.diff(marks[rows])) + 1):
                off = (data.measured - free)[piece]
                lasting = np.exp(age[piece[0]] - age[piece])
                start = _from_start(off, lasting, times, data.sample_period_s)
                out[at[piece]] = free[piece] + gain[piece] / gain[piece[0]] * start
        return out

    def _on(self, record: CoefficientSeries) -> tuple[LagData, Fit]:
        """Return a record as rows, in the references of the model, and the model on them."""
        acting = [one for one in self.effects if one.fitted and not one.effect.episodes]
        for added in acting:
            needed = added.effect.needs
            known = needed not in CHANNELS or getattr(record, needed) is not None
            expected = f"the column {needed}, which {added.name} needs"
            require(known, record.source, expected, "none")
        data = replace(load_data([on_segments(record, record.segment)]), references=self.references)
        nonlinear = [np.log([self.time_constant_s]), *(added.nonlinear for added in acting)]
        groups = {added.name: np.asarray(added.coefficients) for added in acting}
        groups[TERMS] = np.asarray(self.lag.coefficients)
        structure = Structure(self.lag.terms, tuple(added.effect for added in acting))
        return data, Fit.assembled(structure, data, np.concatenate(nonlinear), groups)

    def free_run_over(
        self, rows: FitRows, records: Sequence[CoefficientSeries], labels: IntArray | None = None
    ) -> FloatArray:
        """Reconstruct the rows that a comparison fits, each segment from its measured start.

        Parameters
        ----------
        rows : FitRows
            Rows of the records.
        records : sequence of CoefficientSeries
            The records they come from, in that order.
        labels : ndarray of int, shape (n,), optional
            In place of the rows' own segments.
        """
        out = np.empty(rows.phi.size)
        for record, own, at in by_record(rows, records):
            marks = np.zeros(record.n_samples, dtype=np.int64)
            marks[at] = (rows.labels if labels is None else labels)[own]
            out[own] = self.simulate(record, marks)[at]
        return out

    def one_step_over(
        self, rows: FitRows, records: Sequence[CoefficientSeries]
    ) -> tuple[FloatArray, BoolArray]:
        """Predict each row of a comparison from the row before it, and tell which are predicted.

        Parameters
        ----------
        rows : FitRows
            Rows of the records.
        records : sequence of CoefficientSeries
            The records they come from.
        """
        row = np.arange(rows.phi.size)
        # Free runs of two rows each, which begin at the even rows and at the odd ones.
        odd, even = (self.free_run_over(rows, records, (row + k) // 2) for k in (0, 1))
        known = np.ones(row.size, dtype=np.bool_)
        known[[run.start for run in rows.runs]] = False
        return np.where(row % 2, odd, even), known

    def equation(self) -> str:
        """Return the model in one line, each number rounded to its standard error."""
        text = self.lag.equation()
        for added in self.effects:
            alone = " (not simulated: phase unknown)" if added.effect.episodes else ""
            numbers = numbers_of(added.name, added.numbers) if added.fitted else "not fitted"
            text += f"; {added.name}: {added.effect.equation}, {numbers}{alone}"
        return text

    def to_json(self) -> dict[str, Any]:
        """Return the value as plain JSON types, NaN for what is not known."""
        plain = self.lag.to_json()
        return {
            **{name: value for name, value in plain.items() if name not in OF_PLAIN_LAGS},
            "equation": self.equation(),
            "effects": [added.to_json() for added in self.effects],
            "references": {**vars(self.references), "phi_range": list(self.references.phi_range)},
            "noise": {
                "sigma": self.noise_sigma,
                "innovation": self.noise_innovation,
                "ar": list(self.noise_ar),
            },
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
        yield record, own, _rows_in(record, rows.time_s[own])


def _rows_in(record: CoefficientSeries, time_s: FloatArray) -> IntArray:
    """Return the rows of a record at given times of its clock, of shape (n,)."""
    at = np.rint((time_s - record.time_s[0]) / record.sample_period_s)
    return np.asarray(at.astype(np.int64))


def _from_start(
    off: FloatArray, lasting: FloatArray, times: tuple[float, float, float], period_s: float
) -> FloatArray:
    """Return what the measured start of a free run adds to it.

    ``off`` is how far the measured rows are from a run from rest, ``lasting`` what the lag leaves
    of its start, ``times`` those of `lag_times`.
    """
    _, fast_s, turn = times
    lasts_s = 1.0 / turn if turn > 0.0 else fast_s
    n = max(LEAST_START_ROWS, round(START_TIMES * lasts_s / period_s))
    if lasts_s == 0.0 or off.size < LEAST_START_ROWS:
        return np.asarray(off[0] * lasting)
    # ψ' and its rate: two numbers, of which one row measures but one. A lag of second order
    # forgets in two ways, the second a swing or a shorter time.
    since_s = np.arange(off.size) * period_s
    second = np.exp(-since_s / fast_s) if turn == 0.0 else np.sin(turn * since_s) * lasting
    modes = np.column_stack([lasting, second])
    sizes = np.linalg.lstsq(modes[:n], off[:n], rcond=1e-6)[0]
    return np.asarray(modes @ sizes)
