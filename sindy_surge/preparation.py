"""What selection needs first: τ's basin, the noise levels and the fit of all terms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sindy_surge.free_run import simulate
from sindy_surge.lag_equations import equations_about, features, start_point
from sindy_surge.lag_fit import (
    StructureFit,
    fit_structure,
    plain_free_run,
    refitted,
    sandwich,
    white_equations,
)
from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import LinearProblem, least_squares, unit_norms, without_nuisances
from sindy_surge.noise import NoiseLevels, colour_of, difference_noise, refine_noise
from sindy_surge.search import beam_search
from surge_core.types import FloatArray

# A dead time is believed beyond this many standard errors of the fit of all terms.
_BELIEVED = 4.0
# Share of χ² that terms with ψ' must leave to be counted among all terms.
_TAKEN_OVER = 0.5
# A fit of the dead time reaches two samples at a time.
_MOST_MOVES = 15
_FAR_EXCESS = 2.0
_FAR_SAMPLES = (-40, -30, -20, -14, -10, -6, -3, 3, 6, 10, 14, 20, 30, 40)


@dataclass(frozen=True)
class Prepared:
    """The problem with its noise levels, and the fit of all terms."""

    problem: LagProblem  # The data with noise levels and colour, and the dead time found
    rich: StructureFit  # The fit of all terms without ψ'
    # χ²/N of all terms, those with ψ' too, before colour is filtered out: the variance of what they
    # leave over that of the white noise which differences show
    excess: float


def prepare(
    problem: LagProblem, required: tuple[int, ...] = (), may_be_late: bool = True
) -> Prepared:
    """Find τ's basin, the noise levels and their colour, and the dead time; fit all terms.

    A channel that is late by a sample moves τ by a fifth and fakes terms with ψ', and coloured
    noise fakes terms of φ: both are tested for before any structure is read. Every structure holds
    the ``required`` terms.
    """
    tau = float(plain_free_run(problem).solve_all().parameters[-1])
    problem = _screened(problem, tau, required)
    problem = replace(problem, noise=_noise(problem, tau))
    everything = tuple(range(problem.n_without_state))
    rich = fit_structure(problem, everything, tau, max_steps=6)
    if may_be_late:
        problem, rich = _with_dead_time(problem, rich)
    left = _left_by_all(problem, rich)
    excess = float(np.mean(left**2)) if left.size else 0.0
    colour = colour_of(left, rich.groups)
    # Five orders below the least noise assumed there is only rounding, and its colour is nothing.
    if colour.size and excess > 1e-10:
        problem = problem.with_colour(colour)
        rich = refitted(problem, rich, 4)
        if problem.fits_dead_time and not _late(problem, rich):
            # Coloured noise had passed for a time shift.
            problem = problem.with_dead_time(0.0, False)
            rich = refitted(problem, rich, 4)
    return Prepared(problem, rich, excess)


def _left_by_all(problem: LagProblem, rich: StructureFit) -> FloatArray:
    """Return the whitened residual when terms with ψ' are allowed too, to first order."""
    if problem.columns.size == problem.n_without_state:
        return rich.residual
    equations = white_equations(problem, rich)
    design = np.column_stack((equations.nuisances, equations.columns))
    left = equations.target - design @ least_squares(design, equations.target)
    # Terms with ψ' that take over little would only eat some of the colour.
    return left if left @ left < _TAKEN_OVER * rich.chi2 else rich.residual


def _with_dead_time(problem: LagProblem, rich: StructureFit) -> tuple[LagProblem, StructureFit]:
    """Fit the dead time with all terms, two samples at a time, and keep it where it shows."""
    found, fit = _walked(problem, rich)
    moved = abs(fit.dead_time_s) > problem.sample_period_s
    if moved and fit.chi2 > _FAR_EXCESS * fit.residual.size:
        # On its way, and nowhere near the noise: the valley may lie further off.
        further, other = _walked(problem, _far_off(problem, fit))
        if other.chi2 / other.residual.size < fit.chi2 / fit.residual.size:
            found, fit = further, other
    if not (found.fits_dead_time and _late(found, fit)):
        return problem, rich
    found = found.with_dead_time(fit.dead_time_s, True)
    tau, beta = fit.time_constant_s, fit.coefficients
    return found, fit_structure(found, rich.support, tau, beta, max_steps=6)


