"""The quasi-steady work characteristic ψ_QS(φ) and its time constant from the two planes (Eq 14).

The fit works on the power W25 ψ, which is finite through zero flow, and simulates the lag through
the whole window: the rows near zero flow, in reversed flow and near the switches of the stall
state are simulated but not scored. The average over one stall-cell period comes last, alike on the
power and on W25 times the simulated response.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from classic_ml.characteristics import PiecewiseLinear
from classic_ml.coefficients import flow_coefficient
from classic_ml.description import TestDescription
from classic_ml.filters import period_average
from classic_ml.flow import choked_flow, corrected_from_physical
from classic_ml.intervals import bridged
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.segments import cell_frequency_hz, hub_tip_stall, near
from classic_ml.work.balance import (
    MIXING_PHI,
    delivered_power,
    exit_flow_at_inlet,
    flat_average,
    impossible_rows,
)
from surge_core.errors import InputError, positive
from surge_core.fit_state import FitState
from surge_core.lag import FirstOrderLag
from surge_core.leave_out import leave_out, scatter
from surge_core.types import BoolArray, FloatArray, IntArray

# Rows below are simulated, not scored; what is left near zero flow has next to no power.
SCORED_PHI = 0.01
# Range of τ that is searched, in seconds, and the points of the first scan.
SEARCHED_TAU_S = (0.003, 0.1)
SCAN_POINTS = 16
# A τ within a hundredth of an end of its range ran into it.
AT_BOUND = 0.01
# A standard error of log τ beyond which the record holds no τ.
UNDETERMINED = 0.5
# Fewer cycles say nothing of the scatter between them.
FEWEST_CYCLES = 4
# Single readings beyond what the area passes are left out; more than these are no accident.
MOST_IMPOSSIBLE = 0.05


@dataclass(frozen=True)
class WorkCharacteristic:
    """A fitted work characteristic.

    Parameters
    ----------
    time_constant_s, time_constant_stderr_s : float
        τ and its standard error; the error is 0 where τ was given. Not stated (nan), like the
        curve, where the fit ended at a bound of its search or there are too few cycles.
    terms : tuple of str
        Names of the terms of Fig 22.
    coef : ndarray of shape (n_terms,)
        β: ψ_QS at zero flow, and the slope of each straight piece.
    covariance : ndarray of shape (n_terms, n_terms)
        Covariance of ``coef``: scatter between cycles, half the difference of what the two
        planes' flows give alone, and an unknown delay of the pressures.
    breakpoints : tuple of float
        Where the pieces meet.
    valid_phi : tuple of float
        5th and 95th percentile of φ in the scored rows.
    n_scored, n_cycles : int
        Scored rows, and the cycles of the jackknife.
    residual_std : float
        Standard deviation of ψ's residual at the mean flow of the scored rows.
    fit_state : FitState
        How the fit ended, with advice.
    entry : LedgerEntry
        What was done, for a history.
    """

    time_constant_s: float
    time_constant_stderr_s: float
    terms: tuple[str, ...]
    coef: FloatArray
    covariance: FloatArray
    breakpoints: tuple[float, ...]
    valid_phi: tuple[float, float]
    n_scored: int
    n_cycles: int
    residual_std: float
    fit_state: FitState
    entry: LedgerEntry

    def characteristic(self, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ψ_QS and its standard error.

        Parameters
        ----------
        phi : ndarray of shape (n,)
            Flow coefficients.

        Returns
        -------
        value, stderr : ndarray of shape (n,)
        """
        terms = _terms(np.atleast_1d(np.asarray(phi, dtype=np.float64)), self.breakpoints)[0]
        variance = np.einsum("ij,jk,ik->i", terms, self.covariance, terms)
        return terms @ self.coef, np.sqrt(np.maximum(variance, 0.0))


