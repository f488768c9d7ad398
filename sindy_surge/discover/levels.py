"""The search on segments that grow: short ones first, which a wrong model still follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.discover.collocation import Collocation, Fit
from sindy_surge.discover.trajectories import LEAST_NOISE, WiderFeatures, factors
from sindy_surge.linear_problem import LinearProblem, Support
from sindy_surge.search import Search, Tried, best_of_equation, chosen_support
from surge_core.types import FloatArray, IndexArray

# Rows of the segments on which the full library is fitted. Supports are compared on the last of
# them, and then on longer ones.
_FULL_ROWS = (30, 60)
_LONGER_ROWS = (300, None)
# How rarely noise may leave so little by chance, and the share of it that noise which is there
# leaves at least: its size is read from rows that an input's own roughness is in.
_BY_CHANCE, _LEAST_LEFT = 1e-4, 0.6
# Two supports whose scores, in χ², are closer than this are rivals (Kass & Raftery 1995).
RIVAL = 10.0
# By how much, in χ², an input that is held must be ahead of a smooth one. Of two models whose runs
# are D standard deviations of noise apart, the false one is ahead by D² less on average, 2 D its
# deviation: by so much with 1e-4 at most, whatever D is. On heat into two masses, its input a ramp
# and a step, a smooth truth was once behind by 10.
HELD = float(norm.isf(_BY_CHANCE)) ** 2
# How often noise may open steps that lie on rows, which costs no more than a little evidence.
_NEEDLESS = 1e-2
# Parts of a step between rows, tried one after the other until the error of the rule, which falls
# with their fourth power, adds less than this share to the variance of the coefficients.
_PARTS = (4, 16)
_COARSE = 0.1
# A coefficient is at first believed to make no term larger than so many times the derivative.
_LARGEST_TERM = 10.0
# Ridge of the first regression, as a share of each term's own size: enough to keep it finite.
_START_RIDGE = 1e-4


@dataclass
class Level(Search[Fit]):
    """Supports tried on segments of one length."""

    likelihood: Collocation


# The supports tried at each length of segments, the last first, and the best of them.
Found = tuple[list[Level], Tried[Fit]]


def search_by_levels(
    problem: Collocation, rates: FloatArray, given: Sequence[int], optimizer: Any, *, full: bool
) -> Found:
    """Return the supports tried at each length of segments, the last first, and the best.

    All is done again by a finer rule between rows where that matters.
    """
    found = searched(problem, rates, given, optimizer, None, full=full)
    for parts in _PARTS:
        levels, best = found
        last, most = levels[0].likelihood, _COARSE * len(best.support)
        enough = not best.support or not np.isfinite(best.score)
        if enough or last.rule_moves(best.support, best.fit) <= most:
            break
        few = replace(last, parts=parts).rule_moves(best.support, best.fit) > most
        if few and parts < _PARTS[-1]:
            continue
        finer = replace(problem, parts=parts)
        again = searched(finer, rates, given, optimizer, best.fit, full=full)
        # Not where only shorter stretches are followed.
        whole = again[0][0].likelihood.rows is None or last.rows is not None
        found = again if whole and np.isfinite(again[1].score) else found
    return found


def with_noisy_inputs(
    problem: Collocation, rates: FloatArray, given: Sequence[int], optimizer: Any, exact: Found
) -> Found:
    """Search again with inputs as noisy as their own rows show, and return what is likelier.

    An input that is rough of itself shows as noisy too; the record is likelier without such noise,
    and clearly so: where it is not, what the rows show counts. All inputs are noisy at first, then
    ever fewer of them.
    """
    shown, (shortness, least) = problem.data.input_noise, _unlikely(exact)
    noisy = np.flatnonzero(shown)
    for size in range(noisy.size, 0, -1):
        tried = []
        for some in combinations(noisy.tolist(), size):
            noise = np.where(np.isin(np.arange(shown.size), some), shown, 0.0)
            trial = replace(problem, input_noise=noise)
            tried.append(search_by_levels(trial, rates, given, optimizer, full=True))
        found = min(filter(_leaves_enough, tried), key=_unlikely, default=exact)
        if _unlikely(found) < (shortness, least + RIVAL):
            return found
    return exact


def _leaves_enough(found: Found) -> bool:
    """Return whether what is left is not less than the noise assumed leaves.

    An input that is rough and exact, taken as noise, explains a law that the library lacks: with
    u |u| that mostly left 0.03 to 0.55 of its noise, where noise that is there left 0.98 to 1.02,
    and 0.69 to 0.97 on inputs that are rough as well.
    """
    (level, *_), best = found
    problem = level.likelihood
    free = problem.joined.sum() * np.count_nonzero(~problem.hidden) - len(best.support)
    least = min(chi2.ppf(_BY_CHANCE, max(free, 1)), _LEAST_LEFT * free)
    return bool(best.fit.chi2 > least)


def _unlikely(found: Found) -> tuple[float, float]:
    """Return what orders searches with other noise: the longest segments first, then likelihood."""
    (level, *_), best = found
    if not np.isfinite(best.score):
        return np.inf, np.inf
    rows = level.likelihood.rows
    score = level.likelihood.deviance(best.fit) + level.price * len(best.support)
    return -np.inf if rows is None else -float(rows), score


def searched(
    problem: Collocation,
    rates: FloatArray,
    given: Sequence[int],
    optimizer: Any,
    near: Fit | None,
    *,
    full: bool,
) -> Found:
    """Return the supports tried at each length of segments, and the best, by one rule.

    Again with other inputs between rows where the best is clearly likelier with them.
    """
    n_terms, n_states = problem.known.shape
    # Inputs that exclude one another have a product of nothing; a library may hold a term twice.
    there = independent_columns(problem.features.values(problem.data.y, problem.data.u))
    equations = [
        tuple((state * n_terms + there).tolist()) for state in range(n_states) if state not in given
    ]
    free = np.concatenate(equations)
    found = _searched(*_with_inputs(problem, rates, free, near), equations, optimizer, full=full)
    for _ in range(1 + problem.data.u.shape[1] if full else 0):
        ahead = [(gain - least, fit, own) for gain, least, fit, own in other_inputs(*found)]
        more, fit, own = max(ahead, key=lambda each: each[0], default=(0.0, found[1].fit, problem))
        if more <= 0.0:
            break
        again = _searched(*_fit_all(own, free, fit, rates), equations, optimizer, full=True)
        if _unlikely(again)[0] > _unlikely(found)[0]:
            break
        found = again
    return found


def other_inputs(
    levels: list[Level], best: Tried[Fit]
) -> list[tuple[float, float, Fit, Collocation]]:
    """Return the best with an input held that was smooth, or the reverse, or open at jumps.

    Each with how far ahead it is, in χ², and how far it has to be.
    """
    problem, data, result = levels[0].likelihood, levels[0].likelihood.data, []
    if not np.isfinite(best.score):
        return []
    # One that does nothing but jump at open moments stays as it is meanwhile.
    may_turn = ~np.all(data.open | (np.diff(data.u, axis=0) == 0.0), axis=0)
    turned = [data.held ^ (np.arange(may_turn.size) == i) for i in np.flatnonzero(may_turn)]
    ways = [(HELD * (held.sum() - data.held.sum()), replace(data, held=held)) for held in turned]
    way = data.open_at_jumps
    if free := data.y.shape[1] * int((data.within() & ~way.within()).sum()):
        ways.append((chi2.isf(_NEEDLESS, free), way))
    for least, way in ways:
        level = replace(levels[0], likelihood=replace(problem, data=way), tried={})
        tried = level.try_support(best.support, best.fit, best.by)
        if tried.score < best.score + HELD:
            tried = level.climb(tried)
        result.append((best.score - tried.score, float(least), tried.fit, level.likelihood))
    return result


def _searched(
    fit: Fit,
    problem: Collocation,
    equations: list[Support],
    optimizer: Any,
    *,
    full: bool,
) -> Found:
    n_terms = len(problem.known)
    # Extended BIC (Chen & Chen 2008): so much for each of p candidates an equation on N rows.
    price = float(np.log(len(problem.data.y)) + 2.0 * np.log(n_terms))
    short = Level(problem.cut(_FULL_ROWS[-1]), equations, price)
    if not np.isfinite(fit.chi2):
        return [short], Tried((), np.inf, fit, "")
    linear = short.likelihood.regression(fit)
    by = type(optimizer).__name__
    chosen, promising, *shorter = _proposals(linear, equations, price, optimizer)
    if not full:
        whole = Level(problem.cut(None), equations, price)
        return [whole], whole.try_support(chosen, fit, by)
    tries = [short.try_support(chosen, fit, by)]
    tries.append(short.try_support(promising, fit, "regression"))
    best = min(tries, key=lambda t: t.score)
    # On a circle x² + y² is constant: sums of a term and its products with that run away, and the
    # term alone does not. It counts if it does better than the whole library, which a ridge held.
    whole_score = fit.chi2 + price * linear.columns.shape[1]
    for support in shorter if not np.isfinite(best.score) else ():
        trial = short.try_support(support, fit, "regression")
        if trial.score < whole_score:
            best = trial
            break
        short.tried[trial.support] = replace(trial, score=np.inf)
    levels = [short]
    if not np.isfinite(best.score):
        return levels, best
    best = short.climb(best)
    for rows in _LONGER_ROWS:
        if rows is not None and rows >= problem.data.runs.lengths.max():
            continue
        level = Level(problem.cut(rows), equations, price)
        start = level.try_support(best.support, best.fit, best.by)
        if not np.isfinite(start.score):
            break
        best = level.climb(start)
        levels.insert(0, level)
    while (better := levels[0].complete(best, RIVAL)) is not best:
        best = levels[0].climb(better)
    return levels, best


def pays_beyond(level: Level, best: Tried[Fit], columns: Sequence[str]) -> tuple[str, ...]:
    """Return which terms beyond the library would pay their price, beside terms or for them.

    Cubics follow x/(1 + x) so well that what they leave is as good as white noise; x⁴, a product
    of a term and a state, still explains more than it costs. ``columns`` name states and inputs.
    """
    problem = level.likelihood
    n = problem.known.shape[0]
    wide = WiderFeatures.of_features(problem.features, best.fit.x, best.fit.u)
    more = wide.kept.size - n
    known, xi = (np.pad(each, ((0, more), (0, 0))) for each in (problem.known, best.fit.xi))
    linear = replace(problem, features=wide, known=known).regression(replace(best.fit, xi=xi))
    free = sorted({i // n for equation in level.equations for i in equation})
    wide_n = n + more
    names = wide.others(columns)
    beyond = [
        (factors(name), tuple(s * wide_n + n + i for s in free)) for i, name in enumerate(names)
    ]
    kept = tuple(i // n * wide_n + i % n for i in best.support)
    price = level.price + 2.0 * float(np.log(wide_n / n))
    equations = [tuple(range(s * wide_n, (s + 1) * wide_n)) for s in free]
    found = {i % wide_n - n for i in pays(linear, beyond, kept, price, equations)}
    return tuple(names[i] for i in sorted(found) if i >= 0)


def pays(
    linear: LinearProblem,
    beyond: list[tuple[float, Support]],
    kept: Support,
    price: float,
    equations: list[Support],
) -> Support:
    """Return the terms kept with one beyond that pays, or others of one equation that do.

    One beyond, given with its number of factors, is tried in each equation and in all: what one
    gains another may lose. Of those no more than a rival behind the best the simplest is taken.
    """
    tried = [
        (factors, linear.score((*kept, *way), price), way)
        for factors, own in beyond
        for way in {own, *((i,) for i in own)}
    ]
    enough = min([score for _, score, _ in tried], default=np.inf) + RIVAL
    enough = min(enough, linear.score(kept, price))
    if good := [each for each in tried if each[1] < enough]:
        return (*kept, *min(good)[2])
    # T⁴ in place of T, T² and T³ pays, where beside these it does not.
    for own in equations:
        rest = tuple(i for i in kept if i not in own)
        score, other = min(best_of_equation(linear, own, rest, price))
        if score < linear.score(kept, price) - RIVAL:
            return other
    return kept


def _proposals(
    linear: LinearProblem, equations: Sequence[Support], price: float, optimizer: Any
) -> list[list[int]]:
    """Return what the optimizer chooses, and the best by the regression, each by equation.

    The best of any length comes first, then those of ever fewer terms an equation. For one equation
    all terms of the others are left free.
    """
    chosen, best = [], []
    for own in equations:
        others = [i for each in equations if each is not own for i in each]
        rest = linear.beside(others, own)
        chosen += [own[i] for i in chosen_support(rest, optimizer)]
        ranked = sorted(best_of_equation(rest, tuple(range(len(own))), (), price))
        best.append([[own[i] for i in support] for _, support in ranked])
    longest = max(len(each[0]) for each in best)
    lengths = (longest, *range(longest - 1, 0, -1))
    ladder = [[next(s for s in each if len(s) <= most) for each in best] for most in lengths]
    return [chosen, *(list(chain(*supports)) for supports in ladder)]


def _with_inputs(
    problem: Collocation, rates: FloatArray, free: IndexArray, near: Fit | None
) -> tuple[Fit, Collocation]:
    """Fit the whole library with all inputs smooth between rows, and with all held."""
    n, tried = problem.data.u.shape[1], []
    for held in (False, True)[: 1 + (n > 0)]:
        own = replace(problem, data=replace(problem.data, held=np.full(n, held)))
        fit, own = _fit_all(own, free, near or _start(own, rates, free), rates)
        unlikely = own.cut(_FULL_ROWS[-1]).deviance(fit) if np.isfinite(fit.chi2) else np.inf
        tried.append((unlikely + HELD * n * held, fit, own))
    return min(tried, key=lambda each: each[0])[1:]


def _start(problem: Collocation, rates: FloatArray, free: IndexArray) -> Fit:
    """Return the whole library by regression on derivatives."""
    x = problem.data.smooth()
    x[:, problem.hidden] = problem.data.y[:, problem.hidden]
    return start_about(problem, x, problem.data.u, rates, free.size)


def start_about(
    problem: Collocation, x: FloatArray, u: FloatArray, rates: FloatArray, n_free: int = 0
) -> Fit:
    """Return the whole library by regression of derivatives at states and inputs."""
    theta = problem.features.values(x, u)
    size = _size(theta)
    scaled = theta / size
    small = _START_RIDGE * len(scaled) * np.eye(size.size)
    target = scaled.T @ (rates - theta @ problem.known)
    xi = np.linalg.solve(scaled.T @ scaled + small, target) / size[:, None]
    return Fit(xi, x, u, np.inf, np.eye(n_free), False)


def _size(theta: FloatArray) -> FloatArray:
    size = np.sqrt(np.mean(theta**2, axis=0))
    return np.asarray(np.where(size > 0.0, size, 1.0))


def _about_the_mean(problem: Collocation, x: FloatArray) -> FloatArray:
    """Return the sizes of terms about the mean that coefficients of 1 make, a column a term.

    About a level far from zero large terms cancel. Where terms about the mean are not sums of the
    library's own, each counts for itself.
    """
    u = problem.data.u
    theta = problem.features.values(x, u)
    with np.errstate(all="ignore"):
        about = problem.features.values(x - x.mean(axis=0), u - u.mean(axis=0))
    if np.isfinite(about).all():
        about /= _size(about)
        sums = np.linalg.lstsq(about, theta, rcond=None)[0]
        if np.allclose(about @ sums, theta, 1e-9, 1e-9 * _size(theta)):
            return np.asarray(sums)
    return np.asarray(np.diag(_size(theta)))


def _fit_all(
    problem: Collocation, free: IndexArray, near: Fit, rates: FloatArray
) -> tuple[Fit, Collocation]:
    """Fit the whole library on short segments, and with it the noise."""
    fit, n_states = near, problem.known.shape[1]
    weight = np.diag(1.0 / (_LARGEST_TERM * np.sqrt(np.mean(rates**2, axis=0))))
    ridge = np.asarray(np.kron(weight, _about_the_mean(problem, near.x))[:, free])
    for rows in _FULL_ROWS:
        fit = _near(problem.cut(rows), problem.cut(rows).fit(free, fit, ridge), fit)
    own = problem.cut(_FULL_ROWS[-1])
    n_rows = len(problem.data.y)
    starts = 1 + int(np.count_nonzero(~own.joined))
    spent = starts + free.size / n_states
    left = problem.data.y - fit.x
    free_rows = max(n_rows - spent, 1.0)
    if problem.input_noise.any() and np.isfinite(fit.chi2):
        # What noisy inputs leave is in the squared error as well.
        free_rows *= np.sum((left / problem.noise)[:, ~problem.hidden] ** 2) / fit.chi2
    found = np.sqrt(np.sum(left**2, axis=0) / free_rows)
    floor = LEAST_NOISE * np.std(problem.data.y, axis=0)
    noise = np.where(problem.hidden, problem.noise, np.maximum(found, floor))
    if np.isfinite(fit.chi2):
        problem = replace(problem, noise=noise)
        # By that noise what stood before leaves as much as there are rows free; its states are near
        # enough to regress on, its coefficients may be none.
        free_rows *= np.count_nonzero(~problem.hidden)
        as_much = replace(fit, xi=np.zeros_like(fit.xi), chi2=float(free_rows))
        own = problem.cut(_FULL_ROWS[-1])
        fit = _near(own, own.fit(free, fit, ridge), as_much)
    return fit, problem


def _near(problem: Collocation, fit: Fit, before: Fit) -> Fit:
    """Return a fit of the whole library, or the one before where it ran away.

    On a closed orbit sums of terms are constant: 10 of 40 harmonic oscillators and pairs of
    predator and prey had no equations.
    """
    if not np.isfinite(before.chi2):
        return fit
    try:
        problem.deviance(fit)
    except (np.linalg.LinAlgError, ValueError):
        return before
    return fit if np.isfinite(fit.chi2) else before
