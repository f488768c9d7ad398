"""What selection needs first: τ's basin, the noise levels and the fit of all terms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sindy_surge.free_run import simulate
from sindy_surge.lag_fit import (
    LinearProblem,
    StructureFit,
    fit_structure,
    output_error,
    scan_lag,
)
from sindy_surge.lag_problem import LagProblem, equations_about, features
from sindy_surge.sparse_paths import beam_search
from sindy_surge.weak_form import WeakLag, weak_lag
from sindy_surge.whitening import NoiseLevels, autoregression, difference_noise, refine_noise

__all__ = ["Prepared", "prepare"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Prepared:
    """The problem with its noise levels, the fit of all terms and the weak estimates.

    Parameters
    ----------
    problem : LagProblem
        The data with noise levels and colour.
    rich : StructureFit
        The fit of all terms.
    weak : WeakLag or None
        The weak estimates of τ.
    excess : float
        χ²/N of the fit of all terms before its colour is filtered out: the variance of what
        all terms leave over that of the white noise which differences show.
    """

    problem: LagProblem
    rich: StructureFit
    weak: WeakLag | None
    excess: float


def prepare(problem: LagProblem) -> Prepared:
    """Find τ's basin and the noise levels, and fit all terms.

    Parameters
    ----------
    problem : LagProblem
        The data; its noise levels are replaced.

    Returns
    -------
    Prepared
        With noise levels, and their colour if the whitened residual has any.
    """
    values = problem.terms(problem.inputs)
    # One weak equation comes every quarter of a half width, so far fewer than rows.
    few = values[:, problem.columns[: max(2, min(20, problem.output.size // 100))]]
    weak = weak_lag(problem.output, few, problem.segments, problem.sample_period_s)
    extra = () if weak is None else (weak.reverse_s, weak.forward_s)
    tau = scan_lag(problem, extra)
    problem = _screened(problem, values, tau)
    problem = replace(problem, noise=_noise(problem, values, tau))
    everything = tuple(range(problem.columns.size))
    rich = fit_structure(problem, everything, tau, max_steps=6)
    excess = rich.chi2 / max(rich.residual.size, 1)
    colour = autoregression(rich.residual, rich.groups)
    # Five orders below the least noise assumed there is only rounding, and its colour is nothing.
    if colour.size and rich.chi2 > 1e-10 * rich.residual.size:
        problem = replace(problem, noise=replace(problem.noise, colour=colour))
        rich = fit_structure(
            problem, everything, rich.time_constant_s, rich.coefficients, max_steps=4
        )
    return Prepared(problem, rich, weak, excess)


def _screened(problem: LagProblem, values: FloatArray, tau: float) -> LagProblem:
    """Keep at most a quarter as many terms as equations, and 40, chosen by greedy addition."""
    most = max(min(problem.segments.later.size // 4, 40), 1)
    if problem.columns.size <= most:
        return problem
    fit = _plain_fit(problem, values, tau)
    ranked = beam_search(fit, most, width=1)
    kept = ranked[max(ranked)][0][1]
    return replace(problem, columns=problem.columns[list(kept)])


def _plain_fit(problem: LagProblem, values: FloatArray, tau: float) -> LinearProblem:
    lag = problem.hold_at(tau)
    columns = simulate(values[:, problem.columns], problem.segments, lag)
    norms = np.linalg.norm(columns, axis=0)
    norms[norms == 0] = 1.0
    return LinearProblem(columns / norms, problem.output, norms, 0.0, columns.shape[0])


def _noise(problem: LagProblem, values: FloatArray, tau: float) -> NoiseLevels:
    segments = problem.segments
    scale = float(np.std(problem.output))
    guess = NoiseLevels(
        difference_noise(problem.output, segments),
        np.array([difference_noise(x, segments) for x in problem.inputs.T]),
        np.empty(0),
    )
    silent = NoiseLevels(scale, np.zeros(problem.inputs.shape[1]), np.empty(0))
    clean = replace(problem, noise=silent)
    found = features(clean, problem.inputs, silent.inputs)
    everything = np.arange(problem.columns.size)
    beta = output_error(clean, found.values, tau)[1]
    eq = equations_about(clean, found, everything, tau, beta, np.zeros_like(problem.inputs))
    limited = _limited(eq.slopes)
    return refine_noise(eq.residual, problem.hold_at(tau), limited, guess, segments, scale)


def _limited(slopes: FloatArray) -> FloatArray:
    """Cap slopes at their 95 % level: a fit with every term is wild at the ends of the range."""
    top = np.quantile(np.abs(slopes), 0.95, axis=1, keepdims=True)
    return np.clip(slopes, -top, top)