@dataclass(frozen=True)
class _Setup:
    """What the fits of one record share."""

    record: Record
    test: TestDescription
    period_s: float
    breakpoints: tuple[float, ...]
    mixing_phi: float
    rows: slice
    stalled: FloatArray
    scored: BoolArray
    cycle: IntArray
    impossible: BoolArray
    stores: bool = True

    @cached_property
    def readings(self) -> tuple[FloatArray, FloatArray]:
        """What each plane says of W25, bridged where that is impossible."""
        other = exit_flow_at_inlet(self.record, self.test)
        return self.record["W25_kg_s"], bridged(other, ~self.impossible)

    @property
    def flow(self) -> FloatArray:
        """The mean of what the two planes say of W25."""
        return np.asarray(0.5 * sum(self.readings))

    def phi(self, flow: FloatArray) -> FloatArray:
        """Return φ of a flow, the ripple of the cells taken out of everything it is made of."""
        inlet_K, inlet_Pa = self.flat(self.record["T25_K"]), self.flat(self.record["P25_Pa"])
        corrected = corrected_from_physical(self.flat(flow), inlet_Pa, inlet_K)
        machine, area_m2 = self.test.compressor, self.test.areas_m2[25]
        # Outside of the cycles, where probes may be clipped, the average may be more than passes.
        limit = choked_flow(area_m2, machine)
        corrected = np.clip(corrected, -limit, limit)
        return flow_coefficient(corrected, inlet_K, area_m2, self.test.rotor_velocity_m_s, machine)

    def average(self, values: FloatArray) -> FloatArray:
        """Average over exactly one period, each column alike."""
        rate = self.record.sample_rate_hz
        if values.ndim == 1:
            return period_average(values, self.period_s, rate)
        return np.column_stack([period_average(c, self.period_s, rate) for c in values.T])

    def flat(self, values: FloatArray) -> FloatArray:
        """Take the ripple out of a signal and leave its shape."""
        return flat_average(values, self.period_s, self.record.sample_rate_hz)


@dataclass(frozen=True)
class _Fit:
    """One fit, linearised about its optimum: log τ first, then the linear parameters."""

    theta: FloatArray
    jacobian: FloatArray
    residual: FloatArray
    at_bound: FitState

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)


