"""Fit of one structure: τ and the coefficients of given terms, noise on both channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sindy_surge.free_run import Segments, simulate
from sindy_surge.lag_problem import LagProblem, equations_about, features, noise_in_inputs

__all__ = [
    "LinearProblem",
    "StructureFit",
    "WhiteEquations",
    "fit_structure",
    "linearise",
    "output_error",
    "scan_lag",
    "white_equations",
]

FloatArray = NDArray[np.float64]

_MAX_STEPS = 20
# A smooth signal runs above or below its chords by 1/12 of its second difference on average;
# straight lines do not. The size of that correction (0: lines, 1: smooth) is
# fitted, with 1/2 ± 1/2 known beforehand.
_BEND_PRIOR = (0.5, 0.5)


@dataclass(frozen=True)
class StructureFit:
    """One structure fitted by errors in variables.

    Parameters
    ----------
    support : tuple of int
        Positions of the terms within the usable columns.
    time_constant_s : float
        τ in seconds.
    coefficients : ndarray of shape (n_support,)
        β in physical units.
    chi2 : float
        Sum of the squared whitened residuals.
    residual : ndarray of shape (n_white,)
        The whitened residuals.
    sensitivity : ndarray of shape (n_white, n_parameters)
        Whitened derivatives with respect to β, the bend (hold "first" only) and τ last.
    prior : ndarray of shape (n_parameters,)
        Information from outside the record: that on the bend.
    bend : float
        Share of the smooth-signal correction to the straight lines; 0 for hold "zero".
    groups : Segments
        Runs of the whitened rows.
    input_noise : ndarray of shape (n_rows, n_inputs)
        The part of the inputs that the fit takes for noise.
    blur : ndarray of shape (n_inputs,)
        Standard deviation of the noise it leaves.
    initial : ndarray of shape (n_segments,)
        ψ' at the start of each segment.
    converged : bool
        Whether the last step was negligible.
    """

    support: tuple[int, ...]
    time_constant_s: float
    coefficients: FloatArray
    chi2: float
    residual: FloatArray
    sensitivity: FloatArray
    prior: FloatArray
    bend: float
    groups: Segments
    input_noise: FloatArray
    blur: FloatArray
    initial: FloatArray
    converged: bool


def fit_structure(
    problem: LagProblem,
    support: tuple[int, ...],
    tau_s: float,
    beta: FloatArray | None = None,
    max_steps: int = _MAX_STEPS,
) -> StructureFit:
    """Fit τ and β of given terms by Gauss-Newton on the whitened free run.

    Each step also re-estimates the noise within φ, builds the terms at φ without it (φ itself
    is never smoothed) and renews the whitening.

    Parameters
    ----------
    problem : LagProblem
        The data.
    support : tuple of int
        Positions of the terms within the usable columns.
    tau_s : float
        Start value of τ in seconds.
    beta : ndarray of shape (n_support,) or None
        Start values of the coefficients; None solves for them first.
    max_steps : int
        Most Gauss-Newton steps.

    Returns
    -------
    StructureFit
        The fit; `converged` says whether it ended by itself.
    """
    chosen = np.array(support, dtype=np.intp)
    tau = _bounded(problem, tau_s)
    noise_part = np.zeros_like(problem.inputs)
    blur = problem.noise.inputs.copy()
    found = features(problem, problem.inputs, blur)
    b = output_error(problem, found.values[:, chosen], tau)[1] if beta is None else beta
    bends = problem.hold == "first"
    bend = 0.0
    prior = np.zeros(chosen.size + 1 + bends)
    converged = False
    for step in range(max_steps + 1):
        if step:
            found = features(problem, problem.inputs - noise_part, blur)
        eq = equations_about(problem, found, chosen, tau, b, noise_part, bend)
        white = eq.whitener(eq.residual)
        if bends:
            # In units of the residual found: on exact data the prior must not pull at all.
            prior[-2] = _BEND_PRIOR[1] ** -2 * min(1.0, float(white @ white) / white.size)
        extra = (eq.bend_column, eq.tau_column) if bends else (eq.tau_column,)
        columns = eq.whitener(np.column_stack((eq.raw_columns[:, chosen], *extra)))
        if converged or step == max_steps:
            break
        pull = np.zeros(prior.size)
        pull[-2:-1] = bends * (_BEND_PRIOR[0] - bend)
        change = _solve(
            np.vstack((columns, np.diag(np.sqrt(prior)))),
            np.concatenate((white, np.sqrt(prior) * pull)),
        )
        moved = float(np.sum((columns @ change) ** 2))
        tau_new = _bounded(problem, float(np.clip(tau + change[-1], tau / 3, 3 * tau)))
        # A step cut short leaves the coefficients where they belong to the longer one.
        share = 1.0 if change[-1] == 0 else min(1.0, abs((tau_new - tau) / change[-1]))
        b = b + max(share, 0.1) * change[: chosen.size]
        bend += bends * max(share, 0.1) * float(change[-2])
        tau = tau_new
        noise_part = noise_in_inputs(problem, eq, tau)
        blur = np.sqrt(np.maximum(problem.noise.inputs**2 - np.mean(noise_part**2, axis=0), 0.0))
        # 1e-7 in χ² is 3e-4 standard errors; the second condition ends a run into a bound.
        at_bound = tau in (problem.shortest_lag_s, problem.longest_lag_s) and share < 1.0
        converged = step > 0 and (moved < 1e-7 or (at_bound and step > 8))
    return StructureFit(
        support=support,
        time_constant_s=tau,
        coefficients=b,
        chi2=float(white @ white),
        residual=white,
        sensitivity=columns,
        prior=prior,
        bend=bend,
        groups=eq.whitener.groups,
        input_noise=noise_part,
        blur=blur,
        initial=eq.initial,
        converged=converged,
    )


def _bounded(problem: LagProblem, tau: float) -> float:
    return float(np.clip(tau, problem.shortest_lag_s, problem.longest_lag_s))


def _solve(columns: FloatArray, target: FloatArray) -> FloatArray:
    norms = np.linalg.norm(columns, axis=0)
    norms[norms == 0] = 1.0
    solution: FloatArray = np.linalg.lstsq(columns / norms, target, rcond=1e-12)[0] / norms
    return solution


@dataclass(frozen=True)
class LinearProblem:
    """The regression about one fit, compressed by QR to as many rows as columns.

    Parameters
    ----------
    columns : ndarray of shape (n_rows, n_columns)
        Every usable term, whitened, τ projected out, scaled to unit norm.
    target : ndarray of shape (n_rows,)
        What the terms have to explain.
    norms : ndarray of shape (n_columns,)
        Norms taken out of the columns.
    outside : float
        The part of χ² that no term can explain.
    n_equations : int
        Number of whitened equations behind it.
    """

    columns: FloatArray
    target: FloatArray
    norms: FloatArray
    outside: float
    n_equations: int

    @property
    def variance(self) -> float:
        """Variance of the whitened residual when every term is in.

        Not below 1: it is 1 by construction, and next to nothing on exact data, where
        rounding and interpolation would otherwise decide.
        """
        freedom = max(self.n_equations - self.columns.shape[1] - 1, 1)
        return float(max(self.outside / freedom, 1.0))


@dataclass(frozen=True)
class WhiteEquations:
    """The whole library about one fit, whitened, before any compression.

    Parameters
    ----------
    nuisances : ndarray of shape (n_white, n_nuisances)
        Derivatives with respect to what is estimated beside the coefficients (τ first).
    columns : ndarray of shape (n_white, n_columns)
        Derivatives with respect to the coefficient of every usable term.
    target : ndarray of shape (n_white,)
        What the terms have to explain: residual plus the fitted terms.
    groups : Segments
        Runs of the whitened rows.
    rows : ndarray of int of shape (n_white,)
        Row of the record at which each whitened equation ends.
    """

    nuisances: FloatArray
    columns: FloatArray
    target: FloatArray
    groups: Segments
    rows: NDArray[np.intp]

    def compressed(self) -> LinearProblem:
        """Project the nuisances out and keep as many rows as there are columns."""
        stacked = np.column_stack((self.nuisances, self.columns, self.target))
        norms = np.linalg.norm(stacked, axis=0)
        norms[norms == 0] = 1.0
        triangle: FloatArray = np.asarray(np.linalg.qr(stacked / norms, mode="r"))
        n = self.nuisances.shape[1]
        columns, goal = triangle[n:, n:-1], triangle[n:, -1] * norms[-1]
        rank = min(columns.shape)
        # Projecting τ out shortens a column that a change of τ can stand in for.
        left = np.linalg.norm(columns, axis=0)
        left[left < 1e-12] = 1.0
        outside = float(goal[rank:] @ goal[rank:])
        return LinearProblem(
            columns[:rank] / left, goal[:rank], norms[n:-1] * left, outside, stacked.shape[0]
        )


def white_equations(problem: LagProblem, fit: StructureFit) -> WhiteEquations:
    """Set up the whitened equations of the whole library about one fit.

    Parameters
    ----------
    problem : LagProblem
        The data.
    fit : StructureFit
        The fit about which to linearise: its τ, its slopes and its estimate of the input noise.

    Returns
    -------
    WhiteEquations
        One column for each usable term.
    """
    support = np.array(fit.support, dtype=np.intp)
    found = features(problem, problem.inputs - fit.input_noise, fit.blur)
    eq = equations_about(
        problem,
        found,
        support,
        fit.time_constant_s,
        fit.coefficients,
        fit.input_noise,
        fit.bend,
    )
    target = eq.residual + eq.raw_columns[:, support] @ fit.coefficients
    nuisances = [eq.tau_column]
    if problem.hold == "first":
        nuisances.append(eq.bend_column)
    n = len(nuisances)
    stacked = eq.whitener(np.column_stack((*nuisances, eq.raw_columns, target)))
    return WhiteEquations(
        stacked[:, :n],
        stacked[:, n:-1],
        stacked[:, -1],
        eq.whitener.groups,
        problem.segments.later[eq.whitener.kept],
    )


def linearise(problem: LagProblem, fit: StructureFit) -> LinearProblem:
    """Set up the regression on the whole library about one fit, whitened and compressed.

    Parameters
    ----------
    problem : LagProblem
        The data.
    fit : StructureFit
        See `white_equations`.

    Returns
    -------
    LinearProblem
        Whitened and compressed.
    """
    return white_equations(problem, fit).compressed()


def output_error(problem: LagProblem, values: FloatArray, tau: float) -> tuple[float, FloatArray]:
    """Return the sum of squares and β of the plain free run, initial states projected out.

    Parameters
    ----------
    problem : LagProblem
        The data.
    values : ndarray of shape (n_rows, n_terms)
        Terms at the measured inputs.
    tau : float
        τ in seconds.

    Returns
    -------
    cost : float
        Residual sum of squares.
    beta : ndarray of shape (n_terms,)
        Coefficients.
    """
    segments = problem.segments
    lag = problem.hold_at(tau)
    stacked = np.column_stack((simulate(values, segments, lag), problem.output))
    decay = lag.pole ** segments.offsets().astype(float)
    power = np.add.reduceat(decay**2, segments.starts)
    share = np.add.reduceat(decay[:, None] * stacked, segments.starts, axis=0) / power[:, None]
    stacked = stacked - decay[:, None] * np.repeat(share, segments.lengths, axis=0)
    beta = _solve(stacked[:, :-1], stacked[:, -1])
    residual = stacked[:, -1] - stacked[:, :-1] @ beta
    return float(residual @ residual), beta


def scan_lag(problem: LagProblem, extra_s: tuple[float, ...] = ()) -> float:
    """Find τ of the plain free run with the simplest terms, by a scan and one refinement.

    Parameters
    ----------
    problem : LagProblem
        The data.
    extra_s : tuple of float
        Further values to try, in seconds (the weak form's).

    Returns
    -------
    float
        The best τ in seconds.
    """
    from scipy.optimize import minimize_scalar

    # Six terms follow any characteristic well enough to find the basin of τ.
    few = problem.columns[: min(6, max(1, problem.segments.later.size // 4))]
    values = problem.terms(problem.inputs)[:, few]
    grid = np.geomspace(0.1 * problem.sample_period_s, problem.longest_lag_s, 16)
    inside = [t for t in extra_s if grid[0] < t < grid[-1]]
    grid = np.unique(np.concatenate((grid, inside)))
    costs = [output_error(problem, values, float(tau))[0] for tau in grid]
    best = int(np.argmin(costs))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
    refined = minimize_scalar(
        lambda v: output_error(problem, values, float(np.exp(v)))[0],
        bounds=(np.log(low), np.log(high)),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(np.exp(refined.x)) if refined.fun <= costs[best] else float(grid[best])
