"""Hinges whose knot is none of the library's: find them, and place them where the data ask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sindy_surge.lag_fit import StructureFit, fit_structure, white_equations
from sindy_surge.lag_problem import LagProblem
from sindy_surge.library import hinge_name
from sindy_surge.linear_problem import LinearProblem, Support
from sindy_surge.search import beam_search
from sindy_surge.selection import information_penalty
from surge_core.types import FloatArray

# Knots tried over the range of φ; between two of them a hinge is placed to within a
# fiftieth of the range, from where its χ² is a parabola.
_TRIED = 50
# Structures with a free knot stay this small: four terms and a knot or two follow any kink.
_LARGEST = 5
_LOOKED_AT = 60
_MOST_MOVED = 2
_WIDTH = 100
_PART_OF_STEP = 0.25
# Share of the range within which hinges may stand for one kink.
_NEIGHBOURS = 0.15


class MovedKnot(NamedTuple):
    """A hinge off the library's grid: where it bends, rounded within its standard error."""

    knot: float
    stderr: float


def moved_knots(
    problem: LagProblem, fit: StructureFit, required: Support = ()
) -> tuple[MovedKnot, ...]:
    """Look for a structure with hinges off the grid that beats a structure found on it.

    About the fit, the library is widened by a fine grid of hinges. A structure with such hinges
    pays for each twice, for the term and for its knot. The best one is fitted by itself while its
    knots move. Returned are the hinges to be added to the library; none if none is worth it, or
    with several inputs.
    """
    if problem.inputs.shape[1] > 1:
        return ()
    low, high = np.quantile(problem.inputs, [0.02, 0.98])
    fine = np.linspace(low, high, _TRIED + 2)[1:-1].tolist()
    wide, place = with_hinges(problem, fine)
    own = tuple(place[i] for i in fit.support)
    linear = white_equations(wide, replace(fit, support=own)).compressed()
    penalty = information_penalty(linear.n_equations, problem.columns.size)
    first = problem.n_without_state
    new = set(range(first, first + len(fine)))
    best = _best(linear, own, new, penalty, tuple(place[i] for i in required))
    if best is None:
        return ()
    back = {position: i for i, position in place.items()}
    kept = [back[i] for i in best if i not in new]
    free = [fine[i - first] for i in best if i in new]
    # A kink between two knots needs both of their hinges, or one of its own.
    grid = _knots_of(problem)
    weights = dict(zip(best, np.abs(linear.coefficients(best)).tolist(), strict=True))
    kinks = [(grid[i], weights[place[i]]) for i in kept if i in grid]
    kinks += [(fine[i - first], weights[i]) for i in best if i in new]
    joined = _joined(sorted(kinks), _NEIGHBOURS * float(np.ptp(problem.inputs)))
    trials = []
    for rest, knots in ((kept, free), ([i for i in kept if i not in grid], joined)):
        placed, chi2 = _placed(problem, fit, rest, knots)
        trials.append((chi2 / linear.variance + penalty * (len(rest) + 2 * len(placed)), placed))
    return min(trials, key=lambda trial: trial[0])[1]


def _joined(kinks: list[tuple[float, float]], reach: float) -> list[float]:
    """Put one free hinge in the place of neighbours (knot, weight), where they balance."""
    groups: list[list[tuple[float, float]]] = []
    for kink in kinks:
        if groups and kink[0] - groups[-1][-1][0] < reach:
            groups[-1].append(kink)
        else:
            groups.append([kink])
    return [
        sum(knot * weight for knot, weight in group) / sum(weight for _, weight in group)
        for group in groups[:_MOST_MOVED]
    ]


def _knots_of(problem: LagProblem) -> dict[int, float]:
    """Return the knots of the library's hinges by position among the usable terms."""
    terms = problem.terms
    known = {hinge_name(terms.input_names[0], knot): knot for knot in terms.knots}
    names = [terms.names[column] for column in problem.columns]
    return {position: known[name] for position, name in enumerate(names) if name in known}