def fit_work_characteristic(
    record: Record,
    test: TestDescription,
    window: BoolArray,
    *,
    breakpoints: tuple[float, ...],
    time_constant_s: float | None = None,
    mixing_phi: float = MIXING_PHI,
) -> WorkCharacteristic:
    """Fit τ and the work characteristic of Fig 22 to a record with T31.

    Parameters
    ----------
    record : Record
        Plane averages with W31, without a low-pass filter, the lag of the thermocouples undone:
        what ``ReductionSettings(phase="none", thermocouple_inversion=True)`` leaves behind.
    test : TestDescription
        Machine and speed.
    window : ndarray of bool, shape (n_samples,)
        Rows of the surge cycles.
    breakpoints : tuple of float
        Flow coefficients at which the slope changes, fixed beforehand as in the paper.
    time_constant_s : float, optional
        τ, where it is known (from ψ'); else it is fitted.
    mixing_phi : float
        Flow near which T31 stops showing what left the blading, see
        ``classic_ml.work.balance.credit_of_storage``. The errors do not contain it.

    Returns
    -------
    WorkCharacteristic
        τ, curve, their errors and how the fit ended.

    Raises
    ------
    InputError
        When the flow is more than the area passes in many rows, or τ is not positive or longer than
        a surge cycle.

    Notes
    -----
    τ dx/dt + x = Σ β_i s_i(φ) with first-order hold (Eq 6 and 14); the sum of squares of
    A[W ψ] − A[W x] over the scored rows is smallest, A the average over one stall-cell period. Out
    of stall ψ_QS is a straight line, a nuisance that carries x across.

    The error of the flow stands in the s_i too and flattens the curve where it bends. Half the
    difference of the two planes' readings of the flow has the size of the error of their mean, so
    that either plane alone has twice that error: β = 2 β(mean) − [β(25) + β(31)]/2 is without the
    first order of the bias (simulation and extrapolation, Cook and Stefanski 1994, with a measured
    error). τ is that of the mean flow: corrected alike it comes out lower, 13 ms against 15 on
    24 records with a truth of 18.

    T31 shows what is stored between the planes where its probes stand behind the volume that
    stores, and not where they stand at the blading: of both energy balances the one with the
    smaller error on this record is taken. On a rig without storage between the planes the balance
    with it leaves an error of ψ of 0.12 at any τ, the other one 0.014 at 19 ms (truth 18); on the
    90 % record, with storage, 0.067 at 17 ms against 0.080 at 47.

    The pressures may come a sample later or earlier than the thermocouples, their lag undone
    (tubes, anti-alias filter). What one sample changes enters the errors: a millisecond is worth
    0.04 in the curve and 1.2 ms of τ; with τ given 0.06 at φ = 0.02 and 0.1, and 0.09 at 0.05.
    """
    if time_constant_s is not None:
        positive("time_constant_s", time_constant_s)
    setup = _setup(record, test, window, breakpoints, mixing_phi)
    cycles = np.unique(setup.cycle[setup.scored])
    n_terms = len(breakpoints) + 2
    if cycles.size < FEWEST_CYCLES or np.count_nonzero(setup.scored) < 10 * n_terms:
        return _answer(setup, int(cycles.size), math.nan, FitState.TOO_FEW_CYCLES)
    given = time_constant_s is not None
    cycle_s = (setup.rows.stop - setup.rows.start) * record.sample_period_s / cycles.size
    if time_constant_s is not None and time_constant_s > cycle_s:
        raise InputError(
            f"{record.source}: τ",
            expected=f"a time constant shorter than a surge cycle of {cycle_s:.2g} s",
            found=f"{time_constant_s:g} s",
        )
    plain = replace(setup, stores=False)
    setup = min(setup, plain, key=lambda one: _fit(one, one.flow, time_constant_s).cost)
    fits = _fits(setup, time_constant_s)
    std = float(np.sqrt(np.mean(fits[0].residual ** 2)) / np.mean(setup.flow[setup.scored]))
    if fits[0].at_bound is not FitState.CONVERGED:
        return _answer(setup, int(cycles.size), std, fits[0].at_bound)
    theta = _corrected(*(fit.theta for fit in fits))[: 1 + n_terms]
    before = np.maximum(np.arange(record.n_samples) - 1, 0)
    moved = [Channel(name, record[name][before], "K") for name in ("T25_K", "T31_K")]
    entry = LedgerEntry("align", "temperatures a sample later, as the pressures may be")
    late = replace(setup, record=record.after(entry, add=moved))
    misaligned = _corrected(*(fit.theta for fit in _fits(late, time_constant_s)))
    blocks = [np.flatnonzero(setup.cycle[setup.scored] == number) for number in cycles]
    moves = [leave_out(-fit.jacobian, fit.residual, blocks)[0].T for fit in fits]
    planes = 0.5 * (fits[1].theta - fits[2].theta)
    errors = planes[: theta.size], misaligned[: theta.size] - theta
    covariance = scatter(_corrected(*moves)[: theta.size].T)
    covariance += sum(np.outer(error, error) for error in errors)
    log_error = float(np.sqrt(covariance[0, 0]))
    if not given and theta[0] - 2.0 * log_error < np.log(SEARCHED_TAU_S[0]):
        wide = log_error > UNDETERMINED
        state = FitState.LAG_UNDETERMINED if wide else FitState.AT_LOWER_BOUND
        return _answer(setup, int(cycles.size), std, state)
    # A τ that was given has no error.
    covariance[0, 0] *= not given
    return _answer(setup, int(cycles.size), std, FitState.CONVERGED, theta, covariance, given=given)


