"""What a diagnosis of a user's model is: verdict, effects at their places, errors on each split."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from comparisons.missing_effect.systems.experiments import Experiment
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.records import Records
from comparisons.missing_effect.systems.search import Round
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.rounding import round_to_error, significant
from surge_core.types import BoolArray, FloatArray

__all__ = ["CheckRun", "FittedNumber", "FoundEffect", "ParameterRow", "SystemDiagnosis"]

# A check whose error grew beyond this factor is worse.
WORSE = 1.02


@dataclass(frozen=True)
class FittedNumber:
    """A number of an effect in physical units.

    Parameters
    ----------
    name : str
        Symbol.
    value, stderr : float
        From all training rows.
    unit : str
        Composed of the model's units.
    """

    name: str
    value: float
    stderr: float
    unit: str


@dataclass(frozen=True)
class FoundEffect:
    """One effect that the model lacked, at its place.

    Parameters
    ----------
    effect : str
        First name of the set.
    label : str
        Name and place in one line.
    place : mapping of str to str
        Equation, signal, input, sensor, parameter or state, as they apply.
    alias_set : tuple of str
        Names that these records cannot separate, the first among them.
    alias_labels : tuple of str
        The same with their places.
    provisional : bool
        Whether a term without a name does as well.
    unnamed : bool
        Whether it is such a term itself.
    numbers : tuple of FittedNumber
        Its numbers.
    evidence : mapping of str to float
        Gains in log-units on fitted and held-out rows, their z and the score.
    equation, says, confirm : str
        What it adds, what happens, and the measurement that would confirm it.
    doubts : tuple of str
        Why the name is not firm.
    """

    effect: str
    label: str
    place: Mapping[str, str]
    alias_set: tuple[str, ...]
    alias_labels: tuple[str, ...]
    provisional: bool
    unnamed: bool
    numbers: tuple[FittedNumber, ...]
    evidence: Mapping[str, float]
    equation: str
    says: str
    confirm: str
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class ParameterRow:
    """A parameter of the user's model without and with what was added.

    Parameters
    ----------
    name, unit : str
        As in the model.
    before, after : float
        From all training rows.
    before_stderr, after_stderr : float
        Robust against coloured errors: a sandwich over blocks of rows.
    at_bound : bool
        Whether the value after sits at a bound of the user's.
    """

    name: str
    unit: str
    before: float
    after: float
    before_stderr: float
    after_stderr: float
    at_bound: bool


@dataclass(frozen=True, eq=False)
class CheckRun:
    """A record simulated without and with what was added, by fits to the training records.

    Parameters
    ----------
    experiment : Experiment
        The record.
    held_out : bool
        False for a training record.
    settle : int
        Rows at the start that are not scored.
    outputs : tuple of str
        Names.
    measured, before, after : ndarray of shape (n, n_y)
        Outputs.
    refitted : ndarray of shape (n, n_y), optional
        The model with what was added, its parameters fitted to this very record.
    """

    experiment: Experiment
    held_out: bool
    settle: int
    outputs: tuple[str, ...]
    measured: FloatArray
    before: FloatArray
    after: FloatArray
    refitted: FloatArray | None = None

    @property
    def before_rms(self) -> FloatArray:
        """Return the rms error of each output of the model as it was."""
        return _rms_columns((self.measured - self.before)[self.settle :])

    @property
    def after_rms(self) -> FloatArray:
        """Return the rms error of each output of the model with what was added."""
        return _rms_columns((self.measured - self.after)[self.settle :])

    @property
    def worse(self) -> BoolArray:
        """Return whether what was added made the error of each output larger, beyond rounding."""
        return np.asarray(self.after_rms > WORSE * self.before_rms)

    @property
    def refitted_rms(self) -> FloatArray:
        """Return the same by a fit to this very record; what is above it no other record knows."""
        if self.refitted is None:
            return np.full(len(self.outputs), np.nan)
        return _rms_columns((self.measured - self.refitted)[self.settle :])


def _rms_columns(errors: FloatArray) -> FloatArray:
    """Return the rms of each column over the rows that were read; NaN where none was simulated."""
    there = np.isfinite(errors)
    total = np.sum(np.where(there, errors, 0.0) ** 2, axis=0)
    return np.asarray(np.sqrt(total / np.where(there.any(axis=0), there.sum(axis=0), np.nan)))


@dataclass(frozen=True, eq=False)
class SystemDiagnosis(Displayed):
    """What a user's model lacks.

    Parameters
    ----------
    model : Model
        The model.
    verdict : str
        ``nothing_missing``, ``named``, ``alias_set``, ``provisional``, ``unnamed_term`` or
        ``unexplained_structure``.
    missing : tuple of FoundEffect
        In the order in which they were found.
    records : Records
        Training records.
    rounds : tuple of Round
        The search.
    before, after : Fit
        To all training rows, without and with what was added.
    parameters : tuple of ParameterRow
        Of the model.
    offsets : tuple of FittedNumber
        Timing offset of each input, in samples, with what was added.
    training, checks : tuple of CheckRun
        Training and check records, simulated.
    floor : tuple of float
        What is new in each error of each output, after whitening: no model of this kind foretells
        less.
    unavailable : mapping of str to str
        Effects that no signal of these records can show, and why.
    remarks : tuple of str
        What a reader should know beside it.
    """

    model: Model
    verdict: str
    missing: tuple[FoundEffect, ...]
    records: Records
    rounds: tuple[Round, ...]
    before: Fit
    after: Fit
    parameters: tuple[ParameterRow, ...]
    offsets: tuple[FittedNumber, ...]
    training: tuple[CheckRun, ...]
    checks: tuple[CheckRun, ...]
    floor: tuple[float, ...]
    unavailable: Mapping[str, str]
    remarks: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """First names of what is missing."""
        return tuple(item.effect for item in self.missing)

    def parameter(self, name: str) -> ParameterRow:
        """Return a parameter of the model by name."""
        return next(row for row in self.parameters if row.name == name)

    def _sheet(self) -> Sheet:
        found = tuple((" or ".join(item.alias_labels), item.equation) for item in self.missing)
        parameters = tuple(
            (
                row.name,
                round_to_error(row.after, row.after_stderr),
                _shown(row.unit),
                "at its bound" if row.at_bound else "",
            )
            for row in self.parameters
        )
        errors = tuple(
            (
                f"{run.experiment.name} ({'check' if run.held_out else 'training'})",
                f"{output} [{_shown(self.model.outputs[output])}]",
                *((significant(float(run.before_rms[j])),) if found else ()),
                significant(float(run.after_rms[j])),
            )
            for run in (*self.training, *self.checks)
            for j, output in enumerate(run.outputs)
        )
        columns = ("record", "output", *(("before", "after") if found else ("rms",)))
        grids = [
            Grid("rms error of the free run", columns, errors, frozenset({0, 1})),
            Grid(
                "Parameters with what was added" if found else "Parameters",
                ("parameter", "value ± std error", "unit", "note"),
                parameters,
                frozenset({0, 2, 3}),
                folded=len(parameters) > 8,
            ),
        ]
        if found:
            grids.insert(0, Grid("Missing", ("effect", "adds"), found, frozenset({0, 1}), marked=0))
        clear = self.verdict in ("named", "nothing_missing", "alias_set")
        verdict = self.verdict.replace("_", " ")
        return Sheet(
            f"Diagnosis of {self.model.name}: {verdict}",
            (
                Field("verdict", verdict, "good" if clear else "advice"),
                *((Field("remarks", self.remarks, "advice"),) if self.remarks else ()),
            ),
            tuple(grids),
        )


def _shown(unit: str) -> str:
    return "-" if unit == "1" else unit