def _walked(problem: LagProblem, start: StructureFit) -> tuple[LagProblem, StructureFit]:
    """Fit the dead time with all terms, moving the rows along with it."""
    found, fit = problem, start
    for _ in range(_MOST_MOVES):
        trial = found.with_dead_time(fit.dead_time_s, True)
        if trial.usable.later.size < 2 * len(start.support) + 8:
            return found, fit
        found, tau, beta = trial, fit.time_constant_s, fit.coefficients
        fit = fit_structure(found, start.support, tau, beta, max_steps=6)
        low, high = found.dead_time_range_s
        if low < fit.dead_time_s < high:
            break
    return found, fit


def _far_off(problem: LagProblem, fit: StructureFit) -> StructureFit:
    """Move a fit to the dead time, up to forty samples, of the best plain free run."""
    best, start = np.inf, fit
    for samples in _FAR_SAMPLES:
        trial = problem.with_dead_time(samples * problem.sample_period_s, False)
        rows = trial.usable.later.size
        if rows < problem.usable.later.size // 2:
            continue
        plain = plain_free_run(trial).solve_all()
        cost = float(np.mean(plain.residual**2))
        if cost < best:
            tau = float(plain.parameters[-1])
            point = replace(
                fit.point, dead_time_s=trial.dead_time_s, time_constant_s=tau, state=None
            )
            best, start = cost, replace(fit, point=point)
    return start


def _late(problem: LagProblem, fit: StructureFit) -> bool:
    """Return whether the dead time differs from zero, terms with ψ' notwithstanding.

    It must by its own standard error, which allows for coloured noise; and against the best that
    terms with ψ' could do in its place, for they look alike.
    """
    stderr = float(np.sqrt(sandwich(problem, fit)[-2, -2]))
    if abs(fit.dead_time_s) <= _BELIEVED * stderr:
        return False
    equations = white_equations(problem, fit)
    dead_time = equations.nuisances[:, -2]
    others = np.delete(equations.nuisances, -2, axis=1)
    # What the terms have to explain if there is no dead time.
    target = equations.target + fit.dead_time_s * dead_time
    without = without_nuisances(others, equations.columns, target)
    return without.outside - equations.compressed().outside > _BELIEVED**2 * without.variance


def _screened(problem: LagProblem, tau: float, required: tuple[int, ...]) -> LagProblem:
    """Keep at most a quarter as many terms as equations, and 40, chosen by greedy addition."""
    n_inputs_terms = problem.n_without_state
    with_state = problem.columns[n_inputs_terms:]
    most = max(min(problem.usable.later.size // 4, 40), 1)
    if n_inputs_terms <= most:
        return problem
    values = problem.terms(problem.inputs)[:, problem.columns[:n_inputs_terms]]
    columns = simulate(problem.late(values), problem.segments, problem.lag(tau))
    norms = unit_norms(columns)
    plain = LinearProblem(columns / norms, problem.output, norms, 0.0, columns.shape[0])
    always = tuple(i for i in required if i < n_inputs_terms)
    ranked = beam_search(plain, max(most, len(always)), width=1, required=always)
    kept = problem.columns[list(ranked[max(ranked)][0][1])]
    return replace(problem, columns=np.concatenate((kept, with_state)))


def _noise(problem: LagProblem, tau: float) -> NoiseLevels:
    segments = problem.segments
    scale = float(np.std(problem.output))
    guess = NoiseLevels(
        difference_noise(problem.output, segments),
        np.array([difference_noise(x, segments) for x in problem.inputs.T]),
        np.empty(0),
    )
    silent = NoiseLevels(scale, np.zeros(problem.inputs.shape[1]), np.empty(0))
    clean = replace(problem, noise=silent)
    everything = tuple(range(problem.n_without_state))
    values = features(clean, problem.inputs, silent.inputs, everything).values
    beta = plain_free_run(clean, values).coefficients(tau)
    eq = equations_about(clean, everything, start_point(clean, tau, beta))
    lag = problem.lag(tau, problem.dead_time_s)
    # Capped at their 95 % level: a fit with every term is wild at the ends of the range.
    top = np.quantile(np.abs(eq.slopes), 0.95, axis=1, keepdims=True)
    slopes, usable = np.clip(eq.slopes, -top, top), problem.usable
    return refine_noise(eq.residual, lag, slopes, guess, usable.segments, usable.rows, scale)
