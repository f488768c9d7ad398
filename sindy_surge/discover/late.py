"""Readings that come late: a sensor behind a delay or a lag makes terms that no law has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.linalg import LinAlgError
from scipy.interpolate import make_interp_spline

from sindy_surge.discover.collocation import Fit
from sindy_surge.discover.ending import EXCESS
from sindy_surge.discover.levels import RIVAL, Level, searched, start_about
from sindy_surge.discover.trajectories import Trajectories
from sindy_surge.linear_problem import LinearProblem, Support
from sindy_surge.search import Tried, best_of_equation
from surge_core.terms import uncertain
from surge_core.types import FloatArray

# Delays looked at on either side of none: so many steps, each as large as a straight line between
# them goes unnoticed. Then searches in which the best is estimated; what ends them, in errors.
_LOOKED_AT, _MOST_STEPS, _SETTLED = 4, 6, 0.1
# Of the price of a term: what the look may stay behind, for all that it does not see.
_BEHIND = 0.5
# What a delay must win beyond its price, in χ²: of two equations that hold every linear term, a
# delay takes one away at no loss and no gain.
_LEAST_WON = 1.0
DELAY, LAG = "delay", "lag"


@dataclass(frozen=True)
class Late:
    """States whose readings come late by so much, or early where that is negative."""

    states: Support
    how: str  # By a "delay", through a "lag" of the first order, or either
    late_s: float
    stderr_s: float

    def undone(self, data: Trajectories, readings: FloatArray) -> Trajectories:
        """Return trajectories with late readings moved, by their way without noise."""
        return data.moved(self.states, self.late_s, readings, lag=self.how == LAG)

    def words(self, names: Sequence[str]) -> str:
        """Say it, e.g. ``y is read 0.0501(10) s late``."""
        who = " and ".join(names[i] for i in self.states)
        verb = "is" if len(self.states) == 1 else "are"
        size, early = uncertain(abs(self.late_s), self.stderr_s), self.late_s < 0.0
        return f"{who} {verb} read {size} s {'early' if early else 'late'} ({self.how})"


def read_late(
    level: Level, best: Tried[Fit], rates: FloatArray, given: Sequence[int], optimizer: Any
) -> tuple[Level, Tried[Fit], Late] | None:
    """Return the search with late readings moved, if those of one state make terms needless.

    Where there are inputs, the readings of all states may come later than these.
    """
    problem = level.likelihood
    # Of a state that does not move no reading is late.
    moves = np.any(best.fit.xi + problem.known, axis=0)
    read = tuple(np.flatnonzero(~problem.hidden & moves).tolist())
    inputs = problem.data.u.shape[1]
    # Of two readings without inputs, that one is early is that the other is late.
    one_of_two = len(read) == 2 and not inputs
    asked: list[Support] = [(state,) for state in read[one_of_two:] if len(read) > 1]
    asked += [read] if inputs else []
    # Readings that come late by half a row look like inputs that are held.
    smooth = replace(problem, data=replace(problem.data, held=np.zeros(inputs, dtype=np.bool_)))
    levels = [level, replace(level, likelihood=smooth, tried={})][
        : 1 + bool(problem.data.held.any())
    ]
    looked = []
    for i, own in enumerate(levels):
        for states in asked:
            delays = _delays(own, best, states).tolist()
            looked += [(*min((_looked(own, best, states, d), d) for d in delays), i, states)]
    plain = min(_looked(level, best, (), 0.0), best.score) - _BEHIND * level.price
    likely = [each for each in looked if each[0] < min(plain, min(looked)[0] + RIVAL)]
    found = []
    for _, late_s, i, states in likely:
        for how in (DELAY, LAG):
            each = _moved(
                levels[i], best, Late(states, how, late_s, np.inf), rates, given, optimizer
            )
            # A lag makes nothing early.
            found += [each] if each is not None and (how == DELAY or each[2].late_s > 0.0) else []
    if not found:
        return None
    found.sort(key=lambda each: each[1].score)
    (own, tried, late), *others = found
    for _, other, one in others:
        if one.states == late.states and one.how != late.how and other.score < tried.score + RIVAL:
            error = float(np.hypot(late.stderr_s, one.late_s - late.late_s))
            tried = _either(tried, other)
            late = replace(late, how=f"{DELAY} or {LAG}", stderr_s=error)
            break
    if one_of_two and late.late_s < 0.0:
        late = replace(late, states=read[:1], late_s=-late.late_s)
    own.tried[tried.support] = tried
    return own, tried, late


def _either(best: Tried[Fit], other: Tried[Fit]) -> Tried[Fit]:
    """Return the better of two fits, in whose covariance the other counts as an error."""
    places = np.array(best.support, dtype=np.intp)
    apart = (other.fit.xi - best.fit.xi).T.ravel()[places]
    covariance = best.fit.covariance + np.outer(apart, apart)
    return replace(best, fit=replace(best.fit, covariance=covariance))


def _delays(level: Level, best: Tried[Fit], late: Support) -> FloatArray:
    """Return delays so far apart that half a step bends the readings by less than shows."""
    problem, bends = level.likelihood, []
    for rows in problem.data.runs.slices():
        smooth = make_interp_spline(problem.data.time_s[rows], best.fit.x[rows])
        bends.append(smooth(problem.data.time_s[rows], 2))
    bent = np.sqrt(np.mean(np.concatenate(bends) ** 2, axis=0))
    shows = problem.noise / np.sqrt(len(problem.data.y))
    step_s = np.sqrt(6.0 * np.min((shows / np.maximum(bent, 1e-300))[list(late)]))
    return np.asarray(step_s * np.arange(-_LOOKED_AT, _LOOKED_AT + 1))


def _looked(level: Level, best: Tried[Fit], late: Support, late_s: float) -> float:
    """Return the least score by the regression about moved readings, their delay left free."""
    data = level.likelihood.data
    moved = data.moved(late, late_s, best.fit.x, lag=False)
    x = best.fit.x + moved.y - data.y
    parts = [np.gradient(x[p], data.time_s[p], axis=0, edge_order=2) for p in data.runs.slices()]
    free = replace(level.likelihood, data=moved, late=late)
    try:
        # Far from what was read a whole library may overflow.
        with np.errstate(all="ignore"):
            linear = free.regression(start_about(free, x, best.fit.u, np.concatenate(parts)))
    except (LinAlgError, ValueError):
        return np.inf
    # Where with all terms more is left than noise leaves, no choice of them explains the record.
    rows = np.count_nonzero(free.joined) * np.count_nonzero(~free.hidden)
    if linear.outside > EXCESS**2 * rows:
        return np.inf
    # For one equation all terms of the others are left free: a delay makes terms in several. It
    # takes terms away, so that no more than those at hand are looked for.
    apart: Support = ()
    for own in level.equations:
        others = [i for each in level.equations if each is not own for i in each]
        rest, most = linear.beside(others, own), len(set(own) & set(best.support))
        ranked = best_of_equation(rest, tuple(range(len(own))), (), level.price, most)
        apart += tuple(own[i] for i in min(ranked)[1])
    chosen = (_chosen(level, linear, begun) for begun in (best.support, apart))
    return min(linear.score(support, level.price) for support in chosen)


def _moved(
    level: Level,
    best: Tried[Fit],
    late: Late,
    rates: FloatArray,
    given: Sequence[int],
    optimizer: Any,
) -> tuple[Level, Tried[Fit], Late] | None:
    own, tried, data, readings = level, best, level.likelihood.data, best.fit.x
    for _ in range(_MOST_STEPS):
        before = tried.support
        moved = late.undone(data, readings)
        near = replace(tried.fit, x=readings + moved.y - data.y)
        problem = replace(level.likelihood, data=moved)
        (last, *_), again = searched(problem, rates, given, optimizer, near, full=True)
        same = last.likelihood.data
        laid = replace(moved, held=same.held, open=same.open)
        own = Level(replace(problem, data=laid, late=late.states), level.equations, level.price)
        tried = own.try_support(again.support, again.fit, again.by)
        if not np.isfinite(tried.score):
            return None
        kept = _chosen(level, own.likelihood.regression(tried.fit), tried.support, tried.support)
        step_s, covariance = own.likelihood.lateness(kept, tried.fit)
        if abs(step_s) < _SETTLED * np.sqrt(covariance[0, 0]) and tried.support == before:
            break
        readings = tried.fit.x - (moved.y - data.y)
        late = replace(late, late_s=late.late_s + step_s)
    tried = own.climb(tried)
    covariance = own.likelihood.lateness(tried.support, tried.fit)[1]
    late = replace(late, stderr_s=float(np.sqrt(covariance[0, 0])))
    won = best.score - tried.score - level.price
    with_late = replace(tried, fit=replace(tried.fit, covariance=covariance[1:, 1:]))
    return (own, with_late, late) if won > _LEAST_WON else None


def _chosen(
    level: Level, linear: LinearProblem, support: Support, among: Support | None = None
) -> Support:
    """Return the terms that a regression chooses from a support on, equation by equation."""
    for _ in range(_MOST_STEPS):
        before = support
        for equation in level.equations:
            kept = tuple(i for i in support if i not in equation)
            free = tuple(i for i in equation if among is None or i in among)
            most = len(support) - len(kept) + 1
            support = min(best_of_equation(linear, free, kept, level.price, most))[1]
        if support == before:
            break
    return support