def with_hinges(problem: LagProblem, knots: Sequence[float]) -> tuple[LagProblem, dict[int, int]]:
    """Widen the library of a problem by hinges, and return the new position of every usable term.

    They stand behind its terms of the inputs, and take the place of such added before.
    """
    terms = problem.terms.with_hinges(knots)
    edge, n_new = problem.terms.n_without_state, len(knots)
    without = problem.columns[problem.columns < edge]
    added = np.arange(terms.n_without_state - n_new, terms.n_without_state)
    with_state = problem.columns[problem.columns >= edge] + terms.n_without_state - edge
    columns = np.concatenate((without, added, with_state)).astype(np.intp)
    place = {i: i if i < without.size else i + n_new for i in range(problem.columns.size)}
    return replace(problem, terms=terms, columns=columns), place


def _best(
    linear: LinearProblem, own: Support, new: set[int], penalty: float, required: Support
) -> Support | None:
    """Return the best structure with at most two free knots, if it beats `own`."""
    limit = linear.score(own, penalty)
    best: Support | None = None
    for size, ranked in beam_search(linear, _LARGEST, _WIDTH, required).items():
        for chi2, support in ranked[:_LOOKED_AT]:
            free = sum(i in new for i in support)
            score = chi2 / linear.variance + penalty * (size + free)
            if 1 <= free <= _MOST_MOVED and score < limit:
                best, limit = support, score
    return best


def _placed(
    problem: LagProblem, near: StructureFit, kept: Sequence[int], start: Sequence[float]
) -> tuple[tuple[MovedKnot, ...], float]:
    """Move each free knot to the least χ² of the structure's own fit, one after the other."""
    from scipy.optimize import minimize_scalar

    step = float(np.ptp(problem.inputs)) / _TRIED
    knots = list(start)
    first = problem.n_without_state

    def chi2(values: Sequence[float]) -> float:
        wide, place = with_hinges(problem, values)
        support = tuple(sorted({place[i] for i in kept} | set(range(first, first + len(values)))))
        if wide.holds_state(support):
            return float("inf")
        return fit_structure(wide, support, near.time_constant_s, max_steps=3).chi2

    found: list[MovedKnot] = []
    for number, middle in enumerate(start):

        def along(value: float, number: int = number) -> float:
            return chi2([*knots[:number], value, *knots[number + 1 :]])

        result = minimize_scalar(
            along,
            bounds=(middle - 2 * step, middle + 2 * step),
            method="bounded",
            options={"xatol": 1e-4 * step, "maxiter": 30},
        )
        centre = float(result.x)
        width = _PART_OF_STEP * step
        curvature = along(centre + width) + along(centre - width) - 2 * float(result.fun)
        stderr = float(np.sqrt(2 * width**2 / curvature)) if curvature > 0 else step
        knots[number] = _round_within(centre, stderr)
        found.append(MovedKnot(knots[number], stderr))
    return tuple(found), chi2(knots)


def _round_within(value: float, stderr: float) -> float:
    """Return the number with the fewest decimals within one standard error."""
    shorter = (round(value, digits) for digits in range(-3, 12))
    return next((one for one in shorter if abs(one - value) <= stderr), value)


def knot_columns(problem: LagProblem, fit: StructureFit, knots: Sequence[MovedKnot]) -> FloatArray:
    """Return the whitened derivatives of a fit with respect to its moved knots.

    One column for each moved knot whose hinge is in the structure.
    """
    first = problem.n_without_state - len(knots)
    columns = []
    for number, moved in enumerate(knots):
        if first + number not in fit.support:
            continue
        beta = float(fit.coefficients[fit.support.index(first + number)])
        width = max(moved.stderr, 1e-6 * float(np.ptp(problem.inputs)))
        sides = []
        for side in (width, -width):
            there = [k.knot + side * (i == number) for i, k in enumerate(knots)]
            terms = problem.terms.with_hinges(there)
            whole = white_equations(replace(problem, terms=terms), fit)
            sides.append(whole.columns[:, first + number])
        columns.append(beta * (sides[0] - sides[1]) / (2 * width))
    return np.column_stack(columns) if columns else np.empty((fit.residual.size, 0))
