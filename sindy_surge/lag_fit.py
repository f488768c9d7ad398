"""Fit of one structure: τ and the coefficients of given terms, noise on both channels.

With standard errors that hold when the residuals are coloured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sindy_surge.free_run import FreeRunEquations
from sindy_surge.lag_equations import (
    Equations,
    Point,
    equations_about,
    features,
    noise_in_inputs,
    start_point,
)
from sindy_surge.lag_problem import LagProblem
from sindy_surge.linear_problem import LinearProblem, least_squares, without_nuisances
from sindy_surge.segments import Segments
from surge_core.types import FloatArray, IndexArray

# Scores further apart than two time constants are taken for independent.
_LAG_IN_TAU = 2.0
_MOST_LAGS_SHARE = 0.05


def sandwich(problem: LagProblem, fit: StructureFit, known: FloatArray | None = None) -> FloatArray:
    """Return the covariance of the fit from the scatter of the scores, not of the residuals.

    H⁻¹ S H⁻¹ with H the information and S the Newey-West sum of the scores up to two time
    constants, each segment on its own. Where the residual is white S is that of the whitened
    equations up to scatter, and is then not taken below it; the inverse information alone is four
    times too small on coloured residuals. It holds for the terms as chosen: the uncertainty of the
    choice itself is not in it.

    H is ``known`` from `lag_fit.information`, in the order of the columns of `fit.sensitivity`, or
    that of the whitened equations. The covariance is that of the coefficients, of what stands
    between them and τ there but the bend (moved knots, the dead time), and last of τ; nan for
    parameters on which no equation depends.
    """
    columns, residual = fit.sensitivity, fit.residual
    n = residual.size
    norms = np.sqrt(np.sum(columns**2, axis=0) + fit.prior)
    keep = np.flatnonzero(norms > 1e-10 * norms.max())
    scaled = columns[:, keep] / norms[keep]
    # Information from the prior has no scatter of its own in this record.
    prior = np.diag(fit.prior[keep] / norms[keep] ** 2)
    white = scaled.T @ scaled + prior
    information = white
    if known is not None:
        information = known[np.ix_(keep, keep)] / np.outer(norms[keep], norms[keep])
    reach = int(_LAG_IN_TAU * fit.time_constant_s / problem.sample_period_s)
    reach = min(max(reach, 1), max(int(_MOST_LAGS_SHARE * n), 1))
    middle = _newey_west(scaled * residual[:, None], fit.groups.slices(), reach) + prior
    bread = np.linalg.pinv(information, rcond=1e-13, hermitian=True)
    inner = bread @ middle @ bread * n / max(n - keep.size, 1)
    # Where the residual is white the sandwich is the inverse information with some scatter; it
    # counts where it says more.
    plain = bread @ white @ bread * float(residual @ residual) / max(n - keep.size, 1)
    wider = np.sqrt(np.maximum(np.diag(inner) / np.maximum(np.diag(plain), 1e-300), 1.0))
    inner = plain * np.outer(wider, wider)
    full = np.full((norms.size, norms.size), np.nan)
    full[np.ix_(keep, keep)] = inner / np.outer(norms[keep], norms[keep])
    bend = len(fit.support) if problem.hold == "first" else norms.size
    wanted = [i for i in range(norms.size) if i != bend]
    return full[np.ix_(wanted, wanted)]


def _newey_west(scores: FloatArray, runs: Sequence[slice], reach: int) -> FloatArray:
    """Return Σ_l (1 - l/(reach + 1)) Σ_k s[k+l] s[k]' within each run (Newey & West 1987)."""
    middle = scores.T @ scores
    for lag in range(1, reach + 1):
        weight = 1 - lag / (reach + 1)
        for rows in runs:
            if rows.stop - rows.start > lag:
                later = scores[rows.start + lag : rows.stop]
                cross = later.T @ scores[rows.start : rows.stop - lag]
                middle += weight * (cross + cross.T)
    return middle


_MAX_STEPS = 20
# Steps before the estimated noise of φ is damped: a kink can throw it to and fro for ever.
_UNDAMPED = 6
# Changes of χ² that end a fit: 1e-3 standard errors, or 1e-2 while rows cross a kink to and fro.
_NEGLIGIBLE = 1e-6
_HARMLESS = 1e-4
# Steps of the score's differences, in standard errors, and how often the noise of φ is renewed.
_SHARE_OF_ERROR = 0.5
_RENEWALS = 2
# A smooth signal runs above or below its chords by 1/12 of its second difference on average;
# straight lines do not. The size of that correction (0: lines, 1: smooth) is
# fitted, with 1/2 ± 1/2 known beforehand.
_BEND_PRIOR = (0.5, 0.5)