def _setup(
    record: Record,
    test: TestDescription,
    window: BoolArray,
    breakpoints: tuple[float, ...],
    mixing_phi: float,
) -> _Setup:
    inside = np.flatnonzero(window)
    rows = slice(int(inside[0]), int(inside[-1]) + 1)
    cell_hz = cell_frequency_hz(record, rows, test.rotor_speed_rpm)
    stalled = hub_tip_stall(record, rows, cell_hz, slice(0))
    if stalled is None:
        raise InputError(
            f"{record.source}: plane 25",
            expected="hub and tip that pass other shares of the flow in stall than out of it",
            found="shares that hardly move",
        )
    onsets = np.diff(stalled.astype(np.int64), prepend=int(stalled[0])) > 0
    impossible = impossible_rows(record, test)
    share = float(np.mean(impossible[rows]))
    if share > MOST_IMPOSSIBLE:
        raise InputError(
            f"{record.source}: flow of plane 31",
            expected=f"no more than area 25 of {test.areas_m2[25]:g} m² passes",
            found=f"more in {share:.0%} of the rows of the surge cycles",
            remedy="check area_m2 of both planes and the calibration of their probes",
        )
    setup = _Setup(
        record,
        test,
        1.0 / cell_hz,
        tuple(float(b) for b in breakpoints),
        mixing_phi,
        rows,
        stalled.astype(np.float64),
        np.zeros_like(stalled),
        np.cumsum(onsets).astype(np.int64),
        impossible,
    )
    if np.count_nonzero(onsets[rows]) < FEWEST_CYCLES:
        # A machine that stays in stall: its cycles are those of the flow.
        phi = setup.phi(setup.flow)
        rising = np.diff((phi > np.median(phi[rows])).astype(np.int64), prepend=1) > 0
        setup = replace(setup, cycle=np.cumsum(rising).astype(np.int64))
    # One period to each side of a switch: what the average mixes, and the stall state is late by.
    margin = round(setup.period_s * record.sample_rate_hz)
    switches = np.append(stalled[1:] != stalled[:-1], False)
    scored = stalled & ~near(switches, margin - 1, margin) & ~impossible
    scored &= setup.phi(setup.flow) > SCORED_PHI
    # The average must not reach beyond the simulated rows either.
    scored[: rows.start + margin] = False
    scored[rows.stop - margin :] = False
    return replace(setup, scored=scored)


def _fits(setup: _Setup, time_constant_s: float | None) -> list[_Fit]:
    """Return the fits with the mean of both readings of the flow, and with each alone."""
    return [_fit(setup, flow, time_constant_s) for flow in (setup.flow, *setup.readings)]


def _corrected(mean: FloatArray, inlet: FloatArray, other: FloatArray) -> FloatArray:
    """Return log τ of the mean flow, and β extrapolated to no error of the flow."""
    beta = 2.0 * mean - 0.5 * (inlet + other)
    return np.concatenate([mean[:1], beta[1:]])


def _terms(phi: FloatArray, breakpoints: tuple[float, ...]) -> tuple[FloatArray, tuple[str, ...]]:
    basis = PiecewiseLinear(breakpoints)
    terms = np.asarray(basis.fit_transform(phi[:, None]), dtype=np.float64)
    return terms, tuple(str(name) for name in basis.get_feature_names_out(["phi"]))


