"""A lag model with the effects that were added to it: a value that is run on other records."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.catalogue import find_effect
from comparisons.missing_effect.catalogue.workings import shape_columns
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.extended_parts import (
    BENDING,
    MOST_EFFECTS,
    REVERSE,
    SHAPE,
    AddedEffect,
    FreeRun,
    by_record,
    finite,
    on_segments,
    rows_in,
)
from comparisons.missing_effect.fit import TERMS, Fit, Structure
from comparisons.missing_effect.lag_data import FrozenReferences
from comparisons.missing_effect.loading import load_data
from comparisons.missing_effect.ports import n_powers
from comparisons.missing_effect.quantities import equation_of, numbers_of, quantity, symbol
from comparisons.results import FitRows, FittedLag, evaluate_terms
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.errors import InputError
from surge_core.lag import Hold
from surge_core.rounding import round_to_error, significant
from surge_core.types import BoolArray, FloatArray, IntArray

# Channels of a series that an effect may need; the others follow from φ.
CHANNELS = ("T25_K", "Nc_frac")


@dataclass(frozen=True)
class ExtendedLag(Displayed):
    """τ dψ'/dt + ψ' = Σ β_i s_i(φ) with up to three effects of the catalogue, and numbers in it.

    Parameters
    ----------
    time_constant_s, time_constant_stderr_s : float
        τ and its standard error, in seconds.
    terms : tuple of str
        Names of the s_i.
    coefficients, stderr : tuple of float
        β_i and their standard errors.
    effects : tuple of AddedEffect
        What was added, in that order.
    references : FrozenReferences
        What the effects are measured from.
    noise_sigma, noise_innovation : float
        Standard deviation of an error of the fit, and of what is new in it.
    noise_ar : tuple of float
        Autoregression of the errors; empty where they are white.
    valid_phi : tuple of float
        Range of φ in which the curve can be trusted.
    table : tuple of tuple of float
        The characteristic as (φ, value, standard error).
    n_blocks : int
        Blocks behind the standard errors.
    estimator : str
        What it is called among other models.
    hold : {"zero", "first"}
        How φ acts between samples; a spline through them, joined by lines on a four times finer
        grid, is the finer form of ``"first"``.
    """

    time_constant_s: float
    time_constant_stderr_s: float
    terms: tuple[str, ...]
    coefficients: tuple[float, ...]
    stderr: tuple[float, ...]
    effects: tuple[AddedEffect, ...]
    references: FrozenReferences
    noise_sigma: float
    noise_innovation: float
    noise_ar: tuple[float, ...]
    valid_phi: tuple[float, float]
    table: tuple[tuple[float, float, float], ...]
    n_blocks: int = 0
    estimator: str = "extended"
    hold: Hold = "first"

    @property
    def target(self) -> str:
        """The coefficient that it gives."""
        return "psi_p"

    @property
    def label(self) -> str:
        """What people call it."""
        return " + ".join(["lag", *(added.name for added in self.effects)])

    @property
    def bending(self) -> tuple[AddedEffect, ...]:
        """Effects that are functions of φ alone, and so bend the characteristic."""
        return tuple(one for one in self.effects if one.name in BENDING and one.acts)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Effects that a simulation of another record leaves out: their phases are not known."""
        return tuple(added.name for added in self.effects if added.effect.episodes)

    def with_effect(self, effect: Effect | str) -> ExtendedLag:
        """Return the model with one effect more, which does nothing until it is fitted.

        Parameters
        ----------
        effect : Effect or str
            An effect, or the name of one of the built-in catalogue.

        Raises
        ------
        InputError
            For a name that is unknown, and for an effect that is there already, acts on no port
            of a model, or would be the fourth.
        """
        found = find_effect(effect) if isinstance(effect, str) else effect
        if found.port == "noise":
            raise InputError("effect", expected="one that acts on the model", found=found.name)
        if found.name in {added.name for added in self.effects}:
            raise InputError("effect", expected="one the model lacks", found=found.name)
        if len(self.effects) >= MOST_EFFECTS:
            raise InputError(
                "effect",
                expected=f"at most {MOST_EFFECTS} effects",
                found=f"one more: {found.name}",
            )
        # Amplitude 0, and a shape that is not known yet.
        unknown = (math.nan,) * len(found.parameters)
        return replace(
            self, effects=(*self.effects, AddedEffect(found, (0.0, *unknown[1:]), unknown))
        )

    def simulate(
        self,
        record: CoefficientSeries,
        labels: ArrayLike | None = None,
        *,
        start: Literal["measured", "rest"] = "measured",
    ) -> FloatArray:
        """Reconstruct ψ' of a record from its φ; nothing is refitted.

        Each segment of at least 15 rows is one free run. A ripple is left out: its phase differs
        from one stall episode to the next, and in another record it is unknown.

        Parameters
        ----------
        record : CoefficientSeries
            Of any length; its segments, temperature, speed and clock need not be those of the fit.
        labels : array-like of int, shape (n,), optional
            Starts again from the measured ψ' wherever these change within a segment.
        start : {"measured", "rest"}
            Whether a run starts from the first measured ψ' of its segment, or from the quasi-steady
            value ten rows before it. A lag of second order reads its two numbers from the first
            rows, as many as its short time constant lasts twice.

        Returns
        -------
        ndarray of shape (n,)
            ψ'; NaN outside the segments.

        Raises
        ------
        InputError
            When the record lacks a channel that an effect needs.
        """
        run = self._run(record)
        values = run.free
        if start == "measured":
            values = values + run.started(record.segment if labels is None else np.asarray(labels))
        out = np.full(record.n_samples, np.nan)
        out[run.at[run.scored]] = values[run.scored]
        return out

    def one_step(self, record: CoefficientSeries) -> tuple[FloatArray, BoolArray]:
        """Predict each row of a record from the measured row before it.

        Parameters
        ----------
        record : CoefficientSeries
            The record.

        Returns
        -------
        prediction : ndarray of shape (n,)
            NaN outside the segments.
        known : ndarray of bool, shape (n,)
            Rows with a measured row before them.
        """
        run = self._run(record)
        prediction, known = run.one_step()
        out, there = np.full(record.n_samples, np.nan), np.zeros(record.n_samples, dtype=np.bool_)
        out[run.at[run.scored]] = prediction[run.scored]
        there[run.at[known]] = True
        return out, there

    def _run(self, record: CoefficientSeries) -> FreeRun:
        for added in self.effects:
            needed = added.effect.needs
            if added.acts and needed in CHANNELS and getattr(record, needed) is None:
                raise InputError(
                    record.source,
                    expected=f"the column {needed}, which {added.name} needs",
                    found="none",
                )
        data = load_data([on_segments(record, record.segment)])
        data = replace(data, references=self.references)
        acting = [added for added in self.effects if added.acts]
        nonlinear = [np.log([self.time_constant_s]), *(added.nonlinear for added in acting)]
        groups = {added.name: np.asarray(added.coefficients) for added in acting}
        groups[TERMS] = np.asarray(self.coefficients)
        structure = Structure(self.terms, tuple(added.effect for added in acting))
        fit = Fit.assembled(structure, data, np.concatenate(nonlinear), groups)
        return FreeRun(data, fit, rows_in(record, data.sampled(data["time_s"])))

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
        out, known = np.empty(rows.phi.size), np.zeros(rows.phi.size, dtype=np.bool_)
        for record, own, at in by_record(rows, records):
            prediction, there = self.one_step(record)
            out[own], known[own] = prediction[at], there[at]
        return out, known

    def quasi_steady(self, phi: ArrayLike) -> FloatArray:
        """Return the characteristic at φ, at the start of the clock and the mean speed.

        With the loss in reversed flow and the free shape, without hysteresis, of shape (n,).
        """
        names, coefficients = self.curve_terms()
        columns = curve_columns(names, np.asarray(phi, dtype=np.float64), self)
        return np.asarray(columns @ coefficients)

    def curve_terms(self) -> tuple[tuple[str, ...], FloatArray]:
        """Return the names of all that is a function of φ alone, and one coefficient a column."""
        values = [*self.coefficients, *(b for one in self.bending for b in one.coefficients)]
        return (*self.terms, *(one.name for one in self.bending)), np.array(values)

    def equation(self) -> str:
        """Return the model in one line, each number rounded to its standard error."""
        lag = FittedLag(
            "",
            self.target,
            self.time_constant_s,
            self.time_constant_stderr_s,
            self.terms,
            self.coefficients,
            self.stderr,
            self.hold,
            self.valid_phi,
            self.table,
        )
        text = lag.equation()
        for added in self.effects:
            text += f"; {added.name}: {added.effect.equation}, {_numbers(added)}"
        return text

    def to_json(self) -> dict[str, Any]:
        """Return the value as plain JSON types."""
        rows = zip(self.terms, self.coefficients, self.stderr, strict=True)
        return {
            "estimator": self.estimator,
            "target": self.target,
            "equation": self.equation(),
            "time_constant_s": self.time_constant_s,
            "time_constant_stderr_s": finite(self.time_constant_stderr_s),
            "hold": self.hold,
            "terms": [
                {"name": name, "coefficient": value, "stderr": finite(stderr)}
                for name, value, stderr in rows
            ],
            "effects": [added.to_json() for added in self.effects],
            "references": {**vars(self.references), "phi_range": list(self.references.phi_range)},
            "noise": {
                "sigma": self.noise_sigma,
                "innovation": self.noise_innovation,
                "ar": list(self.noise_ar),
            },
            "valid_phi": list(self.valid_phi),
            "n_blocks": self.n_blocks,
            "characteristic": [[finite(v) for v in row] for row in self.table],
        }

    def _sheet(self) -> Sheet:
        tau = round_to_error(1e3 * self.time_constant_s, 1e3 * self.time_constant_stderr_s)
        terms = tuple(
            (name, round_to_error(value, stderr))
            for name, value, stderr in zip(self.terms, self.coefficients, self.stderr, strict=True)
        )
        effects = tuple(
            (
                added.name,
                equation_of(added.effect),
                symbol(p.name),
                quantity(p.value, p.stderr, p.unit),
            )
            for added in self.effects
            for p in added.numbers
        )
        header = ("effect", "adds", "number", "value")
        grids = [Grid("Quasi-steady characteristic", ("term", "coefficient ± std error"), terms)]
        if effects:
            grids.append(Grid("Effects", header, effects, frozenset({0, 1, 2})))
        return Sheet(
            f"Lag model with effects: {self.label}",
            (
                Field("time constant τ", f"{tau} ms"),
                Field("φ dwells", f"{self.valid_phi[0]:.3f} to {self.valid_phi[1]:.3f}"),
                Field("noise (std)", significant(self.noise_sigma, 3)),
            ),
            tuple(grids),
        )


def curve_columns(names: Sequence[str], phi: FloatArray, model: ExtendedLag) -> FloatArray:
    """Return the columns of a characteristic over φ, effects that bend it among them.

    Parameters
    ----------
    names : sequence of str
        Terms, and names of effects that are functions of φ alone.
    phi : ndarray of shape (n,)
        Flow coefficient.
    model : ExtendedLag
        Whose effects they are.
    """
    columns = [evaluate_terms(list(model.terms), phi)]
    for added in model.effects:
        if added.name == REVERSE and added.name in names:
            columns.append(evaluate_terms(["phi^2[phi<0]"], phi))
        elif added.name == SHAPE and added.name in names:
            intervals, low, high = added.nonlinear
            columns.append(shape_columns(phi, (low, high), int(intervals), n_powers(model.terms)))
    return np.column_stack(columns)


def _numbers(added: AddedEffect) -> str:
    if not added.fitted:
        return "not fitted"
    text = numbers_of(added.name, added.numbers)
    return f"{text} (not simulated: phase unknown)" if added.effect.episodes else text
