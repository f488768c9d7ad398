"""What a diagnosis is, of a lag series or of a user's model: verdict, names, before, after."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.quantities import (
    last_digits,
    number_rows,
    open_words,
    plain_name,
    scale_of,
    typical,
)
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.where_rows import SYMBOLS, Where
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.rounding import significant

# Under this name the evidence holds how many standard errors large an effect is as a whole.
SIZE = "size_in_errors"
# Below this many standard errors an effect is not distinguished from none: its 95 % interval
# holds zero.
LEAST_SIZE = 2.0
# And under this one the largest correlation of two numbers of the effect, from which on their
# errors say little one by one.
CORRELATION, MUCH_CORRELATED = "largest_correlation", 0.9
# Verdicts that leave nothing open.
CLEAR = ("named", "nothing_missing", "alias_set")


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
        Whether the name stands for something that may be another: whether there are doubts.
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

    def doubted(self, why: str) -> MissingEffect:
        """Return it with one more reason why its name is not firm."""
        return replace(self, provisional=True, doubts=(*self.doubts, why))


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
        runs, "end of the search" where a number of it ran there; empty where it was accepted.
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
    def shown(self) -> str:
        """Its name and place; the name of a lag's says by itself where it acts."""
        return plain_name(open_words(self.name) if "port" in self.place else self.label)

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
        def wheres(self) -> tuple[Where, ...]:
            """Where the residuals of each output stand out, the one missed most first.

            Empty where the rows are too few or the run could not be simulated.
            """

        def own_document(self) -> dict[str, Any]:
            """Return what the JSON of this kind has beside that of all."""

    # Whether limits and separating measurements can be asked for.
    of_series: ClassVar[bool] = False

    # What one kind has to say and another has not.
    @property
    def whole_runs(self) -> bool:
        """Whether the records were taken as whole runs, averaged over the stall cells."""
        return False

    @property
    def acts_unscored(self) -> bool:
        """Whether all that is missing acts where the runs are not scored."""
        return False

    @property
    def equations(self) -> tuple[str, ...]:
        """The model before and after, in a line each."""
        return ()

    @property
    def lag_known(self) -> bool:
        """Whether the records hold the time constant of a lag model."""
        return True

    @property
    def tau_said(self) -> tuple[str, str]:
        """The time constant as it is, and where it went with what was added."""
        return "", ""

    @property
    def fit_said(self) -> str:
        """How inputs run between samples and how late each acts."""
        return ""

    @property
    def noise_said(self) -> str:
        """What the noise is like."""
        return ""

    @property
    def structure_said(self) -> str:
        """What a test of all effects together finds in what is left."""
        return ""

    @property
    def ledger_said(self) -> tuple[str, ...]:
        """Which effects were looked for in another way than by a fit."""
        return ()

    def alias_said(self, item: MissingEffect) -> str:
        """Return why the names of a set look alike, or what would separate them."""
        confirm = item.confirm.get(item.label, "")
        return f"; what would: {confirm}" if confirm else ""

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

    @property
    def telling_run(self) -> CheckRun:
        """The run that the model before misses most, of those that say most."""

        def missed(run: CheckRun) -> float:
            share = float(np.sum((run.before_rms / run.swing) ** 2))
            return share if math.isfinite(share) else -1.0

        return max(self.proof, key=missed)

    def effect_grid(self) -> Grid:
        """Return a row for each number of what is missing."""
        rows: list[tuple[str, ...]] = []
        for item in self.missing:
            more = len(item.alias_labels) - 2
            named = [*map(plain_name, item.alias_labels[:2]), *[f"{more} more"] * (more > 0)]
            numbers = number_rows(item.effect, item.parameters) or (("", ""),)
            first = (" or ".join(named), item.equation)
            rows += [(*(first if i == 0 else ("", "")), *n) for i, n in enumerate(numbers)]
        header = ("effect", "adds", "number", "value")
        return Grid("What is missing", header, tuple(rows), frozenset(range(3)))

    def parameter_grid(self) -> Grid:
        """Return a row for each parameter of the model."""
        rows = []
        for row in self.parameters:
            scale = scale_of(row.unit, (row.before, row.after))
            values = [(row.after, row.after_stderr)]
            if self.missing:
                values.insert(0, (row.before, row.before_stderr))
            cells = [last_digits(scale.factor * v, scale.factor * error) for v, error in values]
            bound = ", at its bound" if row.at_bound else ""
            rows.append((row.name, *cells, scale.unit + bound))
        both = ("before", "after") if self.missing else ("value",)
        header = ("parameter", *both, "unit")
        words = frozenset((0, len(header) - 1))
        title = "Parameters; standard errors in the last digits"
        return Grid(title, header, tuple(rows), words, folded=len(rows) > 8)

    def errors_grid(self) -> Grid:
        """Return a row for each output of each run."""
        sizes = [np.array([run.before_rms, run.after_rms]) for run in self.runs]
        scales = [
            scale_of(unit, [typical(np.ravel([size[:, j] for size in sizes]))])
            for j, unit in enumerate(self.outputs.values())
        ]
        rows = []
        for run, size in zip(self.runs, sizes, strict=True):
            for j, name in enumerate(run.outputs):
                before, after = float(size[0, j]), float(size[1, j])
                fell = [scales[j].text(after, 4)]
                if self.missing:
                    ratio = f"{significant(before / after, 3)}×" if after > 0.0 else "n/a"
                    fell = [scales[j].text(before, 4), *fell, ratio]
                share = f"{significant(100.0 * after / float(run.swing[j]), 3)} %"
                kind = f"{run.scored} {run.kind}"
                rows.append((run.name, kind, SYMBOLS.get(name, name), *fell, share))
        both = ("before", "after", "smaller") if self.missing else ("rms",)
        header = ("record", "rows", "output", *both, "of the swing")
        return Grid("rms errors of the free run", header, tuple(rows), frozenset(range(3)))

    def _sheet(self) -> Sheet:
        grids = (self.effect_grid(), self.errors_grid(), self.parameter_grid())
        verdict = self.verdict.replace("_", " ")
        return Sheet(
            f"Diagnosis of {self.title}: {verdict}",
            (
                Field("verdict", verdict, "good" if self.verdict in CLEAR else "advice"),
                *((Field("remarks", self.remarks, "advice"),) if self.remarks else ()),
            ),
            tuple(grid for grid in grids if grid.rows),
        )
