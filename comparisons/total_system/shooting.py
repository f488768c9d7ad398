"""Runs of the model against the record: one from the surge start, or one in each segment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from comparisons.total_system.measured import (
    OUTPUTS,
    Measured,
    observed_states,
    state_before_surge,
)
from comparisons.total_system.model import COLUMNS, STEPS_PER_SECOND, TotalSystemModel
from comparisons.total_system.settings import TotalSystemSettings
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "Parameters",
    "Shooting",
    "delay_to_reversal_s",
    "multiple_shooting",
    "single_shooting",
]


_FITTED = [COLUMNS.index(name) for name in OUTPUTS]
# β of order (1, 3, 50); logarithms are their own scale; 10 ms of start.
_BETA_SCALE = (1.0, 1.0, 10.0)
_START_SCALE_S = 0.01
# States that are fitted at a node, with the size of a unit step: kg/s, ψ', Pa of P31 and P_in.
_NODE_STATES = (0, 1, 3, 5)
# What a state read off the record may be wrong by, in these units. Without it a segment's states
# run off, with all its rows, into a history that never was.
_NODE_ERRORS = (2.0, 3.0, 2.0, 2.0)
# Around a node the branch must not change: its own switching time would be one more unknown.
_QUIET_S = 0.012
# A run is scored from a little before the collapse, which an early start would otherwise miss.
_BEFORE_REVERSAL_S = 0.03
_DELAY_STEP_S = 0.5e-3
_LONGEST_DELAY_S = 0.08
_SHORTEST_SEGMENT_ROWS = 10


@dataclass(frozen=True)
class Parameters:
    """Common parameters of a fit: their names, and how they follow from scaled numbers.

    Parameters
    ----------
    names : tuple of str
        ``"beta_1"``, ``"beta_2"``, ``"beta_3"``, ``"tau"``, and what is fitted besides.
    start_s : float
        Surge start from which a fitted one is counted.
    tau_s : float
        τ at z = 0.
    """

    names: tuple[str, ...]
    start_s: float
    tau_s: float

    @classmethod
    def of(cls, settings: TotalSystemSettings, model: TotalSystemModel) -> Parameters:
        """Return the parameters that the settings name."""
        start = ("start",) if settings.start == "fitted" else ()
        names = ("beta_1", "beta_2", "beta_3", "tau", *settings.fit_also, *start)
        return cls(names, model.start_s, model.tau_s)

    def start(self, model: TotalSystemModel) -> FloatArray:
        """Return the scaled numbers of a model."""
        z = np.zeros(len(self.names))
        z[:3] = np.asarray(model.beta) / _BETA_SCALE
        return z

    def values(self, z: FloatArray) -> dict[str, float]:
        """Return the parameters in their own units."""
        out = {name: float(z[i] * _BETA_SCALE[i]) for i, name in enumerate(self.names[:3])}
        for i, name in enumerate(self.names[3:], start=3):
            if name == "start":
                out[name] = self.start_s + _START_SCALE_S * float(z[i])
            else:
                # Beyond e^±20 a trial step would overflow.
                size = float(np.exp(np.clip(z[i], -20.0, 20.0)))
                out[name] = self.tau_s * size if name == "tau" else size
        return out

    def slopes(self, z: FloatArray) -> FloatArray:
        """Return d(parameter)/dz, for the covariance."""
        values = self.values(z)
        return np.array(
            [
                _BETA_SCALE[i] if i < 3 else _START_SCALE_S if name == "start" else values[name]
                for i, name in enumerate(self.names)
            ]
        )

    def apply(self, model: TotalSystemModel, z: FloatArray) -> TotalSystemModel:
        """Return the model with the parameters put in."""
        values = self.values(z)
        f = model.facility
        facility = replace(
            f,
            reverse_loss=f.reverse_loss * values.get("reverse_loss", 1.0),
            throttle_area_factor=f.throttle_area_factor * values.get("throttle", 1.0),
            discharge_volume_m3=f.discharge_volume_m3 * values.get("volume", 1.0),
        )
        return replace(
            model,
            facility=facility,
            beta=(values["beta_1"], values["beta_2"], values["beta_3"]),
            tau_s=values["tau"],
            start_s=values.get("start", model.start_s),
        )


@dataclass(frozen=True)
class Shooting:
    """The runs that one evaluation of the cost makes.

    Parameters
    ----------
    parameters : Parameters
        Common parameters.
    scored_outputs : tuple of ndarray of shape (n_i, 3)
        Measured P31, P25 and W25 of each run.
    noise : ndarray of shape (3,)
        What the measured outputs hold beside their average over the smoothing width.
    smooth : callable
        That average.
    first_nodes : ndarray of shape (n_runs, k)
        Start of the nuisance states, as scaled departures from the measured ones.
    simulate : callable
        ``simulate(z, nodes)`` returns the outputs of each run, of the shapes of the measured.
    start_s : callable
        Surge start for ``z``.
    duration_s : float
        Length of all runs together.
    """

    parameters: Parameters
    scored_outputs: tuple[FloatArray, ...]
    noise: FloatArray
    smooth: Callable[[FloatArray], FloatArray] = field(repr=False)
    first_nodes: FloatArray
    simulate: Callable[[FloatArray, FloatArray], list[FloatArray]] = field(repr=False)
    start_s: Callable[[FloatArray], float] = field(repr=False)
    duration_s: float

    def residuals(
        self, z: FloatArray, nodes: FloatArray, sigma: FloatArray
    ) -> list[FloatArray] | None:
        """Return the weighted residuals of each run and its nodes; None where one is not finite."""
        runs = self.simulate(z, nodes)
        if not all(np.all(np.isfinite(run)) for run in runs):
            return None
        kept = nodes / np.array(_NODE_ERRORS[: nodes.shape[1]])
        return [
            np.concatenate([((run - rows) / sigma).ravel(), node])
            for run, rows, node in zip(runs, self.scored_outputs, kept, strict=True)
        ]

    def rms(self, z: FloatArray, nodes: FloatArray) -> FloatArray:
        """Return the residual of each channel, of shape (3,)."""
        return np.asarray(np.sqrt(np.mean(self._difference(z, nodes) ** 2, axis=0)))

    def slow_rms(self, z: FloatArray, nodes: FloatArray) -> FloatArray:
        """Return the residual without what averages out over a period of the stall cells."""
        slow = [self.smooth(column) for column in self._difference(z, nodes).T]
        return np.asarray(np.sqrt(np.mean(np.square(slow), axis=1)))

    def _difference(self, z: FloatArray, nodes: FloatArray) -> FloatArray:
        return np.concatenate(self.simulate(z, nodes)) - np.concatenate(self.scored_outputs)


def _noise(measured: Measured, rows: slice) -> FloatArray:
    fast = [column - measured.smooth(column) for column in measured.outputs.T]
    return np.asarray([np.std(column[rows]) for column in fast])


def delay_to_reversal_s(measured: Measured, model: TotalSystemModel, states: FloatArray) -> float:
    """Return how long after its surge start the model's flow reverses, in seconds."""
    before = state_before_surge(measured, states)
    start = measured.reversal_s
    run = replace(model, start_s=start).simulate(
        measured.drive,
        n_rows=round(_LONGEST_DELAY_S / _DELAY_STEP_S),
        period_s=_DELAY_STEP_S,
        state=before,
    )["W25"]
    back = np.flatnonzero(~(run > 0.0))
    if back.size == 0 or back[0] == 0 or not np.isfinite(run[back[0]]):
        # A trial characteristic without reversal: what the collapse lasts at this stiffness.
        return _BEFORE_REVERSAL_S
    i = int(back[0])
    return _DELAY_STEP_S * (i - 1 + float(run[i - 1] / (run[i - 1] - run[i])))