@dataclass(frozen=True)
class StructureFit:
    """One structure fitted by errors in variables."""

    support: tuple[int, ...]  # Positions of the terms within the usable columns
    point: Point  # τ, dead time, coefficients and the estimated noise of φ
    residual: FloatArray  # (n_white,): The whitened residuals
    # (n_white, n_parameters): Whitened derivatives with respect to β, the bend (hold "first" only),
    # the dead time (if fitted) and τ last
    sensitivity: FloatArray
    prior: FloatArray  # (n_parameters,): Information from outside the record: that on the bend
    groups: Segments  # Runs of the whitened rows
    converged: bool  # Whether the last step was negligible
    # Whether ψ' comes to rest at every φ of the record; terms with ψ' may drive it away
    settles: bool

    @property
    def chi2(self) -> float:
        """Sum of the squared whitened residuals."""
        return float(self.residual @ self.residual)

    @property
    def time_constant_s(self) -> float:
        """τ in seconds."""
        return self.point.time_constant_s

    @property
    def dead_time_s(self) -> float:
        """Dead time in seconds."""
        return self.point.dead_time_s

    @property
    def coefficients(self) -> FloatArray:
        """β; those of terms with ψ' in the library's own units."""
        return self.point.coefficients


def fit_structure(
    problem: LagProblem,
    support: tuple[int, ...],
    tau_s: float,
    beta: FloatArray | None = None,
    max_steps: int = _MAX_STEPS,
    near: StructureFit | None = None,
) -> StructureFit:
    """Fit τ and β of given terms by Gauss-Newton on the whitened free run.

    Each step also re-estimates the noise within φ, builds the terms at φ without it (φ itself is
    never smoothed) and renews the whitening.

    The search starts from a τ in seconds and from β, which is solved for first where it is not
    given (terms without ψ' only); a fit ``near``, of the same problem, gives it dead time and ψ'.
    """
    tau = _bounded(problem, tau_s)
    if beta is None:
        blur = problem.noise.inputs.copy()
        values = features(problem, problem.inputs, blur, support).values
        beta = plain_free_run(problem, values).coefficients(tau)
    point = start_point(problem, tau, beta)
    if near is not None:
        low, high = problem.dead_time_range_s
        kept = near.point.state
        point = replace(
            point,
            dead_time_s=float(np.clip(near.dead_time_s, low, high)),
            state=kept if kept is not None and kept.size == problem.usable.rows.size else None,
        )
    size, first = len(support), problem.hold == "first"
    prior = np.zeros(size + first + problem.fits_dead_time + 1)
    pull = np.zeros(prior.size)
    converged = False
    for step in range(max_steps + 1):
        eq = equations_about(problem, support, point)
        white = eq.whitener(eq.residual)
        if first:
            # In units of the residual found: on exact data the prior must not pull at all.
            mean_square = float(white @ white) / max(white.size, 1)
            prior[size] = _BEND_PRIOR[1] ** -2 * min(1.0, mean_square)
            pull[size] = _BEND_PRIOR[0] - point.bend
        columns = eq.white_derivatives()
        point = replace(point, initial=eq.initial, state=eq.state)
        if converged or step == max_steps:
            break
        change = least_squares(
            np.vstack((columns, np.diag(np.sqrt(prior)))),
            np.concatenate((white, np.sqrt(prior) * pull)),
        )
        moved = float(np.sum((columns @ change) ** 2))
        before = point.time_constant_s
        point = moved_point(problem, point, change)
        point = _with_renewed_noise(problem, point, eq, 1.0 if step < _UNDAMPED else 0.5)
        tau = point.time_constant_s
        cut = abs(tau - before) < 0.999 * abs(change[-1])
        at_bound = tau in (problem.shortest_lag_s, problem.longest_lag_s) and cut
        enough = _NEGLIGIBLE if step < _UNDAMPED else _HARMLESS
        # The second condition ends a run into a bound.
        converged = step > 0 and (moved < enough or (at_bound and step > 8))
    return StructureFit(
        support, point, white, columns, prior, eq.whitener.groups, converged, eq.greatest_gain < 1.0
    )


def refitted(problem: LagProblem, fit: StructureFit, max_steps: int = _MAX_STEPS) -> StructureFit:
    """Fit a structure again, near where it stood, to a problem that was changed."""
    tau, beta = fit.time_constant_s, fit.coefficients
    return fit_structure(problem, fit.support, tau, beta, max_steps=max_steps, near=fit)


def moved_point(problem: LagProblem, point: Point, change: FloatArray) -> Point:
    """Take one step from a point, cut short at the bounds of τ and of the dead time.

    The change is in the order of the columns of `StructureFit.sensitivity`.
    """
    size = point.coefficients.size
    tau, step = point.time_constant_s, float(change[-1])
    tau_new = _bounded(problem, float(np.clip(tau + step, tau / 3, 3 * tau)))
    # A step cut short leaves the coefficients where they belong to the longer one.
    share = max(1.0 if step == 0 else min(1.0, abs((tau_new - tau) / step)), 0.1)
    bend, dead = point.bend, point.dead_time_s
    if problem.hold == "first":
        bend += share * float(change[size])
    if problem.fits_dead_time:
        dead = float(np.clip(dead + share * float(change[-2]), *problem.dead_time_range_s))
    coefficients = point.coefficients + share * change[:size]
    return replace(
        point, time_constant_s=tau_new, dead_time_s=dead, coefficients=coefficients, bend=bend
    )


