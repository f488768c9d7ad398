"""Output-error fit of the lumped model to measured P31, P25 and W25."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_array, lil_matrix

from comparisons.total_system.measured import Measured, observed_states
from comparisons.total_system.model import TotalSystemModel
from comparisons.total_system.settings import (
    MULTIPLE,
    OUTPUTS,
    TotalSystemFit,
    TotalSystemSettings,
    TotalSystemState,
)
from comparisons.total_system.shooting import N_PARAMETERS, Runs, runs_of_settings, surge_start_s
from surge_core.errors import InputError
from surge_core.types import FloatArray, IndexArray

__all__ = ["fit_total_system"]

# In the first pass each channel weighs by its noise and this share of its spread; then by its own
# residual, but never by more than that, or a channel left to itself would lose all weight.
_FIRST_SIGMA = 0.03
_SMALLEST_SIGMA = 1e-4
# Slow residual over the swing of P31 and W25: good fits of the simulated rig stay below 0.1, those
# in a wrong minimum lie above 0.25 in one of them. Half of the fast noise may be slow as well: flow
# near zero is rectified.
_LOST, _SLOW_SHARE = 0.2, 0.5
_TAU_BOUNDS_S = (1e-3, 1.0)
# Parabola through measured ψ' where φ is measured well and the machine is in stall.
_PHI_OF_START = (0.0, 0.15)
_BLOCK_S = 0.05
# How well each pass must converge: the first two only find the weights of the last.
_PASSES = (1e-2, 1e-3, 1e-5)
# A run whose cost is this many times the median one sits where its states ran off to.
_RAN_OFF = 4.0
# Of the scaled parameters: small against what they are to be known to, large against rounding.
_DIFFERENCE = 1e-4
# A curvature below this share of the largest is none.
_SINGULAR = 1e-12
# What a state read off the record may be wrong by, in its units. Without it a segment's states run
# off, with all its rows, into a history that never was.
_NODE_ERRORS = np.array([2.0, 3.0, 2.0, 2.0])


def fit_total_system(
    measured: Measured,
    settings: TotalSystemSettings,
    *,
    progress: Callable[[], object] = lambda: None,
) -> TotalSystemFit:
    """Fit β and τ of a model of the whole system to P31, P25 and W25 (output error).

    Minimises Σ ((P31, P25, W25 measured − simulated)/σ)² with σ the residual of each channel. The
    flow, ψ', P31 and inlet pressure at the begin of a segment are nuisance parameters of that
    segment alone: the Jacobian is sparse, and one run of all segments gives one column of each.

    Parameters
    ----------
    measured : Measured
        The record; see `measured_signals`.
    settings : TotalSystemSettings
        Facility and switches.
    progress : callable
        Called after each pass of the search.

    Returns
    -------
    TotalSystemFit
        β, τ, errors, residuals; a fit that went badly says so in its state.

    Raises
    ------
    InputError
        When the record or a number of the facility cannot be used.
    """
    runs = _runs(measured, _with_start_values(measured, settings, progress))
    z, nodes = np.zeros(N_PARAMETERS), np.zeros((runs.n_runs, 0))
    spread = np.std(np.concatenate(runs.measured_outputs), axis=0)
    sigma = heaviest = np.hypot(_FIRST_SIGMA * spread, runs.noise)
    solution: _Solution | None = None
    trace: list[float] = []
    for tolerance in _PASSES:
        found = _solve(runs, z, nodes, sigma, tolerance, settings.max_iterations)
        progress()
        if found is None:
            break
        solution, z, nodes = found, found.common, found.nodes
        trace.append(found.cost)
        sigma = np.clip(runs.rms(z, nodes), _SMALLEST_SIGMA * spread, heaviest)
        if tolerance != _PASSES[-1]:
            nodes = _next_nodes(runs, solution)
    return _result(runs, settings, solution, z, nodes, tuple(trace))


def _runs(measured: Measured, settings: TotalSystemSettings) -> Runs:
    """Return the runs that a fit will make."""
    # Before anything is known of the characteristic: no stall is run with it.
    model = TotalSystemModel(
        measured.test,
        settings.facility,
        measured.near_stall_flow_kg_s,
        settings.initial_beta or (1.0, 0.0, 0.0),
        settings.initial_tau_s,
        measured.reversal_s,
        settings.volume_factor,
    )
    states, latches = observed_states(measured, model)
    if settings.initial_beta is None:
        beta = _static_parabola(measured, settings.initial_tau_s, states, latches)
        model = replace(model, beta=beta)
    start_s = surge_start_s(measured, model, states) + settings.start_error_s
    return runs_of_settings(measured, replace(model, start_s=start_s), settings, states)


def _with_start_values(
    measured: Measured, settings: TotalSystemSettings, progress: Callable[[], object]
) -> TotalSystemSettings:
    """Give a single run, whose cost has many minima, the start that multiple shooting finds."""
    if settings.start == MULTIPLE or settings.initial_beta is not None:
        return settings
    first = replace(settings, start=MULTIPLE, start_error_s=0.0)
    try:
        found = fit_total_system(measured, first, progress=progress)
    except InputError:
        return settings
    if found.state is not TotalSystemState.CONVERGED:
        return settings
    return replace(settings, initial_beta=found.beta, initial_tau_s=found.tau_s)


def _static_parabola(
    measured: Measured, tau_s: float, states: FloatArray, latches: FloatArray
) -> tuple[float, float, float]:
    """Return the parabola through ψ' + τ dψ'/dt over φ in stall, both as measured, for one τ."""
    phi = measured.phi()
    rows = (latches[:, 0] > 0.5) & (phi > _PHI_OF_START[0]) & (phi < _PHI_OF_START[1])
    rows &= measured.time_s > measured.reversal_s + 0.05
    if np.count_nonzero(rows) < 20:
        raise InputError(
            measured.source,
            expected="rows in stall with forward flow after the first reversal",
            found=f"{np.count_nonzero(rows)}",
            remedy="the record ends too early, or recovery_phi is too low",
        )
    ahead = states[:, 1] + tau_s * np.gradient(states[:, 1], measured.period_s)
    c = np.polynomial.polynomial.polyfit(phi[rows], ahead[rows], 2)
    return float(c[0]), float(c[1]), float(c[2])


@dataclass(frozen=True)
class _Solution:
    """Where one pass ended: scaled parameters and nodes, errors, cost."""

    common: FloatArray
    nodes: FloatArray
    covariance: FloatArray
    cost: float
    cost_of_run: FloatArray
    converged: bool
    singular: bool


def _solve(
    runs: Runs,
    common: FloatArray,
    nodes: FloatArray,
    sigma: FloatArray,
    tolerance: float,
    max_iterations: int,
) -> _Solution | None:
    """Minimise the sum of squares from a start; None where the model is not finite there."""
    p, k = common.size, nodes.shape[1]

    def apart(unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        # Departures from the start, plus 1: the difference of each is then a share of its scale.
        moved = unknowns - 1.0
        return common + moved[:p], nodes + moved[p:].reshape(nodes.shape)

    def residuals(unknowns: FloatArray) -> FloatArray:
        return np.concatenate(runs.residuals(*apart(unknowns), sigma, _NODE_ERRORS[:k]))

    start = np.ones(p + nodes.size)
    lengths = [r.size for r in runs.residuals(common, nodes, sigma, _NODE_ERRORS[:k])]
    if not np.all(np.isfinite(residuals(start))):
        return None
    pattern = lil_matrix((sum(lengths), start.size))
    pattern[:, :p] = 1.0
    last = 0
    for i, length in enumerate(lengths):
        first, last = last, last + length
        pattern[first:last, p + i * k : p + (i + 1) * k] = 1.0
    found = least_squares(
        residuals,
        start,
        jac_sparsity=pattern,
        diff_step=np.full(start.size, _DIFFERENCE),
        ftol=tolerance,
        xtol=1e-10,
        gtol=1e-12,
        max_nfev=max_iterations,
    )
    z, states = apart(found.x)
    jacobian = np.asarray(csr_array(found.jac).toarray())  # type: ignore[arg-type]
    edges = np.cumsum(lengths)[:-1]
    n_blocks = max(1, round(runs.duration_s / _BLOCK_S))
    pieces = np.array_split(np.arange(found.fun.size), edges if len(lengths) > 1 else n_blocks)
    covariance, singular = _covariance(jacobian, found.fun, pieces, p)
    cost_of_run = np.array([r @ r / r.size for r in np.split(found.fun, edges)])
    return _Solution(z, states, covariance, found.cost, cost_of_run, found.status > 0, singular)


def _covariance(
    jacobian: FloatArray, residual: FloatArray, pieces: list[IndexArray], p: int
) -> tuple[FloatArray, bool]:
    """Return H⁻¹ (Σ g gᵀ) H⁻¹ of the common parameters, over segments or blocks of a single one.

    It holds for coloured residuals and for a model that is not quite right.
    """
    own = jacobian[:, p:]
    # What the segments' own states can take up says nothing of the common parameters.
    projected = jacobian[:, :p] - own @ np.linalg.lstsq(own, jacobian[:, :p], rcond=None)[0]
    scale = np.sqrt(np.maximum(np.sum(projected**2, axis=0), 1e-300))
    normed = (projected / scale).T @ (projected / scale)
    values = np.linalg.eigvalsh(normed)
    singular = bool(values[0] <= _SINGULAR * values[-1])
    if singular or len(pieces) <= p:
        return np.full((p, p), np.nan), singular
    inverse = np.linalg.inv(normed) / np.outer(scale, scale)
    g = np.array([projected[rows].T @ residual[rows] for rows in pieces])
    # Small-sample factor n/(n − p) of cluster-robust covariances.
    middle = g.T @ g * len(pieces) / (len(pieces) - p)
    return inverse @ middle @ inverse, False


def _next_nodes(runs: Runs, solution: _Solution) -> FloatArray:
    """Return the nodes that the next pass starts from: those that ran off go back."""
    nodes = np.zeros((runs.n_runs, runs.n_node_states))
    if solution.nodes.shape == nodes.shape:
        kept = solution.cost_of_run <= _RAN_OFF * np.median(solution.cost_of_run)
        nodes[kept] = solution.nodes[kept]
    return nodes


def _result(
    runs: Runs,
    settings: TotalSystemSettings,
    solution: _Solution | None,
    z: FloatArray,
    nodes: FloatArray,
    trace: tuple[float, ...],
) -> TotalSystemFit:
    model = runs.model_at(z)
    covariance = np.full((z.size, z.size), np.nan)
    rms = np.full(3, np.nan)
    spread = np.std(np.concatenate(runs.measured_outputs), axis=0)
    state = TotalSystemState.DIVERGED
    if solution is not None:
        slopes = runs.slopes(z)
        covariance = solution.covariance * np.outer(slopes, slopes)
        rms = runs.rms(z, nodes)
        # P31 and W25; the spikes of P25 are a row or two wide.
        allowed = _LOST * spread + _SLOW_SHARE * runs.noise
        follows = bool(np.all((runs.slow_rms(z, nodes) <= allowed)[[0, 2]]))
        state = _state(solution, follows, model.tau_s)
    error = np.sqrt(np.diag(covariance))
    return TotalSystemFit(
        beta=model.beta,
        beta_stderr=(float(error[0]), float(error[1]), float(error[2])),
        tau_s=model.tau_s,
        tau_stderr_s=float(error[3]),
        covariance=covariance,
        start_s=runs.start_s(z),
        state=state,
        rms=MappingProxyType(dict(zip(OUTPUTS, rms.tolist(), strict=True))),
        relative_rms=MappingProxyType(dict(zip(OUTPUTS, (rms / spread).tolist(), strict=True))),
        cost_trace=trace,
        n_segments=runs.n_runs,
        n_rows=sum(len(rows) for rows in runs.measured_outputs),
        settings=settings,
    )


def _state(solution: _Solution, follows: bool, tau_s: float) -> TotalSystemState:
    if not _TAU_BOUNDS_S[0] < tau_s < _TAU_BOUNDS_S[1]:
        return TotalSystemState.AT_BOUND
    if not follows:
        return TotalSystemState.LOST_THE_CYCLES
    if solution.singular:
        return TotalSystemState.RANK_DEFICIENT
    return TotalSystemState.CONVERGED if solution.converged else TotalSystemState.NOT_CONVERGED
