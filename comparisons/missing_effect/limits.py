"""How small an effect may be and still be named on these very records: planted and found again."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from comparisons.missing_effect.diagnosis import MOST_EFFECTS, diagnose_data
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.evidence import LARGEST_P, LEAST_Z
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.planting import Planter
from comparisons.missing_effect.quantities import size_words, symbol
from surge_core.errors import require
from surge_core.threads import one_thread

# Share of the trials in which an effect of its limit is named.
SHARE = 0.9
# From the size that should be accepted on, the size goes by this factor until the whole workflow,
# rivals and all, just names it.
GROWTH = 1.2
MOST_GROWTHS = 6
# The check plants this many times the limit. Where it fails the limit is sought higher, so many
# times in all.
CHECKED_AT = 1.5
ATTEMPTS = 3
# Which noise is drawn: of the trials, and from here on of the checks.
TRIALS, PHASES, FRESH = 0, 1, 2
# Standard deviations by which what is asked must be overshot to be met in nine trials of ten.
NINE_OF_TEN = 1.28
# An effect that wins less than this at its largest size leaves no trace.
NO_TRACE = 1.0
# Share of the bounds that a size may reach.
LARGEST_SHARE = 0.9
LARGEST_LINEAR = 1e6
# How an effect is computed, and nothing of the machine.
NOT_SHOWN = ("prolonged", "intervals", "phi_from", "phi_to")
LAGGED = {1.0: "behind the lag", 0.0: "not lagged"}
KNOWN_ALREADY = "these records have it already"


@dataclass(frozen=True)
class Limit:
    """The smallest size of one effect that would have been named.

    Parameters
    ----------
    effect : str
        Its name.
    parameter, unit : str
        Which of its parameters is its size, and the unit.
    size : float
        The limit; NaN where there is none.
    excess_sigma : float
        Rms that an effect of that size leaves once the model without it is fitted again, in
        standard deviations of the noise.
    at : mapping of str to float
        Its other parameters, where it was planted.
    named : int
        How often it was named at that size.
    check_size : float
        The size of the check.
    check_named : int
        How often it was named in fresh trials at that size.
    why_none : str
        Why there is no limit; empty where there is one.
    """

    effect: str
    parameter: str
    unit: str
    size: float = math.nan
    excess_sigma: float = math.nan
    at: Mapping[str, float] = field(default_factory=dict)
    named: int = 0
    check_size: float = math.nan
    check_named: int = 0
    why_none: str = ""

    @property
    def found(self) -> bool:
        """Whether there is a limit."""
        return math.isfinite(self.size)

    def to_json(self) -> dict[str, Any]:
        """Return the row as plain JSON types; null where nothing is known."""
        sizes = ("size", "excess_sigma", "check_size")
        unknown = [name for name in sizes if math.isnan(getattr(self, name))]
        return {**asdict(self), **dict.fromkeys(unknown)}

    def _cells(self, trials: int) -> tuple[str, str, str, str]:
        """Return effect, size, excess and check as they are printed."""
        at = ", ".join(
            LAGGED[value] if name == "lagged" else f"{symbol(name)} {value:.3g}"
            for name, value in self.at.items()
            if name not in NOT_SHOWN
        )
        size = f"{symbol(self.parameter)} = {size_words(self.size, self.unit)}"
        excess = f"{self.excess_sigma:.2f} σ" if math.isfinite(self.excess_sigma) else ""
        check = f"{self.check_named} of {trials} at {CHECKED_AT:g} times that"
        at_words = f" ({at})" if at else ""
        return self.effect, size + at_words, excess, check if trials else ""


@dataclass(frozen=True)
class Limits:
    """The limits of all effects on one set of records.

    Parameters
    ----------
    rows : tuple of Limit
        One an effect, in the order of the catalogue.
    share : float
        Share of the trials in which an effect of its limit is named.
    trials : int
        Trials a size.
    whole_runs : bool
        Whether the records are whole runs, whose twins show the limits without a trial.
    """

    rows: tuple[Limit, ...]
    share: float
    trials: int
    whole_runs: bool = False

    def __getitem__(self, effect: str) -> Limit:
        """Return the limit of an effect."""
        return next(row for row in self.rows if row.effect == effect)

    @property
    def lines(self) -> tuple[str, ...]:
        """What the limits say, a line an effect."""
        found = [row for row in self.rows if row.found]
        cells = [row._cells(self.trials) for row in found]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = [
            f"Smallest effect that would have been named in {100 * self.share:.0f} % of "
            f"{self.trials} trials on these records:"
        ]
        if self.whole_runs:
            lines = ["Smallest effect that stands out of twins of these records:"]
        lines += [
            f"{name:<{widths[0]}}  {size:<{widths[1]}}  {excess:>{widths[2]}}  {check}"
            for name, size, excess, check in cells
        ]
        lines += [f"{row.effect}: no limit, {row.why_none}" for row in self.rows if not row.found]
        if checked := self.trials * len(found):
            lines.append(
                f"check: {CHECKED_AT:g} times the limit, planted in fresh trials, was named in "
                f"{sum(row.check_named for row in found)} of {checked}; a limit whose check "
                "had failed was raised"
            )
        return tuple(lines)

    def to_json(self) -> dict[str, Any]:
        """Return the limits as plain JSON types."""
        own = {name: value for name, value in vars(self).items() if name != "rows"}
        return {**own, "effects": [row.to_json() for row in self.rows]}


@one_thread()
def planted_limits(
    diagnosis: LagDiagnosis,
    *,
    effects: Sequence[str] | None = None,
    trials: int = 8,
    jobs: int = 1,
    progress: Callable[[Iterable[Limit]], Iterable[Limit]] = iter,
) -> Limits:
    """Plant each effect into the user's own records and find the smallest that is named.

    The coefficient is simulated by the fitted model with the effect in it, from the records' own
    φ, temperature, speed and segments; noise like theirs is added; and the same workflow is run.
    An effect counts as named when it stands in an alias set that is not provisional. Then 1.5 times
    each limit is planted in fresh trials; where too few of these name the effect the limit is
    sought above that.

    Parameters
    ----------
    diagnosis : LagDiagnosis
        Of the records; what it has added stays in the model.
    effects : sequence of str, optional
        In place of the whole catalogue of the diagnosis.
    trials : int
        Trials a size. All sizes meet the same noise, all effects too.
    jobs : int
        Processes; the limits are the same for any number of them.
    progress : callable
        Wraps the iteration over the limits as they are found.

    Raises
    ------
    InputError
        For an unknown effect, or no trial.
    """
    from joblib import Parallel, delayed

    require(min(trials, jobs) >= 1, "trials, jobs", "at least 1", f"{trials}, {jobs}")
    known = {effect.name: effect for effect in diagnosis.catalogue}
    for name in effects or ():
        require(name in known, "effects", f"of {', '.join(known)}", repr(name))
    wanted = [known[name] for name in effects or known]
    if diagnosis.whole_runs:
        return Limits(_of_twins(diagnosis, wanted), 1.0, 0, whole_runs=True)
    drill = _Drill(
        Planter.of(diagnosis),
        diagnosis.before.structure.terms,
        math.ceil(SHARE * trials - 1e-9),
        trials,
        diagnosis.catalogue,
    )
    why = {**diagnosis.unavailable, **dict.fromkeys(diagnosis.names, KNOWN_ALREADY)}
    never = _why_never(diagnosis)
    tasks = (delayed(drill.limit)(effect, why.get(effect.name, never)) for effect in wanted)
    rows = tuple(progress(Parallel(jobs, return_as="generator")(tasks)))
    return Limits(rows, SHARE, trials)


def _why_never(diagnosis: LagDiagnosis) -> str:
    """Return why nothing that is planted beside what these records hold would be named firmly."""
    if any(effect.unnamed for effect in diagnosis.after.structure.effects):
        return "a term without a name stands in the model, and the workflow stops at it"
    if diagnosis.verdict == "provisional":
        return "what the model leaves of these records is not noise, and no name beside it is firm"
    if len(diagnosis.after.structure.effects) >= MOST_EFFECTS:
        return f"the workflow adds no more than {MOST_EFFECTS} effects"
    return ""


@dataclass(frozen=True)
class _Drill:
    """Trials on one set of records."""

    planter: Planter
    terms: tuple[str, ...]
    needed: int
    trials: int
    catalogue: tuple[Effect, ...]

    def limit(self, effect: Effect, why_none: str) -> Limit:
        """Find the limit of one effect."""
        none = _no_limit(effect)
        if effect.port == "noise":
            why_none = why_none or "it is a property of φ, not of the model"
        if why_none:
            return replace(none, why_none=why_none)
        first = self._first_size(effect)
        if first is None:
            return replace(none, why_none="these records show no trace of it, however large")
        size, found = first, none
        for attempt in range(ATTEMPTS):
            size, named = self._named_from(effect, size)
            if named < self.needed:
                return replace(none, why_none=f"not named up to {size_words(size, none.unit)}")
            if size == first:
                size, named = self._lowered(effect, size, named)
            found = self._found(effect, size, named, attempt)
            if found.check_named >= self.needed:
                break
            # It was named by luck, or larger ones take other names: the limit lies higher.
            size = found.check_size
        return found

    def _lowered(self, effect: Effect, size: float, named: int) -> tuple[float, int]:
        """Return a smaller size at which the workflow still names an effect, and how often."""
        for _ in range(MOST_GROWTHS):
            fewer = self._trials(effect, size / GROWTH)
            if fewer < self.needed:
                break
            size, named = size / GROWTH, fewer
        return size, named

    def _named_from(self, effect: Effect, size: float) -> tuple[float, int]:
        """Return the size from which on the whole workflow names an effect, and how often."""
        for _ in range(MOST_GROWTHS):
            named = self._trials(effect, size)
            if named >= self.needed or size >= _largest(effect):
                break
            size = min(GROWTH * size, _largest(effect))
        return size, named

    def _found(self, effect: Effect, size: float, named: int, attempt: int) -> Limit:
        others = [p.name for p in effect.nonlinear][0 if effect.linear else 1 :]
        check_size = min(CHECKED_AT * size, _largest(effect))
        return replace(
            _no_limit(effect),
            size=size,
            excess_sigma=self._promise(effect, size)[1],
            at=dict(zip(others, self.planter.shape(effect).tolist(), strict=True)),
            named=named,
            check_size=check_size,
            check_named=sum(
                self._named(effect, check_size, FRESH + attempt, i) for i in range(self.trials)
            ),
        )

    def _promise(self, effect: Effect, size: float) -> tuple[float, float]:
        clean = self.planter.planted(effect, size, np.random.default_rng([0, PHASES]))
        return self.planter.promise(clean)

    def _first_size(self, effect: Effect) -> float | None:
        """Return a size whose gain on the fitted rows should be about what is asked."""
        largest, asked = _largest(effect), self._asked(effect)
        size = min(10.0 * effect.parameters[0].step, largest)
        for _ in range(8):
            gain, _ = self._promise(effect, size)
            if gain < NO_TRACE and size >= largest:
                return None
            if 0.8 < gain / asked < 1.25:
                break
            # The gain grows with the square of the size.
            size = min(size * min(math.sqrt(asked / max(gain, 1e-12)), 1e3), largest)
        return size

    def _asked(self, effect: Effect) -> float:
        """Return the gain without noise at which acceptance should succeed in nine of ten.

        Twice the gain of an effect with that many numbers follows a chi-squared law about it.
        """
        from scipy.stats import chi2

        columns = self.planter.coefficients(effect, 1.0, np.random.default_rng(0)).size
        numbers = columns + len(effect.free)
        searched = effect.searched * len(self.catalogue)
        least = float(chi2.isf(LARGEST_P / searched, numbers))
        twice = least
        for _ in range(20):
            spread = math.sqrt(2.0 * (numbers + 2.0 * twice))
            twice = max(least - numbers + NINE_OF_TEN * spread, 1.0)
        # The held-out rows, about as many, must win as well.
        return max(0.5 * twice, (LEAST_Z + NINE_OF_TEN) ** 2)

    def _trials(self, effect: Effect, size: float) -> int:
        """Run trials until it is clear whether enough name the effect; return how many did."""
        passed = run = 0
        while run < self.trials and run - passed <= self.trials - self.needed:
            passed += self._named(effect, size, TRIALS, run)
            run += 1
        return passed

    def _named(self, effect: Effect, size: float, kind: int, trial: int) -> bool:
        rng = np.random.default_rng([0, kind, trial])
        data = self.planter.measured(self.planter.planted(effect, size, rng), rng)
        found = diagnose_data(data, self.terms, catalogue=self.catalogue)
        return any(effect.name in item.alias_set and not item.provisional for item in found.missing)


def _of_twins(diagnosis: LagDiagnosis, effects: Sequence[Effect]) -> tuple[Limit, ...]:
    """Return what twins of whole runs show: there the limits are known without planting."""
    sizes = {row.effect: row for row in diagnosis.absent}
    never = {
        **{row.effect: row.why for row in diagnosis.untold},
        **diagnosis.unavailable,
        **dict.fromkeys((*diagnosis.tau_by_alias_s, *diagnosis.names), KNOWN_ALREADY),
    }
    rows = []
    for effect in effects:
        row = sizes.get(effect.name)
        why = never.get(effect.name, "it is judged in other rows")
        rows.append(
            replace(_no_limit(effect), why_none=why)
            if row is None
            else Limit(effect.name, row.parameter, row.unit, row.size)
        )
    return tuple(rows)


def _no_limit(effect: Effect) -> Limit:
    return Limit(effect.name, effect.parameters[0].name, effect.parameters[0].unit)


def _largest(effect: Effect) -> float:
    high = effect.parameters[0].high
    return LARGEST_SHARE * high if math.isfinite(high) else LARGEST_LINEAR
