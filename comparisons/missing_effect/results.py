"""What a diagnosis is, of a lag series or of a user's model: verdict, names, before, after."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.scales import scale_of
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.rounding import round_to_error
from surge_core.types import BoolArray, FloatArray

__all__ = [
    "CLEAR",
    "CORRELATION",
    "MUCH_CORRELATED",
    "SIZE",
    "Absent",
    "CandidateRow",
    "CheckRun",
    "Diagnosis",
    "FittedParameter",
    "Gap",
    "MissingEffect",
    "ParameterRow",
    "Untold",
]

# Under this name the evidence holds how many standard errors large an effect is as a whole.
SIZE = "size_in_errors"
# And under this one the largest correlation of two numbers of the effect, from which on their
# errors say little one by one.
CORRELATION, MUCH_CORRELATED = "largest_correlation", 0.9
# Verdicts that leave nothing open.
CLEAR = ("named", "nothing_missing", "alias_set")
# A check whose error grew beyond this factor is worse.
WORSE = 1.02


@dataclass(frozen=True)
class Gap:
    """Errors on rows that were not fitted, as one number.

    Parameters
    ----------
    before_rms, after_rms : float
        Of the free run, without and with what was added.
    floor_rms : float
        Measurement noise.
    unit : str
        Of all three.
    whole : float
        No larger share than this can be closed; 1 where the floor is that of other, perhaps
        noisier, records.
    """

    before_rms: float
    after_rms: float
    floor_rms: float
    unit: str = "1"
    whole: float = math.inf

    @property
    def shrink(self) -> float:
        """Share of the gap that is closed: (before² − after²)/(before² − floor²)."""
        gap = self.before_rms**2 - self.floor_rms**2
        won = self.before_rms**2 - self.after_rms**2
        if not (math.isfinite(gap) and math.isfinite(won)):
            return math.nan
        return float(min(won / gap, self.whole)) if gap > 0.0 and won > 0.0 else 0.0


@dataclass(frozen=True)
class MissingEffect:
    """One effect that the model lacked, at its place.

    Parameters
    ----------
    effect : str
        First name.
    alias_set : tuple of str
        The names that these data cannot separate, the first among them.
    provisional : bool
        Whether the name stands for something that may be another.
    parameters : tuple of FittedParameter
        Its numbers, from all fitted rows.
    evidence : mapping
        Gains in log-units on fitted and held-out rows, their z and the score.
    doubts : tuple of str
        Why the name is not firm.
    label : str
        Name and place in one line.
    place : mapping of str to str
        Port, equation, signal, input, sensor, parameter or state, as they apply.
    alias_labels : tuple of str
        The alias set with its places.
    unnamed : bool
        Whether it is a term without a name.
    equation, says : str
        What it adds, and what happens.
    confirm : mapping of str to str
        The measurement that would confirm each of the alias set.
    on_tau : str
        What the time constant of a lag suffers without it.
    """

    effect: str
    alias_set: tuple[str, ...]
    provisional: bool
    parameters: tuple[FittedParameter, ...]
    evidence: Mapping[str, float]
    doubts: tuple[str, ...] = ()
    label: str = ""
    place: Mapping[str, str] = field(default_factory=dict)
    alias_labels: tuple[str, ...] = ()
    unnamed: bool = False
    equation: str = ""
    says: str = ""
    confirm: Mapping[str, str] = field(default_factory=dict)
    on_tau: str = ""


@dataclass(frozen=True)
class Untold:
    """An effect about which these records do not decide.

    Parameters
    ----------
    effect : str
        Its name.
    why, what_would_tell : str
        What it reads where nothing is missing; the measurement that would tell.
    """

    effect: str
    why: str
    what_would_tell: str


@dataclass(frozen=True)
class Absent:
    """An effect that is not there, and the size from which on it would have been seen.

    Parameters
    ----------
    effect, parameter : str
        Its name, and that of its number; ``"rms"`` for the part of ψ' that it makes.
    size : float
        Of its number.
    unit : str
        SI; ``"1"`` without one.
    """

    effect: str
    parameter: str
    size: float
    unit: str


@dataclass(frozen=True)
class ParameterRow:
    """A parameter of the model without and with what was added.

    Parameters
    ----------
    name, unit : str
        As in the model.
    before, after : float
        From all fitted rows.
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
    at_bound: bool = False