def single_shooting(
    measured: Measured,
    model: TotalSystemModel,
    settings: TotalSystemSettings,
    parameters: Parameters,
    states: FloatArray,
) -> Shooting:
    """Return one run from the surge start, which is fitted, or aligned at the first reversal.

    Parameters
    ----------
    measured, model, settings, parameters
        Record, facility, switches, what is fitted.
    states : ndarray of shape (n, 11)
        Observed states.
    """
    rows = measured.rows(
        measured.reversal_s - _BEFORE_REVERSAL_S, measured.reversal_s + settings.horizon_s
    )
    if measured.time_s[-1] < measured.reversal_s + settings.horizon_s - measured.period_s:
        raise InputError(
            "TotalSystemSettings.horizon_s",
            expected=f"at most {measured.time_s[-1] - measured.reversal_s:.3g} s, what the record "
            "holds after the first reversal",
            found=f"{settings.horizon_s:g}",
        )
    before = state_before_surge(measured, states)
    times, outputs, drive = measured.time_s[rows], measured.outputs[rows], measured.drive

    def start_s(z: FloatArray) -> float:
        trial = parameters.apply(model, z)
        if settings.start == "fitted":
            return trial.start_s
        delay = delay_to_reversal_s(measured, trial, states)
        return measured.reversal_s - delay + settings.start_error_s

    def simulate(z: FloatArray, nodes: FloatArray) -> list[FloatArray]:
        trial = replace(parameters.apply(model, z), start_s=start_s(z))
        waiting = int(np.searchsorted(times, trial.start_s))
        out = np.empty_like(outputs)
        # Before the surge the model rests in the state that it starts from.
        out[:waiting] = outputs[0]
        out[:waiting, [0, 2]] = before[3], before[0]
        out[:waiting, 1] = np.mean(measured.P25[rows][:5])
        if waiting < times.size:
            run = trial.simulate(
                drive,
                n_rows=times.size - waiting,
                period_s=measured.period_s,
                first_s=float(times[waiting]),
                state=before,
            )
            out[waiting:] = np.column_stack([run["P31"], run["P25"], run["W25"]])
        return [out]

    return Shooting(
        parameters,
        (outputs,),
        _noise(measured, rows),
        measured.smooth,
        np.zeros((1, 0)),
        simulate,
        start_s,
        float(times[-1] - times[0]),
    )


