"""Surge loops discovered: one branch of the characteristic or two with hysteresis, duct, plenum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.discover.loop_balance import Balance, fit_balance
from sindy_surge.discover.loop_lag import Branch, LagFit, LagRows, fit_lag
from sindy_surge.discover.loop_signals import Cycles, hidden_plenum, measure_cycles
from sindy_surge.discover.trajectories import output_times
from sindy_surge.noise import difference_noise, smoothed
from sindy_surge.segments import Segments
from surge_core.errors import InputError, positive
from surge_core.fit_state import FitState
from surge_core.terms import signed_sum
from surge_core.types import FloatArray

_FEWEST_CYCLES = 4
_FEWEST_SAMPLES = 30
_TOLERANCE = 1e-8
_CYCLES = 10
# Simulated and measured cycles agree within this.
_AGREEMENT = 0.05
# Errors of its own period by which a model may miss the measured one; of right structures 1.5.
_SURE = 5.0
# Of the right structure the rest of ψ' is its white noise, and what the noise of φ adds.
_EXCESS = 2.0
_Rate = Callable[[float, FloatArray], FloatArray]


@dataclass(frozen=True)
class SurgeLoop:
    """A surge loop d(φ, ψ', Ψ)/dt with one branch of its characteristic or two, and its own start.

    Parameters
    ----------
    lag : LagFit
        τ, the branches, and the levels φ_rec (up through it: unstalled) and φ_s (down through it:
        stalled).
    duct, plenum : Balance
        dφ/dt and dΨ/dt.
    start : ndarray of shape (3,)
        State at the lowest φ of a cycle, from where `simulate` runs.
    sample_period_s : float
        Sample period of the record in seconds.
    measured_cycles, simulated_cycles : Cycles
        What the cycles of the record and of the model measure.
    noise : float
        White noise of ψ'.
    plenum_hidden : bool
        Whether Ψ was not measured but taken from the duct.
    state : FitState
        How the discovery ended, with advice.
    """

    lag: LagFit
    duct: Balance
    plenum: Balance
    start: FloatArray
    sample_period_s: float
    measured_cycles: Cycles
    simulated_cycles: Cycles
    noise: float
    plenum_hidden: bool
    state: FitState

    @property
    def n_branches(self) -> int:
        """Number of branches of the characteristic."""
        return len(self.lag.branches)

    @property
    def time_constant_s(self) -> float:
        """τ of the lag in seconds."""
        return self.lag.time_constant_s

    @property
    def period_s(self) -> float:
        """Period of the simulated cycles in seconds; nan if the model does not cycle."""
        return self.simulated_cycles.period_s

    def equations(self) -> tuple[str, ...]:
        """Return dφ/dt, dψ'/dt of each branch and dΨ/dt as text, rounded to their errors."""
        lines = [
            f"τ dψ'/dt + ψ' = {_sum(b)}" + ("" if b.name == "single" else f"   [{b.name}]")
            for b in self.lag.branches
        ]
        return (
            f"dφ/dt = {_sum(self.duct)}   [1/s]",
            *lines,
            f"dΨ/dt = {_sum(self.plenum)}   [1/s]",
        )

    def simulate(
        self, x0: ArrayLike | None = None, t: ArrayLike | None = None, throttle: float = 1.0
    ) -> FloatArray:
        """Let the model run by itself.

        Parameters
        ----------
        x0 : array-like of shape (3,), optional
            φ, ψ' and Ψ at first; the model's own start by default.
        t : array-like of shape (n_times,), optional
            Times in seconds; ten periods of the record by default.
        throttle : float
            Opening of the throttle over that of the record: factor of √Ψ in dΨ/dt.

        Returns
        -------
        ndarray of shape (n_times, 3)
            φ, ψ' and Ψ; nan from where the model has run away.
        """
        from scipy.integrate import solve_ivp

        times = np.arange(0.0, _CYCLES * self.measured_cycles.period_s, self.sample_period_s)
        times = times if t is None else output_times(t)
        state = np.asarray(self.start if x0 is None else x0, dtype=np.float64)
        found, begin = np.full((times.size, 3), np.nan), times[0]
        recover, stall = self.lag.levels or (-np.inf, -np.inf)
        stalled = bool(state[0] < 0.5 * (recover + stall))
        while True:
            asked = times >= begin
            # A model may run away.
            with np.errstate(all="ignore"):
                run = solve_ivp(
                    self._rate(self.lag.branches[0 if stalled else -1], throttle),
                    (begin, times[-1]),
                    state,
                    t_eval=times[asked],
                    events=[_lost, _beyond(recover, 1.0) if stalled else _beyond(stall, -1.0)],
                    rtol=_TOLERANCE,
                    atol=_TOLERANCE,
                )
            assert run.t_events is not None
            assert run.y_events is not None
            found[np.flatnonzero(asked)[: run.t.size]] = np.reshape(run.y, (3, -1)).T
            if run.status != 1 or run.t_events[0].size:
                return found
            begin, state, stalled = run.t_events[1][0], run.y_events[1][0], not stalled

    def operating_point(self, throttle: float = 1.0) -> tuple[FloatArray, float]:
        """Return the steady state on the unstalled branch and the growth rate about it.

        Parameters
        ----------
        throttle : float
            Opening of the throttle over that of the record.

        Returns
        -------
        state : ndarray of shape (3,)
            φ, ψ' and Ψ; nan where there is none.
        growth : float
            Largest real part of the eigenvalues, per second; negative where it is stable.
        """
        from scipy.optimize import root

        branch = self.lag.branches[-1]
        rate = partial(self._rate(branch, throttle), 0.0)
        for phi in np.linspace(self.measured_cycles.highest[0], 0.0, 12):
            psi_p = float(branch(np.array([phi]))[0])
            found = root(rate, np.array([phi, psi_p, psi_p]))
            if found.success and abs(found.x[0]) < 3 * self.measured_cycles.highest[0]:
                step = 1e-6
                jacobian = np.column_stack(
                    [(rate(found.x + step * e) - rate(found.x - step * e)) for e in np.eye(3)]
                )
                growth = float(np.linalg.eigvals(jacobian / (2 * step)).real.max())
                return np.asarray(found.x), growth
        return np.full(3, np.nan), np.nan

    def surge_line(self) -> tuple[float, FloatArray]:
        """Return the throttle opening at which a steady unstalled flow is lost, and its state.

        It is lost where a closing throttle makes it unstable, or brings φ down to φ_s.

        Returns
        -------
        throttle : float
            Opening over that of the record; nan if none up to four times it is stable.
        state : ndarray of shape (3,)
            φ, ψ' and Ψ there.
        """
        stall = self.lag.levels[1] if self.lag.levels else -np.inf

        def steady(throttle: float) -> bool:
            state, growth = self.operating_point(throttle)
            return bool(growth < 0 and state[0] > stall)

        openings = np.geomspace(4.0, 0.25, 60)
        lost = [i for i in range(1, 60) if steady(openings[i - 1]) and not steady(openings[i])]
        if not lost:
            return np.nan, np.full(3, np.nan)
        open_, shut = openings[lost[0] - 1], openings[lost[0]]
        for _ in range(20):
            middle = float(np.sqrt(open_ * shut))
            open_, shut = (middle, shut) if steady(middle) else (open_, middle)
        return float(open_), self.operating_point(float(open_))[0]

    def _rate(self, branch: Branch, throttle: float) -> _Rate:
        """Return d(φ, ψ', Ψ)/dt of a state on one branch."""
        opening = np.where(self.plenum.exponents[:, 3] > 0, throttle, 1.0)
        plenum = replace(self.plenum, coefficients=opening * self.plenum.coefficients)

        def rate(_: float, x: FloatArray) -> FloatArray:
            lagging = (float(branch(x[:1])[0]) - x[1]) / self.lag.time_constant_s
            return np.array([self.duct.rate(x[None])[0], lagging, plenum.rate(x[None])[0]])

        return rate


def discover_loop(
    phi: ArrayLike | Sequence[ArrayLike],
    psi_p: ArrayLike | Sequence[ArrayLike],
    plenum: ArrayLike | Sequence[ArrayLike] | None,
    sample_period_s: float,
) -> SurgeLoop:
    """Discover the surge loop behind measured cycles: branches, levels, lag, duct and plenum.

    Two branches stand where the free run of the lag leaves less than 0.7 of what the richest
    single branch leaves (degree 7, with other cubics beyond a kink), the white noise apart, and
    the Bayesian information criterion agrees.

    Parameters
    ----------
    phi, psi_p : array-like of shape (n_rows,), or a list of such records
        Flow coefficient in the duct, and pressure coefficient ψ' of the compressor.
    plenum : array-like of shape (n_rows,), a list, or None
        Plenum pressure above that behind the throttle, best as a coefficient in the unit of ψ'.
        None: hidden, Ψ = ψ' - (dφ/dt)/a for a duct without losses.
    sample_period_s : float
        Sample period in seconds.

    Returns
    -------
    SurgeLoop
        The loop; its `state` says whether to trust it.

    Raises
    ------
    InputError
        If a channel cannot be used, or the records have fewer than four surge cycles.
    """
    positive("sample_period_s", sample_period_s)
    step = float(sample_period_s)
    records = [_records(x) for x in (phi, psi_p, plenum) if x is not None]
    _check(records)
    labels = np.repeat(np.arange(len(records[0])), [x.size for x in records[0]])
    runs = Segments.from_labels(labels, labels.size)
    measured = [np.concatenate(channel) for channel in records]
    smooth, noise = [], []
    for channel in records:
        levels = [difference_noise(x, Segments.from_labels(None, x.size)) for x in channel]
        smooth.append(
            np.concatenate([smoothed(*each) for each in zip(channel, levels, strict=True)])
        )
        noise.append(float(np.mean(levels)))
    cycles = measure_cycles(np.column_stack(smooth), step)
    if cycles.n_cycles < _FEWEST_CYCLES or cycles.period_s < _FEWEST_SAMPLES * step:
        raise InputError(
            "phi",
            expected=f"at least {_FEWEST_CYCLES} whole surge cycles of at least {_FEWEST_SAMPLES} "
            "samples",
            found=f"{cycles.n_cycles} in {smooth[0].size} samples"
            + (f", of {cycles.period_s:.3g} s" if cycles.n_cycles else ""),
            remedy="use a longer record, or sample faster",
        )
    period_samples = round(cycles.period_s / step)
    rows = LagRows(smooth[0], measured[1], runs, step, period_samples, noise[0]).refined()
    lag = fit_lag(rows, noise[1])
    if plenum is None:
        hidden, duct = hidden_plenum(measured, smooth, step, period_samples)
        smooth.append(hidden)
        measured.append(hidden)
        cycles = measure_cycles(np.column_stack(smooth), step)
    states = np.column_stack(smooth)
    if plenum is not None:
        duct = fit_balance(measured[0], states, runs, period_samples, step)
    balance = fit_balance(measured[2], states, runs, period_samples, step)
    whole = states[: period_samples + 1]
    start = whole[int(np.argmin(whole[:, 0]))]
    none = Cycles(np.nan, (), (), 0)
    loop = SurgeLoop(
        lag=lag,
        duct=duct,
        plenum=balance,
        start=start,
        sample_period_s=step,
        measured_cycles=cycles,
        simulated_cycles=none,
        noise=noise[1],
        plenum_hidden=plenum is None,
        state=FitState.OK,
    )
    return _judged(loop)


def _records(channel: ArrayLike | Sequence[ArrayLike]) -> list[FloatArray]:
    if isinstance(channel, list | tuple) and np.ndim(channel[0]) == 1:
        return [np.asarray(x, dtype=np.float64) for x in channel]
    return [np.asarray(channel, dtype=np.float64)]


def _check(channels: list[list[FloatArray]]) -> None:
    sizes = [[x.shape for x in channel] for channel in channels]
    alike = all(s == sizes[0] for s in sizes) and all(len(s) == 1 for s in sizes[0])
    if not alike or not all(x.size and 0 < np.ptp(x) < np.inf for c in channels for x in c):
        raise InputError(
            "phi, psi_p, plenum",
            expected="one finite value of each for every sample, that changes with the cycles",
            found="; ".join(f"{s}" for s in sizes),
            remedy="cut the channels to the same rows; a gap cannot be simulated across",
        )


def _sum(part: Branch | Balance) -> str:
    values = zip(part.terms, part.coefficients.tolist(), part.stderr.tolist(), strict=True)
    return signed_sum(list(values))


def _judged(loop: SurgeLoop) -> SurgeLoop:
    """Let the model run by itself, and say what came of it."""
    period_s, step = loop.measured_cycles.period_s, loop.sample_period_s
    # The first two cycles run from the start onto the limit cycle.
    skipped = round(2 * period_s / step)
    states = loop.simulate(t=np.arange(0.0, (_CYCLES + 3.5) * period_s, step))[skipped:]
    found = measure_cycles(states, step)
    loop = replace(loop, simulated_cycles=found)
    measured = loop.measured_cycles
    state, off_s = FitState.OK, abs(found.period_s - measured.period_s)
    if found.n_cycles < _CYCLES // 2:
        state = FitState.DOES_NOT_CYCLE
    elif loop.duct.beyond or loop.plenum.beyond:
        state = FitState.LIBRARY_TOO_SMALL
    elif _difference(measured, found) > _AGREEMENT:
        state = FitState.CYCLES_DIFFER
    elif loop.lag.rest > _EXCESS * loop.noise:
        state = FitState.MODEL_ERROR_DOMINATES
    elif off_s > _SURE * _period_error(replace(loop, start=states[int(np.argmin(states[:, 0]))])):
        state = FitState.PERIOD_OFF
    return replace(loop, state=state)


def _period_error(loop: SurgeLoop) -> float:
    """Return the standard error of the simulated period, from those of all that it runs by.

    On the limit cycle, where ``loop`` starts, a period is enough to settle again.
    """
    period_s, step = loop.period_s, loop.sample_period_s
    times, skipped = np.arange(0.0, 3.2 * period_s, step), round(period_s / step)
    moved = [replace(loop, duct=each) for each in loop.duct.one_error_off()]
    moved += [replace(loop, plenum=each) for each in loop.plenum.one_error_off()]
    moved += [replace(loop, lag=each) for each in loop.lag.one_error_off()]
    found = [measure_cycles(each.simulate(t=times)[skipped:], step).period_s for each in moved]
    # Where a standard error stops the cycles, the period says nothing.
    return float(np.nan_to_num(np.linalg.norm(np.subtract(found, period_s)), nan=np.inf))


def _difference(measured: Cycles, simulated: Cycles) -> float:
    """Return the largest difference: of the period, and of extremes as a share of the range."""
    low, high = np.array(measured.lowest), np.array(measured.highest)
    off = np.abs(np.array([simulated.lowest - low, simulated.highest - high])) / (high - low)
    return float(max(off.max(), abs(simulated.period_s / measured.period_s - 1)))


def _lost(_: float, x: FloatArray) -> float:
    return float(1e3 - np.max(np.abs(x)))


_lost.terminal = True  # type: ignore[attr-defined]


def _beyond(level: float, direction: float) -> Callable[[float, FloatArray], float]:
    """Return the event of φ crossing a level upwards (1) or downwards (-1)."""

    def beyond(_: float, x: FloatArray) -> float:
        return float(x[0] - level)

    beyond.terminal, beyond.direction = True, direction  # type: ignore[attr-defined]
    return beyond
