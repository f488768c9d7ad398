"""How small an effect may be and still be named on these very records: planted and found again."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from comparisons.missing_effect.candidates import Bench, LagCandidate
from comparisons.missing_effect.diagnosis import MOST_EFFECTS, diagnose_data
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.evidence import LARGEST_P, LEAST_Z
from comparisons.missing_effect.excitation import block_rows
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.limit_table import CHECKED_AT, Limit, Limits, size_words
from comparisons.missing_effect.planting import Planter
from surge_core.errors import InputError
from surge_core.threads import one_thread

# A first search asks only whether the effect would be accepted against the model without it; it
# steps by this factor until the limit lies between two sizes, then halves the step twice.
STEP = 1.4
HALVINGS = 2
MOST_STEPS = 12
# Then the whole workflow, rivals and all, has to name it: the size grows by this until it does.
GROWTH = 1.2
MOST_GROWTHS = 6
# Where the check fails the limit is sought higher, so many times in all.
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

Progress = Callable[[Iterable["Limit"]], Iterable["Limit"]]


@one_thread()
def planted_limits(
    diagnosis: LagDiagnosis,
    *,
    effects: Sequence[Effect | str] | None = None,
    share: float = 0.9,
    trials: int = 8,
    seed: int = 0,
    check: bool = True,
    jobs: int = 1,
    progress: Progress = iter,
) -> Limits:
    """Plant each effect into the user's own records and find the smallest that is named.

    The coefficient is simulated by the fitted model with the effect in it, from the records' own
    φ, temperature, speed and segments; noise like theirs is added; and the same workflow is run.
    An effect counts as named when it stands in an alias set that is not provisional.

    Parameters
    ----------
    diagnosis : LagDiagnosis
        Of the records; what it has added stays in the model.
    effects : sequence of Effect or str, optional
        In place of the whole catalogue of the diagnosis; one that is given as an effect competes
        beside it.
    share : float
        Share of the trials in which it must be named.
    trials : int
        Trials a size. All sizes meet the same noise, all effects too.
    seed : int
        Of the noise.
    check : bool
        Whether 1.5 times each limit is planted in fresh trials; where too few of these name the
        effect the limit is sought above that.
    jobs : int
        Processes; the limits are the same for any number of them.
    progress : callable
        Wraps the iteration over the limits as they are found.

    Raises
    ------
    InputError
        For an unknown effect, a share outside (0, 1], or no trial.
    """
    if not 0.0 < share <= 1.0:
        raise InputError("share", expected="more than 0 and at most 1", found=f"{share:g}")
    if trials < 1 or jobs < 1:
        raise InputError("trials, jobs", expected="at least 1", found=f"{trials}, {jobs}")
    begin = time.perf_counter()
    wanted = [_wanted(e, diagnosis.catalogue) for e in effects or diagnosis.catalogue]
    if diagnosis.whole_runs:
        return _of_twins(diagnosis, wanted)
    drill = _Drill(
        Planter.of(diagnosis),
        diagnosis.before.structure.terms,
        math.ceil(share * trials - 1e-9),
        trials,
        seed,
        check,
        tuple({e.name: e for e in (*diagnosis.catalogue, *wanted)}.values()),
    )
    known = {
        **diagnosis.unavailable,
        **dict.fromkeys(diagnosis.names, "these records have it already"),
    }
    never = _why_never(diagnosis)
    tasks = [(drill, effect, known.get(effect.name, never)) for effect in wanted]
    rows = tuple(progress(_done(tasks, jobs)))
    seconds = time.perf_counter() - begin
    return Limits(rows, share, trials, seed, seconds)


def _wanted(effect: Effect | str, catalogue: Sequence[Effect]) -> Effect:
    if isinstance(effect, Effect):
        return effect
    known = {e.name: e for e in catalogue}
    if effect not in known:
        raise InputError("effects", expected=f"of {', '.join(known)}", found=repr(effect))
    return known[effect]


def _why_never(diagnosis: LagDiagnosis) -> str:
    """Return why nothing that is planted beside what these records hold would be named firmly."""
    if any(effect.unnamed for effect in diagnosis.after.structure.effects):
        return "a term without a name stands in the model, and the workflow stops at it"
    if diagnosis.verdict == "provisional":
        return "what the model leaves of these records is not noise, and no name beside it is firm"
    if len(diagnosis.after.structure.effects) >= MOST_EFFECTS:
        return f"the workflow adds no more than {MOST_EFFECTS} effects"
    return ""


_Task = tuple["_Drill", Effect, str]
_Test = Callable[[Effect, float, int, int], bool]


def _done(tasks: Sequence[_Task], jobs: int) -> Iterator[Limit]:
    from joblib import Parallel, delayed

    yield from Parallel(jobs, return_as="generator")(delayed(_limit)(task) for task in tasks)


def _limit(task: _Task) -> Limit:
    drill, effect, why_none = task
    return drill.limit(effect, why_none)


@dataclass(frozen=True)
class _Drill:
    """Trials on one set of records."""

    planter: Planter
    terms: tuple[str, ...]
    needed: int
    trials: int
    seed: int
    check: bool
    catalogue: tuple[Effect, ...]

    def limit(self, effect: Effect, why_none: str) -> Limit:
        """Find the limit of one effect."""
        amplitude = effect.parameters[0]
        none = Limit(effect.name, amplitude.name, amplitude.unit)
        why_none = why_none or self._not_planted(effect)
        if why_none:
            return _without(none, why_none)
        begin = time.perf_counter()
        first = self._first_size(effect)
        if first is None:
            return _without(none, "these records show no trace of it, however large")
        size = self._accepted_from(effect, first)
        found, runs = none, 0
        for attempt in range(ATTEMPTS):
            size, named, run = self._named_from(effect, size)
            runs += run
            if named < self.needed:
                why_none = f"not named up to {size_words(size, amplitude.unit)}"
                return _timed(_without(none, why_none), runs, time.perf_counter() - begin)
            found = self._found(effect, size, named, none, attempt)
            runs += found.check_trials
            if not self.check or found.check_named >= self.needed:
                break
            # It was named by luck, or larger ones take other names: the limit lies higher.
            size = found.check_size
        return _timed(found, runs, time.perf_counter() - begin)

    def _named_from(self, effect: Effect, size: float) -> tuple[float, int, int]:
        """Return the size from which on the whole workflow names an effect."""
        runs = 0
        for _ in range(MOST_GROWTHS):
            named, run = self._trials(effect, size, self._named)
            runs += run
            if named >= self.needed or size >= _largest(effect):
                break
            size = min(GROWTH * size, _largest(effect))
        return size, named, runs

    def _not_planted(self, effect: Effect) -> str:
        if effect.port == "noise":
            return "it is a property of φ, not of the model"
        return ""

    def _found(self, effect: Effect, size: float, named: int, none: Limit, attempt: int) -> Limit:
        shape = self.planter.shape(effect)
        others = [p.name for p in effect.nonlinear][0 if effect.linear else 1 :]
        clean = self.planter.planted(effect, size, np.random.default_rng([self.seed, PHASES]))
        checked = self.trials if self.check else 0
        check_size = min(CHECKED_AT * size, _largest(effect))
        kind = FRESH + attempt
        check_named = sum(self._named(effect, check_size, kind, i) for i in range(checked))
        return Limit(
            none.effect,
            none.parameter,
            none.unit,
            size,
            self.planter.promise(clean)[1],
            dict(zip(others, shape.tolist(), strict=True)),
            named,
            self.trials,
            check_size,
            check_named,
            checked,
        )

    def _first_size(self, effect: Effect) -> float | None:
        """Return a size whose gain on the fitted rows should be about what is asked."""
        largest = _largest(effect)
        asked = self._asked(effect)
        size = min(10.0 * effect.parameters[0].step, largest)
        for _ in range(8):
            clean = self.planter.planted(effect, size, np.random.default_rng([self.seed, PHASES]))
            gain, _ = self.planter.promise(clean)
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

    def _accepted_from(self, effect: Effect, first: float) -> float:
        """Bisect the size from which on the effect is accepted against the model without it."""
        largest, size = _largest(effect), first
        low, high = 0.0, math.inf
        for _ in range(MOST_STEPS):
            if self._trials(effect, size, self._accepted)[0] >= self.needed:
                high, size = size, size / STEP
            else:
                low, size = size, min(size * STEP, largest)
            if low > 0.0 and (math.isfinite(high) or low >= largest):
                break
        if not math.isfinite(high):
            return low
        for _ in range(HALVINGS if low > 0.0 else 0):
            middle = math.sqrt(low * high)
            if self._trials(effect, middle, self._accepted)[0] >= self.needed:
                high = middle
            else:
                low = middle
        return high

    def _trials(self, effect: Effect, size: float, test: _Test) -> tuple[int, int]:
        """Run trials until it is clear whether enough pass; return how many did, of how many."""
        passed = run = 0
        while run < self.trials and run - passed <= self.trials - self.needed:
            passed += test(effect, size, TRIALS, run)
            run += 1
        return passed, run

    def _measured(self, effect: Effect, size: float, kind: int, trial: int) -> LagData:
        rng = np.random.default_rng([self.seed, kind, trial])
        clean = self.planter.planted(effect, size, rng)
        return self.planter.measured(clean, rng)

    def _accepted(self, effect: Effect, size: float, kind: int, trial: int) -> bool:
        """Tell whether the effect alone is accepted, without rivals."""
        data, fit = self._measured(effect, size, kind, trial), self.planter.fit
        metric = self.planter.source.noise.metric().on(np.arange(data.n_samples))
        bench = Bench.start(
            data, fit.structure, metric, [fit.nonlinear], block_rows(data), len(self.catalogue)
        )
        probe = bench.prober().probe(effect)
        if not probe.starts:
            return False
        candidate = bench.fitted(probe)
        noise = bench.noise(candidate)
        bench = bench.in_metric_of(candidate, noise)
        if noise.coloured or noise.heavy_tailed:
            own = candidate.nonlinear[bench.fit.nonlinear.size :]
            candidate = bench.fitted(replace(probe, starts=(own,)))
        alone = LagCandidate((effect,), candidate)
        return bench.weighed(alone).accepted

    def _named(self, effect: Effect, size: float, kind: int, trial: int) -> bool:
        data = self._measured(effect, size, kind, trial)
        found = diagnose_data(data, self.terms, catalogue=self.catalogue)
        return any(effect.name in item.alias_set and not item.provisional for item in found.missing)


def _of_twins(diagnosis: LagDiagnosis, effects: Sequence[Effect]) -> Limits:
    """Return what twins of whole runs show: there the limits are known without planting."""
    sizes = {row.effect: row for row in diagnosis.absent}
    never = {
        **{row.effect: row.why for row in diagnosis.untold},
        **diagnosis.unavailable,
        **dict.fromkeys(diagnosis.tau_by_alias_s, "these records have it already"),
        **dict.fromkeys(diagnosis.names, "these records have it already"),
    }
    rows = []
    for effect in effects:
        row, amplitude = sizes.get(effect.name), effect.parameters[0]
        none = Limit(effect.name, amplitude.name, amplitude.unit)
        if row is None:
            rows.append(_without(none, never.get(effect.name, "it is judged in other rows")))
        else:
            rows.append(Limit(effect.name, row.parameter, row.unit, row.size))
    return Limits(tuple(rows), 1.0, 0, 0, 0.0, whole_runs=True)


def _largest(effect: Effect) -> float:
    high = effect.parameters[0].high
    return LARGEST_SHARE * high if math.isfinite(high) else LARGEST_LINEAR


def _without(none: Limit, why: str) -> Limit:
    return replace(none, why_none=why)


def _timed(limit: Limit, runs: int, seconds: float) -> Limit:
    return replace(limit, runs=runs, seconds=seconds)