@dataclass(frozen=True, eq=False)
class CheckRun:
    """Rows simulated without and with what was added, by fits to the fitted rows.

    Parameters
    ----------
    name : str
        Of the record.
    kind : {"fitted", "held out", "left out", "check"}
        Fitted; held out of the fits; left out in turn, cycle by cycle; or a record that is only
        simulated.
    period_s : float
        Sample period.
    time_s : ndarray of shape (n,)
        Clock of the record.
    outputs : mapping of str to str
        Names and units.
    measured, before, after : ndarray of shape (n, n_y)
        Outputs; what is not a number is not scored.
    settle : int
        Rows at the start that are not scored.
    signals : mapping of str to ndarray of shape (n,)
        Measured inputs and outputs.
    refitted : ndarray of shape (n, n_y), optional
        The model with what was added, its parameters fitted to this very record.
    """

    name: str
    kind: str
    period_s: float
    time_s: FloatArray
    outputs: Mapping[str, str]
    measured: FloatArray
    before: FloatArray
    after: FloatArray
    settle: int = 0
    signals: Mapping[str, FloatArray] = field(default_factory=dict)
    refitted: FloatArray | None = None

    @property
    def held_out(self) -> bool:
        """Whether nothing was fitted to it."""
        return self.kind != "fitted"

    @property
    def title(self) -> str:
        """Name and kind."""
        return f"{self.name} ({self.kind})"

    @property
    def scored(self) -> int:
        """How many rows count."""
        return int(np.count_nonzero(np.isfinite(self.measured[self.settle :]).any(axis=1)))

    def errors(self, *, before: bool) -> FloatArray:
        """Return the errors of the scored rows, of shape (n, n_y).

        Parameters
        ----------
        before : bool
            Of the model as it was, or else with what was added.
        """
        return np.asarray((self.measured - (self.before if before else self.after))[self.settle :])

    @property
    def before_rms(self) -> FloatArray:
        """The rms error of each output of the model as it was."""
        return rms(self.errors(before=True))

    @property
    def after_rms(self) -> FloatArray:
        """The rms error of each output of the model with what was added."""
        return rms(self.errors(before=False))

    @property
    def swing(self) -> FloatArray:
        """The standard deviation of each output; 1 where it does not move."""
        swing = np.nanstd(self.measured[self.settle :], axis=0)
        return np.asarray(np.where(swing > 0.0, swing, 1.0))

    @property
    def worse(self) -> BoolArray:
        """Whether what was added made the error of each output larger, beyond rounding."""
        return np.asarray(self.after_rms > WORSE * self.before_rms)

    @property
    def refitted_rms(self) -> FloatArray:
        """The same by a fit to this very record; what is above it no other record knows."""
        if self.refitted is None:
            return np.full(len(self.outputs), np.nan)
        return rms((self.measured - self.refitted)[self.settle :])


def rms(errors: FloatArray) -> FloatArray:
    """Return the rms of each column over the rows that were read; NaN where none was simulated.

    Parameters
    ----------
    errors : ndarray of shape (n, n_y)
        Errors.
    """
    there = np.isfinite(errors)
    total = np.sum(np.where(there, errors, 0.0) ** 2, axis=0)
    return np.asarray(np.sqrt(total / np.where(there.any(axis=0), there.sum(axis=0), np.nan)))


