"""Output-error fit of the lumped model to measured P31, P25 and W25."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.records import Record
from classic_ml.reduction import Reduction
from comparisons.total_system.gauss_newton import Solution, solve
from comparisons.total_system.measured import (
    OUTPUTS,
    SMOOTHING_S,
    Measured,
    measured_signals,
    observed_states,
)
from comparisons.total_system.model import TotalSystemModel
from comparisons.total_system.settings import (
    TotalSystemFit,
    TotalSystemSettings,
    TotalSystemState,
)
from comparisons.total_system.shooting import (
    Parameters,
    Shooting,
    multiple_shooting,
    single_shooting,
)
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["fit_total_system", "prepare", "surge_start_s", "with_start_values"]


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


def fit_total_system(
    data: Record | Reduction | Measured,
    test: TestDescription,
    settings: TotalSystemSettings,
    *,
    progress: Callable[[], object] = lambda: None,
) -> TotalSystemFit:
    """Fit β and τ of a model of the whole system to P31, P25 and W25 (output error).

    Minimises Σ ((P31, P25, W25 measured − simulated)/σ)² with σ the residual of each channel.

    Parameters
    ----------
    data : Record, Reduction or Measured
        Raw record, its reduction, or a record of the plane averages; see `measured_signals`.
    test : TestDescription
        The test it belongs to.
    settings : TotalSystemSettings
        Facility and switches.
    progress : callable
        Called after each step of the search.

    Returns
    -------
    TotalSystemFit
        β, τ, errors, residuals; a fit that went badly says so in its state.

    Raises
    ------
    InputError
        When the record or a number of the facility cannot be used.
    """
    measured = _measured(data, test, settings)
    shooting, model = prepare(measured, test, with_start_values(measured, test, settings, progress))
    z, nodes = shooting.parameters.start(model), shooting.first_nodes[:, :0]
    spread = np.std(np.concatenate(shooting.scored_outputs), axis=0)
    sigma = heaviest = np.hypot(_FIRST_SIGMA * spread, shooting.noise)
    solution: Solution | None = None
    trace: list[float] = []
    for tolerance in _PASSES:
        found = solve(
            lambda z, n, w=sigma: shooting.residuals(z, n, w),  # type: ignore[misc]
            z,
            nodes,
            max_iterations=settings.max_iterations,
            tolerance=tolerance,
            n_blocks=max(1, round(shooting.duration_s / _BLOCK_S)),
            progress=progress,
        )
        if found is None:
            break
        solution, z, nodes = found, found.common, found.nodes
        trace += found.cost_trace
        sigma = np.clip(shooting.rms(z, nodes), _SMALLEST_SIGMA * spread, heaviest)
        if tolerance != _PASSES[-1]:
            nodes = _next_nodes(shooting, solution)
    return _result(shooting, settings, solution, z, nodes, tuple(trace))


def _next_nodes(shooting: Shooting, solution: Solution) -> FloatArray:
    """Return the nodes that the next pass starts from: those that ran off go back."""
    nodes = shooting.first_nodes.copy()
    if solution.nodes.shape == nodes.shape and nodes.size:
        cost = np.array([r @ r / r.size for r in solution.residuals])
        kept = cost <= _RAN_OFF * np.median(cost)
        nodes[kept] = solution.nodes[kept]
    return nodes


def _measured(
    data: Record | Reduction | Measured, test: TestDescription, settings: TotalSystemSettings
) -> Measured:
    if isinstance(data, Measured):
        return data
    smoothing = SMOOTHING_S if settings.smoothing_s is None else settings.smoothing_s
    return measured_signals(data, test, smoothing)


def with_start_values(
    measured: Measured,
    test: TestDescription,
    settings: TotalSystemSettings,
    progress: Callable[[], object] = lambda: None,
) -> TotalSystemSettings:
    """Give a single run, whose cost has many minima, the start that multiple shooting finds.

    Parameters
    ----------
    measured, test, settings, progress
        As in `fit_total_system`.

    Returns
    -------
    TotalSystemSettings
        With ``initial_beta`` and ``initial_tau_s``; unchanged where they were given, or multiple
        shooting found none.
    """
    if settings.start == "multiple-shooting" or settings.initial_beta is not None:
        return settings
    first = replace(settings, start="multiple-shooting", start_error_s=0.0, fit_also=())
    try:
        found = fit_total_system(measured, test, first, progress=progress)
    except InputError:
        return settings
    if found.state is not TotalSystemState.CONVERGED:
        return settings
    return replace(settings, initial_beta=found.beta, initial_tau_s=found.tau_s)


def prepare(
    data: Record | Reduction | Measured, test: TestDescription, settings: TotalSystemSettings
) -> tuple[Shooting, TotalSystemModel]:
    """Return the runs that a fit will make, and the model it starts from.

    Parameters
    ----------
    data, test, settings
        As in `fit_total_system`.
    """
    measured = _measured(data, test, settings)
    facility = replace(
        settings.facility,
        discharge_volume_m3=settings.facility.discharge_volume_m3 * settings.volume_factor,
    )
    # Before anything is known of the characteristic: no stall is run with it.
    model = TotalSystemModel(
        test,
        facility,
        measured.near_stall_flow_kg_s,
        settings.initial_beta or (1.0, 0.0, 0.0),
        settings.initial_tau_s,
        measured.reversal_s,
        settings.measured_t25,
    )
    states, latches = observed_states(measured, model)
    if settings.initial_beta is None:
        model = replace(model, beta=_static_parabola(measured, model, states, latches))
    model = replace(model, start_s=surge_start_s(measured, model, states) + settings.start_error_s)
    parameters = Parameters.of(settings, model)
    if settings.start == "multiple-shooting":
        shooting = multiple_shooting(measured, model, settings, parameters)
    else:
        shooting = single_shooting(measured, model, settings, parameters, states)
    return shooting, model


def surge_start_s(measured: Measured, model: TotalSystemModel, states: FloatArray) -> float:
    """Return the surge start with which the model's flow first reverses when the measured does.

    Parameters
    ----------
    measured : Measured
        The record.
    model : TotalSystemModel
        The model.
    states : ndarray of shape (n, 11)
        Observed states.
    """
    from comparisons.total_system.shooting import delay_to_reversal_s

    return measured.reversal_s - delay_to_reversal_s(measured, model, states)


def _static_parabola(
    measured: Measured, model: TotalSystemModel, states: FloatArray, latches: FloatArray
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
    ahead = states[:, 1] + model.tau_s * np.gradient(states[:, 1], measured.period_s)
    c = np.polynomial.polynomial.polyfit(phi[rows], ahead[rows], 2)
    return float(c[0]), float(c[1]), float(c[2])


def _result(
    shooting: Shooting,
    settings: TotalSystemSettings,
    solution: Solution | None,
    z: FloatArray,
    nodes: FloatArray,
    trace: tuple[float, ...],
) -> TotalSystemFit:
    parameters = shooting.parameters
    values = parameters.values(z)
    covariance = np.full((z.size, z.size), np.nan)
    rms = np.full(3, np.nan)
    if solution is not None:
        slopes = parameters.slopes(z)
        covariance = solution.covariance * np.outer(slopes, slopes)
        rms = shooting.rms(z, nodes)
    error = np.sqrt(np.diag(covariance))
    spread = np.std(np.concatenate(shooting.scored_outputs), axis=0)
    return TotalSystemFit(
        beta=(values["beta_1"], values["beta_2"], values["beta_3"]),
        beta_stderr=(float(error[0]), float(error[1]), float(error[2])),
        tau_s=values["tau"],
        tau_stderr_s=float(error[3]),
        covariance=covariance[:4, :4],
        others=MappingProxyType(
            {
                name: (values[name], float(error[i]))
                for i, name in enumerate(parameters.names)
                if i > 3
            }
        ),
        start_s=shooting.start_s(z),
        state=_state(solution, _follows(shooting, z, nodes, spread), values["tau"]),
        rms=MappingProxyType(dict(zip(OUTPUTS, rms.tolist(), strict=True))),
        relative_rms=MappingProxyType(dict(zip(OUTPUTS, (rms / spread).tolist(), strict=True))),
        cost_trace=trace,
        n_segments=len(shooting.scored_outputs),
        n_rows=sum(len(rows) for rows in shooting.scored_outputs),
        settings=settings,
    )


def _follows(shooting: Shooting, z: FloatArray, nodes: FloatArray, spread: FloatArray) -> bool:
    """Tell whether the simulation follows P31 and W25; the spikes of P25 are a row or two wide."""
    allowed = _LOST * spread + _SLOW_SHARE * shooting.noise
    return bool(np.all((shooting.slow_rms(z, nodes) <= allowed)[[0, 2]]))


def _state(solution: Solution | None, follows: bool, tau_s: float) -> TotalSystemState:
    if solution is None:
        return TotalSystemState.DIVERGED
    if not _TAU_BOUNDS_S[0] < tau_s < _TAU_BOUNDS_S[1]:
        return TotalSystemState.AT_BOUND
    if not follows:
        return TotalSystemState.LOST_THE_CYCLES
    if solution.singular:
        return TotalSystemState.RANK_DEFICIENT
    return TotalSystemState.CONVERGED if solution.converged else TotalSystemState.NOT_CONVERGED