def _with_renewed_noise(problem: LagProblem, point: Point, eq: Equations, share: float) -> Point:
    """Estimate the noise of φ again, and take that share of the new estimate."""
    noise_part = share * noise_in_inputs(problem, eq, point)
    noise_part += (1 - share) * point.input_noise
    variance = problem.noise.inputs**2 - np.mean(noise_part**2, axis=0)
    return replace(point, input_noise=noise_part, blur=np.sqrt(np.maximum(variance, 0.0)))


def information(problem: LagProblem, fit: StructureFit) -> FloatArray:
    """Return the information of a fit: how fast its score falls when a parameter moves.

    The whitened derivatives alone hold the estimated noise of φ still. It moves with the
    parameters, so that less is known of them: at 5 % noise the errors of a reverse-flow branch came
    out a quarter too small. The matrix -d(score)/d(parameters), symmetric, with the prior, is in
    the order of `fit.sensitivity`.
    """
    fixed = fit.sensitivity.T @ fit.sensitivity + np.diag(fit.prior)
    if not np.any(problem.noise.inputs > 0.0):
        return fixed
    steps = _SHARE_OF_ERROR / np.sqrt(np.maximum(np.diag(fixed), 1e-300))
    columns = []
    for number, step in enumerate(steps):
        move = np.zeros(steps.size)
        move[number] = step
        rise = _score(problem, fit, move) - _score(problem, fit, -move)
        columns.append(-rise / (2 * step))
    found = np.column_stack(columns)
    found = (found + found.T) / 2
    scale = np.sqrt(np.diag(fixed))
    if not (np.all(np.isfinite(found)) and np.all(scale > 0.0)):
        return fixed
    lowest = float(np.linalg.eigvalsh(found / np.outer(scale, scale)).min())
    least = float(np.linalg.eigvalsh(fixed / np.outer(scale, scale)).min())
    # Differences across a kink can be too rough to be an information at all.
    return found if lowest > 0.25 * least else fixed


def _score(problem: LagProblem, fit: StructureFit, move: FloatArray) -> FloatArray:
    """Return the derivative of -χ²/2 a step away from a fit, the noise of φ estimated there."""
    point = moved_point(problem, fit.point, move)
    for _ in range(_RENEWALS):
        eq = equations_about(problem, fit.support, point)
        point = _with_renewed_noise(problem, replace(point, state=eq.state), eq, 1.0)
    eq = equations_about(problem, fit.support, point)
    score: FloatArray = eq.white_derivatives().T @ eq.whitener(eq.residual)
    return score - fit.prior * (point.bend - _BEND_PRIOR[0])


def _bounded(problem: LagProblem, tau: float) -> float:
    return float(np.clip(tau, problem.shortest_lag_s, problem.longest_lag_s))


@dataclass(frozen=True)
class WhiteEquations:
    """The whole library about one fit, whitened, before any compression."""

    # (n_white, n_nuisances): Derivatives with respect to what is estimated beside the coefficients
    # (τ last)
    nuisances: FloatArray
    # (n_white, n_columns): Derivatives with respect to the coefficient of every usable term
    columns: FloatArray
    target: FloatArray  # (n_white,): What the terms have to explain: residual plus the fitted terms
    rows: IndexArray  # (n_white,): Row of the record at which each whitened equation ends

    def compressed(self) -> LinearProblem:
        """Project the nuisances out and keep as many rows as there are columns."""
        return without_nuisances(self.nuisances, self.columns, self.target)


def white_equations(problem: LagProblem, fit: StructureFit) -> WhiteEquations:
    """Set up the whitened equations of the whole library about one fit."""
    eq = equations_about(problem, fit.support, fit.point, whole=True)
    target = eq.residual + eq.columns[:, list(fit.support)] @ fit.coefficients
    white = eq.whitener(np.column_stack((eq.columns, eq.nuisances, target)))
    n = eq.columns.shape[1]
    rows = problem.usable.ends[eq.whitener.kept]
    return WhiteEquations(white[:, n:-1], white[:, :n], white[:, -1], rows)


def plain_free_run(problem: LagProblem, values: FloatArray | None = None) -> FreeRunEquations:
    """Return the free run of terms (n_rows, n_terms) at the measured inputs, all noise in ψ'.

    By default of the simplest of the library: six follow any characteristic well enough to find the
    basin of τ.
    """
    if values is None:
        most = min(6, max(1, problem.usable.later.size // 4), problem.n_without_state)
        values = problem.terms(problem.inputs, wanted=problem.columns[:most].tolist())
    weight = np.zeros(problem.output.size)
    weight[problem.usable.rows] = 1.0
    return FreeRunEquations(
        problem.late(values),
        np.empty((weight.size, 0)),
        problem.output,
        weight,
        problem.segments,
        problem.sample_period_s,
        problem.hold,
    )