def multiple_shooting(
    measured: Measured,
    model: TotalSystemModel,
    settings: TotalSystemSettings,
    parameters: Parameters,
) -> Shooting:
    """Return one run in each segment of the window, restarted from measured or fitted states.

    Parameters
    ----------
    measured, model, settings, parameters
        Record, facility, switches, what is fitted.
    """
    from comparisons.total_system import kernel

    states, latches = observed_states(measured, model)
    edges = _nodes(measured, settings, latches)
    scale = np.array([1.0, 0.1, 0.01 * np.mean(states[:, 3]), 0.01 * np.mean(states[:, 5])])
    k = len(_NODE_STATES) if settings.nodes == "fitted" else 0
    inlet, outputs = measured.drive.inlet(), measured.outputs
    substeps = max(1, round(measured.period_s * STEPS_PER_SECOND))
    chosen = list(_NODE_STATES[:k])
    free, forced = np.empty((0, 4)), settings.switches == "measured"

    def simulate(z: FloatArray, nodes: FloatArray) -> list[FloatArray]:
        c = parameters.apply(model, z).constants()
        runs = []
        for (first, last), node in zip(edges, nodes, strict=True):
            begin = states[first].copy()
            begin[chosen[: node.size]] += scale[: node.size] * node
            time = float(measured.time_s[first])
            run = kernel.integrate(
                c, inlet, begin, latches[first], time, time, last - first, measured.period_s,
                substeps, latches[first:last] if forced else free,
            )  # fmt: skip
            runs.append(run[:, _FITTED])
        return runs

    return Shooting(
        parameters,
        tuple(outputs[first:last] for first, last in edges),
        _noise(measured, slice(edges[0][0], edges[-1][1])),
        measured.smooth,
        np.zeros((len(edges), k)),
        simulate,
        lambda z: model.start_s,
        measured.period_s * sum(last - first for first, last in edges),
    )


def _nodes(
    measured: Measured, settings: TotalSystemSettings, latches: FloatArray
) -> list[tuple[int, int]]:
    """Return first and one past the last row of each segment, begun where no branch changes."""
    window = settings.window_s or measured.window_s
    rows = measured.rows(*window)
    quiet = max(1, round(_QUIET_S / measured.period_s))
    changes = np.concatenate([[0.0], np.abs(np.diff(latches[:, 0]))])
    near = np.convolve(changes, np.ones(2 * quiet + 1), mode="same") > 0.5
    # Nor where the flow reverses: there states read off the record are least sure.
    good = np.flatnonzero(~near & (latches[:, 0] > 0.5) & (measured.smooth(measured.W25) > 0.0))
    good = good[(good >= rows.start) & (good < rows.stop)]
    length = round(settings.segment_s / measured.period_s)
    nodes: list[int] = []
    for target in range(rows.start, rows.stop, length):
        if good.size == 0:
            break
        row = int(good[np.argmin(np.abs(good - target))])
        if not nodes or row - nodes[-1] >= max(length // 2, _SHORTEST_SEGMENT_ROWS):
            nodes.append(row)
    if len(nodes) < 2:
        raise InputError(
            f"{measured.source}: window {window[0]:.3f} to {window[1]:.3f} s",
            expected="in-stall rows with forward flow at which at least two segments can begin",
            found=f"{len(nodes)}",
            remedy="name a longer window or a shorter segment_s",
        )
    ends = [*nodes[1:], min(rows.stop, nodes[-1] + length)]
    return [
        (first, last)
        for first, last in zip(nodes, ends, strict=True)
        if last - first >= _SHORTEST_SEGMENT_ROWS
    ]
