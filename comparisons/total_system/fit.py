"""Output-error fit of the lumped model to measured P31, P25 and W25."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import block_diag, csr_array, hstack

from comparisons.total_system.fitted import (
    ALIGNED,
    MULTIPLE,
    OUTPUTS,
    TotalSystemFit,
    TotalSystemSettings,
    TotalSystemState,
)
from comparisons.total_system.measured import Measured, first_reversal_s, observed_states
from comparisons.total_system.model import (
    COLUMNS,
    NO_STATES,
    STEPS_PER_SECOND,
    TotalSystemModel,
    integrate,
)
from surge_core.errors import InputError
from surge_core.types import FloatArray

_FITTED = [COLUMNS.index(name) for name in OUTPUTS]
# Of β, of order (1, 3, 50); the logarithm of τ is its own scale.
_SCALES = np.array([1.0, 1.0, 10.0, 1.0])
_N_COMMON = _SCALES.size
# States that are fitted at the begin of a segment, the size of a unit step (kg/s, ψ', P31 and P_in
# over their means) and what a state read off the record may be wrong by in such steps. Without that
# a segment's states run off, with all its rows, into a history that never was.
_NODE_STATES = [0, 1, 3, 5]
_NODE_SCALES = np.array([1.0, 0.1, 0.01, 0.01])
_NODE_ERRORS = np.array([2.0, 3.0, 2.0, 2.0])
_SEGMENT_S = 0.08
_SHORTEST_SEGMENT_ROWS = 10
# Around a node the branch must not change: its own switching time would be one more unknown.
_QUIET_S = 0.012
# A single run is scored from a little before the collapse, which an early start would otherwise
# miss, over so much of the surge. The flow collapses some 17 ms before it reverses; the state that
# it starts from is the mean over what ends well ahead.
_BEFORE_REVERSAL_S, _HORIZON_S = 0.03, 0.5
_COLLAPSE_S = 0.017
_BEFORE_COLLAPSE_S = (0.045, 0.025)
# In the first pass each channel weighs by its noise and this share of its spread; then by its own
# residual, but never by more than that, or a channel left to itself would lose all weight.
_FIRST_SIGMA = 0.03
_SMALLEST_SIGMA = 1e-4
# Slow residual over the swing of P31 and W25: good fits of the simulated rig stay below 0.1, those
# in a wrong minimum lie above 0.25 in one of them. Half of the fast noise may be slow as well: flow
# near zero is rectified.
_LOST, _SLOW_SHARE = 0.2, 0.5
# Multiple shooting has one basin: from here, and from far beside, it ends at the same place.
_FIRST_BETA = (1.0, 2.0, 40.0)
# A single run has no segments over which to sum the scores; it is cut into blocks.
_BLOCK_S = 0.05
# How well each pass must converge: the first only finds the weights of the last.
_PASSES = (1e-3, 1e-5)
# Of the scaled parameters: small against what they are to be known to, large against rounding.
_DIFFERENCE = 1e-4


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
    if settings.start == ALIGNED and settings.initial_beta is None:
        # The cost of a single run has many minima.
        shooting = replace(settings, start=MULTIPLE, start_error_s=0.0)
        first = fit_total_system(measured, shooting, progress=progress)
        if first.state is TotalSystemState.CONVERGED:
            settings = replace(settings, initial_beta=first.beta, initial_tau_s=first.tau_s)
    runs = _prepare(measured, settings)
    z, nodes = np.zeros(_N_COMMON), np.zeros((len(runs.segments), 0))
    outputs = np.concatenate([measured.outputs[rows] for rows in runs.segments])
    spread = np.std(outputs, axis=0)
    sigma = heaviest = np.hypot(_FIRST_SIGMA * spread, runs.noise())
    found, trace = None, []
    for tolerance in _PASSES:
        result = _solve(runs, z, sigma, tolerance)
        progress()
        if result is None:
            break
        found, z, nodes = result
        trace.append(float(found.cost))
        residual = np.concatenate(runs.simulate(z, nodes)) - outputs
        rms = np.sqrt(np.mean(residual**2, axis=0))
        sigma = np.clip(rms, _SMALLEST_SIGMA * spread, heaviest)
    model, error, state = runs.model_at(z), np.full(4, np.nan), TotalSystemState.DIVERGED
    if found is None:
        rms = np.full(3, np.nan)
    else:
        scale = _SCALES * [1.0, 1.0, 1.0, model.tau_s]
        error = scale * np.sqrt(np.diag(_covariance(runs, found, nodes.shape[1])))
        slow = np.std([measured.smooth(column) for column in residual.T], axis=1)
        # P31 and W25; the spikes of P25 are a row or two wide.
        follows = np.all((slow <= _LOST * spread + _SLOW_SHARE * runs.noise())[[0, 2]])
        state = TotalSystemState.LOST_THE_CYCLES
        if follows:
            done = found.status > 0
            state = TotalSystemState.CONVERGED if done else TotalSystemState.NOT_CONVERGED
    return TotalSystemFit(
        beta=model.beta,
        beta_stderr=tuple(error[:3].tolist()),
        tau_s=model.tau_s,
        tau_stderr_s=float(error[3]),
        start_s=runs.aligned(model)[1] if settings.start == ALIGNED else model.start_s,
        state=state,
        rms=dict(zip(OUTPUTS, rms.tolist(), strict=True)),
        relative_rms=dict(zip(OUTPUTS, (rms / spread).tolist(), strict=True)),
        cost_trace=tuple(trace),
        n_segments=len(runs.segments),
        n_rows=len(outputs),
        settings=settings,
    )


@dataclass(frozen=True)
class _Runs:
    """The runs that one evaluation of the cost makes: one of all, or one in each segment.

    ``model`` stands where all scaled departures are zero; ``states`` and ``latches`` are observed.
    """

    measured: Measured
    settings: TotalSystemSettings
    model: TotalSystemModel
    states: FloatArray
    latches: FloatArray
    segments: list[slice]

    def model_at(self, z: FloatArray) -> TotalSystemModel:
        """Return the model with scaled departures put in."""
        step = z * _SCALES
        b1, b2, b3 = (np.asarray(self.model.beta) + step[:3]).tolist()
        # Beyond e^±20 a trial step would overflow.
        tau_s = self.model.tau_s * float(np.exp(np.clip(step[3], -20.0, 20.0)))
        return replace(self.model, beta=(b1, b2, b3), tau_s=tau_s)

    def noise(self) -> FloatArray:
        """Return what the measured outputs hold beside their average over the smoothing width."""
        rows = slice(self.segments[0].start, self.segments[-1].stop)
        fast = [column - self.measured.smooth(column) for column in self.measured.outputs.T]
        return np.asarray([np.std(column[rows]) for column in fast])

    def residuals(self, z: FloatArray, nodes: FloatArray, sigma: FloatArray) -> list[FloatArray]:
        """Return the weighted residuals of each run, and of its node over their errors."""
        errors = _NODE_ERRORS[: nodes.shape[1]]
        runs = zip(self.simulate(z, nodes), self.segments, nodes, strict=True)
        return [
            np.concatenate([((run - self.measured.outputs[rows]) / sigma).ravel(), node / errors])
            for run, rows, node in runs
        ]

    def simulate(self, z: FloatArray, nodes: FloatArray) -> list[FloatArray]:
        """Return the outputs of each run.

        In segments the machine goes into stall and out of it when the measured φ says so: with the
        model's own φ the cost jumps where a trial run recovers late or not at all, and the search
        sticks.
        """
        model, measured = self.model_at(z), self.measured
        if self.settings.start == ALIGNED:
            return [self.aligned(model)[0]]
        c, substeps = model.constants(), max(1, round(measured.period_s * STEPS_PER_SECOND))
        scale = _NODE_SCALES * [1.0, 1.0, *np.mean(self.states[:, [3, 5]], axis=0)]
        runs = []
        for rows, node in zip(self.segments, nodes, strict=True):
            begin, latches = self.states[rows.start].copy(), self.latches[rows]
            begin[_NODE_STATES[: node.size]] += scale[: node.size] * node
            first_s, n = float(measured.time_s[rows.start]), rows.stop - rows.start
            own = c, begin, latches[0], first_s, n, measured.period_s, substeps
            run = integrate(*own, latches, NO_STATES)
            runs.append(run[:, _FITTED])
        return runs

    def aligned(self, model: TotalSystemModel) -> tuple[FloatArray, float]:
        """Return the outputs of one run that reverses when the record does, and its surge start.

        The run is made from a nominal start and moved in time as a whole; before, the model rests.
        """
        measured, (rows,) = self.measured, self.segments
        early, late = (measured.reversal_s - s for s in _BEFORE_COLLAPSE_S)
        before = measured.rows(early, late)
        state = self.states[before].mean(axis=0)
        state[0], state[3] = measured.W25[before].mean(), measured.P31[before].mean()
        step_s = 1.0 / STEPS_PER_SECOND
        run = replace(model, start_s=measured.reversal_s - _COLLAPSE_S).simulate(
            n_rows=round((_HORIZON_S + 2.0 * _BEFORE_REVERSAL_S) / step_s),
            period_s=step_s,
            state=state,
        )
        since_s: FloatArray = step_s * np.arange(run["W25"].size, dtype=np.float64)
        delay_s = first_reversal_s(since_s, run["W25"])
        # A trial characteristic without reversal has no delay of its own.
        start_s = measured.reversal_s - (_COLLAPSE_S if delay_s is None else delay_s)
        start_s += self.settings.start_error_s
        times = measured.time_s[rows]
        resting = np.array([state[3], measured.P25[before].mean(), state[0]])
        columns = [
            np.interp(times, start_s + since_s, run[name], left=value)
            for name, value in zip(OUTPUTS, resting, strict=True)
        ]
        return np.column_stack(columns), start_s


def _prepare(measured: Measured, settings: TotalSystemSettings) -> _Runs:
    """Return the runs that a fit will make."""
    model = TotalSystemModel(
        measured.test,
        settings.facility,
        measured.near_stall_flow_kg_s,
        settings.initial_beta or _FIRST_BETA,
        settings.initial_tau_s,
        measured.reversal_s - _COLLAPSE_S + settings.start_error_s,
        settings.volume_factor,
    )
    states, latches = observed_states(measured, model)
    if settings.start == MULTIPLE:
        segments = _segments(measured, settings, latches)
    else:
        until_s = measured.reversal_s + _HORIZON_S
        segments = [measured.rows(measured.reversal_s - _BEFORE_REVERSAL_S, until_s)]
    return _Runs(measured, settings, model, states, latches, segments)


def _segments(
    measured: Measured, settings: TotalSystemSettings, latches: FloatArray
) -> list[slice]:
    """Return the rows of each segment, begun where no branch changes."""
    window = settings.window_s or measured.window_s
    rows = measured.rows(*window)
    quiet = max(1, round(_QUIET_S / measured.period_s))
    changes = np.abs(np.diff(latches[:, 0], prepend=latches[0, 0]))
    near = np.convolve(changes, np.ones(2 * quiet + 1), mode="same") > 0.5
    # Nor where the flow reverses: there states read off the record are least sure.
    good = np.flatnonzero(~near & (latches[:, 0] > 0.5) & (measured.smooth(measured.W25) > 0.0))
    good = good[(good >= rows.start) & (good < rows.stop)]
    length = round(_SEGMENT_S / measured.period_s)
    nodes: list[int] = []
    for target in range(rows.start, rows.stop, length) if good.size else ():
        row = int(good[np.argmin(np.abs(good - target))])
        if not nodes or row - nodes[-1] >= length // 2:
            nodes.append(row)
    if len(nodes) < 2:
        raise InputError(
            f"{measured.source}: window {window[0]:.3f} to {window[1]:.3f} s",
            expected="in-stall rows with forward flow at which at least two segments can begin",
            found=f"{len(nodes)}",
            remedy="name a longer window",
        )
    ends = [*nodes[1:], min(rows.stop, nodes[-1] + length)]
    pairs = zip(nodes, ends, strict=True)
    return [slice(a, b) for a, b in pairs if b - a >= _SHORTEST_SEGMENT_ROWS]


def _solve(
    runs: _Runs, common: FloatArray, sigma: FloatArray, tolerance: float
) -> tuple[Any, FloatArray, FloatArray] | None:
    """Minimise the sum of squares from a start; None where the model is not finite there."""
    n_free = 0 if runs.settings.start == ALIGNED else len(_NODE_STATES)
    shape = (len(runs.segments), n_free)

    def apart(unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        # Departures from the start, plus 1: the difference of each is then a share of its scale.
        moved = unknowns - 1.0
        return common + moved[:_N_COMMON], moved[_N_COMMON:].reshape(shape)

    def residuals(unknowns: FloatArray) -> FloatArray:
        return np.concatenate(runs.residuals(*apart(unknowns), sigma))

    start = np.ones(_N_COMMON + shape[0] * n_free)
    at_start = runs.residuals(*apart(start), sigma)
    if not all(np.all(np.isfinite(part)) for part in at_start):
        return None
    own: Any = block_diag([np.ones((part.size, n_free)) for part in at_start])
    shared = np.ones((own.shape[0], _N_COMMON))
    found = least_squares(
        residuals,
        start,
        jac_sparsity=hstack([csr_array(shared), own]) if n_free else None,
        diff_step=np.full(start.size, _DIFFERENCE),
        ftol=tolerance,
        xtol=1e-10,
        gtol=1e-12,
        max_nfev=runs.settings.max_iterations,
    )
    return found, *apart(found.x)


def _covariance(runs: _Runs, found: Any, n_free: int) -> FloatArray:
    """Return H⁻¹ (Σ g gᵀ) H⁻¹ of the common parameters, over segments or blocks of a single one.

    It holds for coloured residuals and for a model that is not quite right.
    """
    jacobian = found.jac.toarray() if n_free else found.jac
    own = jacobian[:, _N_COMMON:]
    # What the segments' own states can take up says nothing of the common parameters.
    projected = jacobian[:, :_N_COMMON]
    projected = projected - own @ np.linalg.lstsq(own, projected, rcond=None)[0]
    rows = [segment.stop - segment.start for segment in runs.segments]
    edges = np.cumsum([3 * n + n_free for n in rows])[:-1]
    n_blocks = max(1, round(sum(rows) * runs.measured.period_s / _BLOCK_S))
    pieces = np.array_split(np.arange(found.fun.size), edges if len(rows) > 1 else n_blocks)
    if len(pieces) <= _N_COMMON:
        return np.full((_N_COMMON, _N_COMMON), np.nan)
    inverse = np.linalg.pinv(projected.T @ projected, hermitian=True)
    g = np.array([projected[piece].T @ found.fun[piece] for piece in pieces])
    # Small-sample factor n/(n − p) of cluster-robust covariances.
    middle = g.T @ g * len(pieces) / (len(pieces) - _N_COMMON)
    return np.asarray(inverse @ middle @ inverse)