def _fit(setup: _Setup, flow: FloatArray, time_constant_s: float | None) -> _Fit:
    """Fit with one reading of the flow: scan and refine log τ, all else is linear."""
    from scipy.optimize import minimize_scalar

    phi = setup.phi(flow)
    power = delivered_power(
        setup.record,
        setup.test,
        flow,
        phi,
        mixing_phi=setup.mixing_phi,
        smooth=setup.flat,
        stores=setup.stores,
    )
    target = setup.average(power)[setup.scored]
    inputs = setup.stalled[:, None] * _terms(phi, setup.breakpoints)[0]
    if not setup.stalled[setup.rows].all():
        free = np.column_stack([np.ones_like(phi), phi])
        inputs = np.column_stack([inputs, (1.0 - setup.stalled)[:, None] * free])

    def solved(log_tau: float) -> tuple[float, FloatArray, FloatArray]:
        columns = _responses(setup, inputs, flow, log_tau)
        coef = np.asarray(np.linalg.lstsq(columns, target, rcond=None)[0], dtype=np.float64)
        residual = target - columns @ coef
        return float(residual @ residual), coef, columns

    state = FitState.CONVERGED
    if time_constant_s is None:
        low, high = np.log(SEARCHED_TAU_S)
        grid = np.linspace(low, high, SCAN_POINTS)
        best = int(np.argmin([solved(x)[0] for x in grid]))
        bracket = (grid[max(best - 1, 0)], grid[min(best + 1, SCAN_POINTS - 1)])
        log_tau = float(minimize_scalar(lambda x: solved(x)[0], bounds=bracket).x)
        if log_tau < low + AT_BOUND:
            state = FitState.AT_LOWER_BOUND
        elif log_tau > high - AT_BOUND:
            state = FitState.AT_UPPER_BOUND
    else:
        log_tau = float(np.log(time_constant_s))
    _, coef, columns = solved(log_tau)
    # Central difference over 2 % of τ: the response is smooth in log τ.
    ahead, behind = (_responses(setup, inputs, flow, log_tau + s) @ coef for s in (0.01, -0.01))
    slope = (ahead - behind) / 0.02 if time_constant_s is None else np.zeros(target.size)
    return _Fit(
        np.concatenate([[log_tau], coef]),
        np.column_stack([slope, columns]),
        target - columns @ coef,
        state,
    )


def _responses(setup: _Setup, inputs: FloatArray, flow: FloatArray, log_tau: float) -> FloatArray:
    """Return A[W x_i] for the response to each input, and for what a start off by one adds."""
    lag = FirstOrderLag(float(np.exp(log_tau)), setup.record.sample_period_s, "first")
    driven = inputs[setup.rows]
    states = np.column_stack([lag.respond(driven, driven[0]), lag.decay(driven.shape[0])])
    powers = np.zeros((flow.size, states.shape[1]))
    powers[setup.rows] = flow[setup.rows, None] * states
    return setup.average(powers)[setup.scored]


def _answer(
    setup: _Setup,
    n_cycles: int,
    std: float,
    state: FitState,
    theta: FloatArray | None = None,
    covariance: FloatArray | None = None,
    *,
    given: bool = False,
) -> WorkCharacteristic:
    """Return what was found; without θ a code is the answer to a record that does not hold τ."""
    names = _terms(np.zeros(2), setup.breakpoints)[1]
    low = high = math.nan
    if theta is None or covariance is None:
        theta = np.full(1 + len(names), math.nan)
        covariance = np.full((theta.size, theta.size), math.nan)
    else:
        low, high = np.percentile(setup.phi(setup.flow)[setup.scored], (5.0, 95.0)).tolist()
    tau_s, scored = float(np.exp(theta[0])), int(np.count_nonzero(setup.scored))
    left = setup.rows.stop - setup.rows.start - scored
    impossible = int(np.count_nonzero(setup.impossible[setup.rows]))
    flag = f"{impossible} rows left out in which plane 31 shows more flow than plane 25 passes"
    entry = LedgerEntry(
        "work characteristic",
        f"ψ_QS fitted to W25 ψ in {scored} rows of {n_cycles} cycles, τ "
        + ("given" if given else "fitted")
        + f"; {left} rows near zero flow, in reversed flow, out of stall or within one cell period "
        "of a switch simulated, not scored",
        {
            "time_constant_s": round(tau_s, 6),
            "time_constant_given": given,
            "cell_hz": round(1.0 / setup.period_s, 3),
            "scored_phi": SCORED_PHI,
            "mixing_phi": setup.mixing_phi,
            "storage_between_planes": setup.stores,
            "residual_std": round(std, 4),
        },
        flags=(flag,) if impossible else (),
    )
    return WorkCharacteristic(
        tau_s,
        tau_s * float(np.sqrt(covariance[0, 0])),
        names,
        theta[1:],
        covariance[1:, 1:],
        setup.breakpoints,
        (low, high),
        scored,
        n_cycles,
        std,
        state,
        entry,
    )