@dataclass(frozen=True)
class CandidateRow:
    """One that competed.

    Parameters
    ----------
    round : int
        Round of the search, from 1 on.
    name, label : str
        Effect, open term, or pair joined by " + "; the same with the place.
    place : mapping of str to str
        Where it would sit.
    kind : {"name", "pair", "unnamed_term"}
        Which of these.
    fate : str
        ``added``; ``alias``: these records cannot separate it from the winner; ``too little``: the
        winner, but not worth adding; ``accepted``; ``refused``; ``not fitted``.
    accepted : bool
        Whether fitted and held-out rows all speak for it.
    alias : bool
        Whether it could stand for what was added in its round, or was added and has such.
    score : float
        Fitted gain less half log n a number, plus the held-out gain, in log-units.
    train_gain, later_gain, other_record_gain : float
        Gains in log-units on fitted rows, later time and another record; NaN where not known.
    held_out_z : float
        Mean gain of the held-out blocks over its standard error.
    p_value : float
        Chance of the fitted gain without it, times all that was searched.
    promised : float
        Log-units that a score test promised before it was fitted.
    time_constant_s : float
        τ of a lag with it, by a fit to the fitted rows.
    parameters_added : int
        Numbers that it brings.
    refused_on : tuple of str
        Rows on which it gains no more than chance: "fitted rows", "later time", "other record", or
        "held-out blocks" where too few of these gain; "share" where it explains too little of whole
        runs; empty where it was accepted.
    share, least_share : float
        Share of the squared errors that it explains and what it had to explain, on whole runs;
        NaN elsewhere. Infinite where its number is within reach of the sensor chain itself.
    """

    round: int
    name: str
    label: str
    place: Mapping[str, str]
    kind: str
    fate: str
    accepted: bool = False
    alias: bool = False
    score: float = math.nan
    train_gain: float = math.nan
    later_gain: float = math.nan
    other_record_gain: float = math.nan
    held_out_z: float = math.nan
    p_value: float = math.nan
    promised: float = math.nan
    time_constant_s: float = math.nan
    parameters_added: int = 0
    refused_on: tuple[str, ...] = ()
    share: float = math.nan
    least_share: float = math.nan

    @property
    def fitted(self) -> bool:
        """Whether it promised enough to be fitted."""
        return self.fate != "not fitted"

    @property
    def chosen(self) -> bool:
        """Whether it was added."""
        return self.fate == "added"


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis(Displayed):
    """What a model lacks.

    Parameters
    ----------
    verdict : str
        ``nothing_missing``, ``named``, ``alias_set``, ``provisional``, ``unnamed_term``,
        ``unexplained_structure`` or ``noise_model_wrong``.
    missing : tuple of MissingEffect
        In the order in which they were found.
    parameters : tuple of ParameterRow
        Of the model.
    unavailable : mapping of str to str
        Effects that these records cannot show, and why.
    remarks : tuple of str
        What a reader should know beside it.
    untold : tuple of Untold
        Effects about which these records do not decide.
    absent : tuple of Absent
        Effects that would have been seen.
    """

    verdict: str
    missing: tuple[MissingEffect, ...]
    parameters: tuple[ParameterRow, ...]
    unavailable: Mapping[str, str]
    remarks: tuple[str, ...] = ()
    untold: tuple[Untold, ...] = ()
    absent: tuple[Absent, ...] = ()

    if TYPE_CHECKING:
        # What each kind has, as a field or by computing it.
        @property
        def gap(self) -> Gap:
            """Errors on rows that were not fitted, as one number."""

        @property
        def runs(self) -> tuple[CheckRun, ...]:
            """All records, simulated before and after."""

        @property
        def candidates(self) -> tuple[CandidateRow, ...]:
            """All that competed."""

        @property
        def floor(self) -> tuple[float, ...]:
            """The noise of each output: no model of this kind foretells less."""

        @property
        def subject(self) -> str:
            """What lacks something, to begin a sentence."""

        @property
        def title(self) -> str:
            """What was diagnosed."""

    @property
    def names(self) -> tuple[str, ...]:
        """First names of what is missing."""
        return tuple(item.effect for item in self.missing)

    @property
    def outputs(self) -> Mapping[str, str]:
        """Outputs of the model and their units."""
        return self.runs[0].outputs

    @property
    def proof(self) -> tuple[CheckRun, ...]:
        """The runs that say most: check records, then rows held out, then what was fitted."""
        kinds = ("check", "left out", "held out", "fitted")
        found = ([run for run in self.runs if run.kind == kind] for kind in kinds)
        return tuple(next(runs for runs in found if runs))

    def parameter(self, name: str) -> ParameterRow:
        """Return a parameter of the model by name."""
        return next(row for row in self.parameters if row.name == name)

    def doubts_of(self, item: MissingEffect) -> tuple[str, ...]:
        """Return why the name of an effect is not firm; empty where it is."""
        return item.doubts if item.provisional else ()

    def _sheet(self) -> Sheet:
        found = tuple(
            (" or ".join(item.alias_labels or (item.label,)), item.equation)
            for item in self.missing
        )
        parameters = tuple(
            (
                row.name,
                round_to_error(row.after, row.after_stderr),
                "-" if row.unit == "1" else row.unit,
                "at its bound" if row.at_bound else "",
            )
            for row in self.parameters
        )
        columns = ("record", "output", *(("before", "after") if found else ("rms",)))
        errors = tuple(
            (run.title, name, *_sizes(run, j, unit, bool(found)))
            for run in self.runs
            for j, (name, unit) in enumerate(run.outputs.items())
        )
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
        verdict = self.verdict.replace("_", " ")
        return Sheet(
            f"Diagnosis of {self.title}: {verdict}",
            (
                Field("verdict", verdict, "good" if self.verdict in CLEAR else "advice"),
                *((Field("remarks", self.remarks, "advice"),) if self.remarks else ()),
            ),
            tuple(grids),
        )


def _sizes(run: CheckRun, j: int, unit: str, two: bool) -> tuple[str, ...]:
    pair = (float(run.before_rms[j]), float(run.after_rms[j]))
    scale = scale_of(unit, pair)
    return tuple(scale.text(size) for size in pair[0 if two else 1 :])
