"""Runs of the model against the record: one from the surge start, or one in each segment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from comparisons.total_system import kernel
from comparisons.total_system.measured import (
    Measured,
    observed_states,
    state_before_surge,
)
from comparisons.total_system.model import COLUMNS, STEPS_PER_SECOND, TotalSystemModel
from comparisons.total_system.settings import MULTIPLE, OUTPUTS, TotalSystemSettings
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["N_PARAMETERS", "Runs", "SegmentRuns", "SingleRun", "runs_of_settings", "surge_start_s"]


_FITTED = [COLUMNS.index(name) for name in OUTPUTS]
# β of order (1, 3, 50); the logarithm of τ is its own scale.
_SCALES = np.array([1.0, 1.0, 10.0, 1.0])
N_PARAMETERS = _SCALES.size
# States that are fitted at a node, with the size of a unit step: kg/s, ψ', P31 and P_in over mean.
_NODE_STATES = [0, 1, 3, 5]
_NODE_SCALES = np.array([1.0, 0.1, 0.01, 0.01])
# Around a node the branch must not change: its own switching time would be one more unknown.
_QUIET_S = 0.012
# A run is scored from a little before the collapse, which an early start would otherwise miss.
_BEFORE_REVERSAL_S = 0.03
_DELAY_STEP_S = 0.5e-3
_LONGEST_DELAY_S = 0.08
_SHORTEST_SEGMENT_ROWS = 10


@dataclass(frozen=True)
class Runs:
    """The runs that one evaluation of the cost makes, as functions of scaled departures z.

    Parameters
    ----------
    measured : Measured
        The record.
    model : TotalSystemModel
        The model at z = 0.
    states : ndarray of shape (n, 11)
        Observed states.
    segments : tuple of (int, int)
        First and one past the last row of each run.
    """

    measured: Measured
    model: TotalSystemModel
    states: FloatArray
    segments: tuple[tuple[int, int], ...]

    # Nuisance states at the begin of each run.
    n_node_states = 0

    @property
    def n_runs(self) -> int:
        """How many runs there are."""
        return len(self.segments)

    @property
    def measured_outputs(self) -> list[FloatArray]:
        """Measured P31, P25 and W25 of each run, each of shape (n_i, 3)."""
        return [self.measured.outputs[first:last] for first, last in self.segments]

    @property
    def noise(self) -> FloatArray:
        """What the measured outputs hold beside their average over the smoothing width."""
        rows = slice(self.segments[0][0], self.segments[-1][1])
        fast = [column - self.measured.smooth(column) for column in self.measured.outputs.T]
        return np.asarray([np.std(column[rows]) for column in fast])

    @property
    def duration_s(self) -> float:
        """Length of all runs together, in seconds."""
        return self.measured.period_s * sum(last - first for first, last in self.segments)

    def model_at(self, z: FloatArray) -> TotalSystemModel:
        """Return the model with scaled departures put in."""
        step = z * _SCALES
        beta = np.asarray(self.model.beta) + step[:3]
        return replace(
            self.model,
            beta=(float(beta[0]), float(beta[1]), float(beta[2])),
            # Beyond e^±20 a trial step would overflow.
            tau_s=self.model.tau_s * float(np.exp(np.clip(step[3], -20.0, 20.0))),
        )

    def slopes(self, z: FloatArray) -> FloatArray:
        """Return d(parameter)/dz, for the covariance."""
        slopes = _SCALES.copy()
        slopes[3] = self.model_at(z).tau_s
        return slopes

    def start_s(self, z: FloatArray) -> float:
        """Return the surge start for z, in seconds."""
        return self.model_at(z).start_s

    def simulate(self, z: FloatArray, nodes: FloatArray) -> list[FloatArray]:
        """Return the outputs of each run, of the shapes of the measured."""
        raise NotImplementedError

    def residuals(
        self, z: FloatArray, nodes: FloatArray, sigma: FloatArray, node_errors: FloatArray
    ) -> list[FloatArray]:
        """Return the weighted residuals of each run, and of its nodes over their errors."""
        runs = zip(self.simulate(z, nodes), self.measured_outputs, nodes, strict=True)
        return [
            np.concatenate([((run - rows) / sigma).ravel(), node / node_errors])
            for run, rows, node in runs
        ]

    def rms(self, z: FloatArray, nodes: FloatArray) -> FloatArray:
        """Return the residual of each channel, of shape (3,)."""
        return np.asarray(np.sqrt(np.mean(self._difference(z, nodes) ** 2, axis=0)))

    def slow_rms(self, z: FloatArray, nodes: FloatArray) -> FloatArray:
        """Return the residual without what averages out over a period of the stall cells."""
        slow = [self.measured.smooth(column) for column in self._difference(z, nodes).T]
        return np.asarray(np.sqrt(np.mean(np.square(slow), axis=1)))

    def _difference(self, z: FloatArray, nodes: FloatArray) -> FloatArray:
        return np.concatenate(self.simulate(z, nodes)) - np.concatenate(self.measured_outputs)


@dataclass(frozen=True)
class SingleRun(Runs):
    """One run from the surge start that aligns the first reversal with the measured one.

    Parameters
    ----------
    start_error_s : float
        Added to an aligned start.
    """

    start_error_s: float = 0.0

    def start_s(self, z: FloatArray) -> float:
        """Return the surge start for z, in seconds."""
        return surge_start_s(self.measured, self.model_at(z), self.states) + self.start_error_s

    def simulate(self, z: FloatArray, nodes: FloatArray) -> list[FloatArray]:
        """Return the outputs of the run; before the surge the model rests where it starts from."""
        (first, last), measured = self.segments[0], self.measured
        times, before = measured.time_s[first:last], state_before_surge(measured, self.states)
        trial = replace(self.model_at(z), start_s=self.start_s(z))
        waiting = int(np.searchsorted(times, trial.start_s))
        out = np.empty((times.size, 3))
        out[:waiting] = before[3], np.mean(measured.P25[first : first + 5]), before[0]
        if waiting < times.size:
            run = trial.simulate(
                n_rows=times.size - waiting,
                period_s=measured.period_s,
                first_s=float(times[waiting]),
                state=before,
            )
            out[waiting:] = np.column_stack([run[name] for name in OUTPUTS])
        return [out]


@dataclass(frozen=True)
class SegmentRuns(Runs):
    """One run in each segment, restarted from measured states that are corrected by the fit.

    The machine goes into stall and out of it when the measured φ says so: with the model's own φ
    the cost jumps where a trial run recovers late or not at all, and the search sticks.

    Parameters
    ----------
    latches : ndarray of shape (n, 4)
        Measured stall latch.
    """

    latches: FloatArray

    n_node_states = len(_NODE_STATES)

    def simulate(self, z: FloatArray, nodes: FloatArray) -> list[FloatArray]:
        """Return the outputs of each run."""
        c, measured = self.model_at(z).constants(), self.measured
        substeps = max(1, round(measured.period_s * STEPS_PER_SECOND))
        scale = _NODE_SCALES * [1.0, 1.0, *np.mean(self.states[:, [3, 5]], axis=0)]
        runs = []
        for (first, last), node in zip(self.segments, nodes, strict=True):
            begin = self.states[first].copy()
            begin[_NODE_STATES[: node.size]] += scale[: node.size] * node
            time = float(measured.time_s[first])
            run = kernel.integrate(
                c, begin, self.latches[first], time, time, last - first, measured.period_s,
                substeps, self.latches[first:last],
            )  # fmt: skip
            runs.append(run[:, _FITTED])
        return runs


def runs_of_settings(
    measured: Measured, model: TotalSystemModel, settings: TotalSystemSettings, states: FloatArray
) -> Runs:
    """Return the runs that the settings ask for.

    Parameters
    ----------
    measured : Measured
        The record.
    model : TotalSystemModel
        The start of the search.
    settings : TotalSystemSettings
        The switches.
    states : ndarray of shape (n, 11)
        Observed states, before the characteristic was known.
    """
    if settings.start == MULTIPLE:
        states, latches = observed_states(measured, model)
        segments = _segments(measured, settings, latches)
        return SegmentRuns(measured, model, states, segments, latches)
    until_s = measured.reversal_s + settings.horizon_s
    if measured.time_s[-1] < until_s - measured.period_s:
        raise InputError(
            "TotalSystemSettings.horizon_s",
            expected=f"at most {measured.time_s[-1] - measured.reversal_s:.3g} s, what the record "
            "holds after the first reversal",
            found=f"{settings.horizon_s:g}",
        )
    rows = measured.rows(measured.reversal_s - _BEFORE_REVERSAL_S, until_s)
    segment = ((rows.start, rows.stop),)
    return SingleRun(measured, model, states, segment, settings.start_error_s)


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
    run = replace(model, start_s=measured.reversal_s).simulate(
        n_rows=round(_LONGEST_DELAY_S / _DELAY_STEP_S),
        period_s=_DELAY_STEP_S,
        state=state_before_surge(measured, states),
    )["W25"]
    back = np.flatnonzero(~(run > 0.0))
    if back.size == 0 or back[0] == 0 or not np.isfinite(run[back[0]]):
        # A trial characteristic without reversal: what the collapse lasts at this stiffness.
        return measured.reversal_s - _BEFORE_REVERSAL_S
    i = int(back[0])
    delay = _DELAY_STEP_S * (i - 1 + float(run[i - 1] / (run[i - 1] - run[i])))
    return measured.reversal_s - delay


def _segments(
    measured: Measured, settings: TotalSystemSettings, latches: FloatArray
) -> tuple[tuple[int, int], ...]:
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
    return tuple(
        (first, last)
        for first, last in zip(nodes, ends, strict=True)
        if last - first >= _SHORTEST_SEGMENT_ROWS
    )
