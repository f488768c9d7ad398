"""The equations of the lag with noise on both channels, about any point."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sindy_surge.features import features
from sindy_surge.free_run import DelayedLag, run_lag
from sindy_surge.lag_problem import LagProblem
from sindy_surge.noise import Whitener
from sindy_surge.segments import Segments
from surge_core.types import FloatArray

__all__ = [
    "Equations",
    "Point",
    "equations_about",
    "free_run",
    "noise_in_inputs",
    "start_point",
]


# Second difference by a parabola through seven points (Savitzky & Golay 1964, table of 2nd
# derivatives): a plain one would be mostly noise.
_SECOND_DIFFERENCE = np.array([5.0, 0.0, -3.0, -4.0, -3.0, 0.0, 5.0]) / 42
_MOST_NEWTON_STEPS = 25
_CHORD_DOUBT = 2.0


@dataclass(frozen=True)
class Point:
    """Where a fit stands.

    Parameters
    ----------
    time_constant_s, dead_time_s : float
        τ and the dead time, in seconds.
    coefficients : ndarray of shape (n_support,)
        β.
    bend : float
        Share of the smooth-signal correction.
    input_noise : ndarray of shape (n_rows, n_inputs)
        Estimated noise of the inputs.
    blur : ndarray of shape (n_inputs,)
        Standard deviation of the noise it leaves.
    initial : ndarray of shape (n_runs,)
        ψ' at the first usable row of each run.
    state : ndarray of shape (n_usable,) or None
        Simulated ψ'; None before the first simulation.
    """

    time_constant_s: float
    dead_time_s: float
    coefficients: FloatArray
    bend: float
    input_noise: FloatArray
    blur: FloatArray
    initial: FloatArray
    state: FloatArray | None


def start_point(problem: LagProblem, tau_s: float, coefficients: FloatArray) -> Point:
    """Return a point at the measured inputs, each run starting at its measured ψ'.

    Parameters
    ----------
    tau_s : float
        τ in seconds.
    coefficients : ndarray of shape (n_support,)
        β.
    """
    first = problem.usable.rows[problem.usable.segments.starts]
    return Point(
        tau_s,
        problem.dead_time.seconds,
        coefficients,
        0.0,
        np.zeros_like(problem.inputs),
        problem.noise.inputs.copy(),
        problem.output[first].copy(),
        None,
    )


@dataclass(frozen=True)
class Equations:
    """The equations of the lag about one point.

    Parameters
    ----------
    whitener : Whitener
        Whitens vectors over the equations.
    residual : ndarray of shape (n_equations,)
        A e, not yet whitened.
    tau_column, dead_time_column, bend_column : ndarray of shape (n_equations,)
        Derivatives with respect to τ, the dead time and the bend.
    raw_columns : ndarray of shape (n_equations, n_columns)
        Derivatives with respect to the coefficients of the model's terms, or of the whole
        library.
    slopes : ndarray of shape (n_inputs, n_rows)
        dψ'_QS/dφ along the record.
    initial : ndarray of shape (n_runs,)
        ψ' at the first usable row of each run, by generalised least squares.
    state : ndarray of shape (n_usable,)
        Simulated ψ'.
    weighted : ndarray of shape (n_equations,)
        T⁻¹ A e.
    greatest_gain : float
        Greatest ∂ψ'_QS/∂ψ' on the record; from 1 on the lag would run away there.
    """

    whitener: Whitener
    residual: FloatArray
    tau_column: FloatArray
    dead_time_column: FloatArray
    bend_column: FloatArray
    raw_columns: FloatArray
    slopes: FloatArray
    initial: FloatArray
    state: FloatArray
    weighted: FloatArray
    greatest_gain: float


def equations_about(
    problem: LagProblem, support: tuple[int, ...], point: Point, *, whole: bool = False
) -> Equations:
    """Set up residual, derivatives and whitening about one point.

    With e the error of the free run and D n the noise of φ in ψ'_QS, A e = A v - B D n. A is
    the recursion of the lag, linearised about the simulated ψ' where terms hold ψ'.
    """
    usable = problem.usable
    later, at = usable.later, usable.rows[usable.later]
    taps = problem.taps_at(point.time_constant_s, point.dead_time_s)
    run = _free_run(problem, support, point, taps, whole)
    forcing, state = run.forcing, run.state
    slopes = run.slopes
    gap = problem.output[usable.rows] - state
    residual = run.ahead * gap[later] - run.behind * gap[later - 1]
    residual -= taps.drive((slopes * point.input_noise.T).sum(axis=0), at)
    bend_column = taps.drive(run.bent, at)
    # Where a kink lies between two samples, the correction for chords is wrong by as much as it
    # is large.
    doubt = _CHORD_DOUBT * np.abs(bend_column) if problem.hold == "first" else None
    whitener = Whitener(
        taps, slopes, problem.noise, usable.segments, usable.rows, run.ahead, run.behind, doubt
    )
    weighted = whitener.precision(residual)
    # Generalised least squares for the free initial state: y[0] - E[v[0] | A e].
    initial = problem.output[usable.rows[usable.segments.starts]].copy()
    first = whitener.equation_segments.starts
    pull = run.behind[first] * problem.noise.output**2 * weighted[first]
    initial[usable.segments.lengths > 1] += pull
    if not problem.holds_state(support):
        state = run_lag(_drive(problem, taps, forcing), usable.segments, taps.pole, initial)
    return Equations(
        whitener,
        residual,
        # The simulated ψ', not the measured one: noise in the sensitivity would bias τ.
        taps.pole_slope * state[later - 1] + taps.drive(forcing, at, by=1),
        taps.drive(forcing, at, by=2) + _late_state(problem, run, point, taps),
        bend_column,
        taps.drive(run.values, at),
        slopes,
        initial,
        state,
        weighted,
        run.greatest_gain,
    )


def free_run(problem: LagProblem, support: tuple[int, ...], point: Point) -> FloatArray:
    """Return the simulated ψ' of a structure at one point.

    Returns
    -------
    ndarray of shape (n_usable,)
        ψ' at the usable rows, each run from its initial state.
    """
    taps = problem.taps_at(point.time_constant_s, point.dead_time_s)
    return _free_run(problem, support, point, taps, whole=False).state


@dataclass(frozen=True)
class _Run:
    """A free run: terms, their slope, forcing, its correction for chords, ψ', and the recursion."""

    values: FloatArray
    slopes: FloatArray
    forcing: FloatArray
    bent: FloatArray
    state: FloatArray
    ahead: FloatArray
    behind: FloatArray
    gain: FloatArray | None = None

    @property
    def greatest_gain(self) -> float:
        """Greatest ∂ψ'_QS/∂ψ' along the record."""
        return 0.0 if self.gain is None else float(self.gain.max())


def _late_state(
    problem: LagProblem, run: _Run, point: Point, taps: DelayedLag
) -> FloatArray | float:
    """Return what a later dead time changes through ψ' in the terms, which act on time."""
    if run.gain is None or not problem.dead_time.fitted:
        return 0.0
    step = 1e-3 * problem.sample_period_s
    above = _when_inputs_act(problem, run.state, point.dead_time_s + step)
    below = _when_inputs_act(problem, run.state, point.dead_time_s - step)
    usable = problem.usable
    moved = run.gain * (above - below) / (2 * step)
    return taps.drive(moved, usable.rows[usable.later])


def _free_run(
    problem: LagProblem, support: tuple[int, ...], point: Point, taps: DelayedLag, whole: bool
) -> _Run:
    inputs = problem.inputs - point.input_noise
    n_equations = problem.usable.later.size
    beta = point.coefficients
    if problem.holds_state(support):
        run = _state_run(problem, support, point, taps, inputs)
    else:
        found = features(problem, inputs, point.blur, support)
        forcing = found.values @ beta
        bent = _bend(forcing, problem.segments)
        forcing = forcing + point.bend * bent
        drive = _drive(problem, taps, forcing)
        run = _Run(
            found.values,
            found.slopes @ beta,
            forcing,
            bent,
            run_lag(drive, problem.usable.segments, taps.pole, point.initial),
            np.ones(n_equations),
            np.full(n_equations, taps.pole),
        )
    if not whole:
        return run
    acting = None
    if problem.columns.size > problem.n_without_state:
        acting = _when_inputs_act(problem, run.state, point.dead_time_s)
    every = range(problem.columns.size)
    return replace(run, values=features(problem, inputs, point.blur, every, acting).values)


def _state_run(
    problem: LagProblem,
    support: tuple[int, ...],
    point: Point,
    taps: DelayedLag,
    inputs: FloatArray,
) -> _Run:
    """Run a model whose terms hold ψ': x[k] = a x[k-1] + Σ taps f(φ, x), by Newton's method.

    The terms are joined by straight lines like those of φ alone (an exponential integrator of
    second order). Each Newton step is one bidiagonal solution.
    """
    measured = problem.output[problem.usable.rows]
    state = measured if point.state is None else point.state
    wanted, beta = problem.columns[list(support)].tolist(), point.coefficients
    acting = _when_inputs_act(problem, state, point.dead_time_s)
    found = features(problem, inputs, point.blur, support, acting)
    # What the blur of φ adds, held while ψ' moves.
    plain = problem.terms(inputs, acting, wanted) @ beta
    rest = found.values @ beta - plain
    low, high = measured.min() - 2 * np.ptp(measured), measured.max() + 2 * np.ptp(measured)
    ahead, behind = _recursion(problem, taps, found.state_slopes @ beta, point)
    for _ in range(_MOST_NEWTON_STEPS):
        forcing = plain + rest
        forcing = forcing + point.bend * _bend(forcing, problem.segments)
        change = _newton_step(problem, taps, forcing, state, point.initial, ahead, behind)
        state = np.clip(state + change, low, high)
        acting = _when_inputs_act(problem, state, point.dead_time_s)
        if np.max(np.abs(change)) < 1e-9 * (high - low):
            break
        plain = problem.terms(inputs, acting, wanted) @ beta
    found = features(problem, inputs, point.blur, support, acting)
    forcing = found.values @ beta
    bent = _bend(forcing, problem.segments)
    gain = found.state_slopes @ beta
    ahead, behind = _recursion(problem, taps, gain, point)
    forcing = forcing + point.bend * bent
    slopes = found.slopes @ beta
    return _Run(found.values, slopes, forcing, bent, state, ahead, behind, gain)


def _recursion(
    problem: LagProblem, taps: DelayedLag, gain: FloatArray, point: Point
) -> tuple[FloatArray, FloatArray]:
    """Return the weights of e[k] and -e[k-1] where ∂(terms)/∂ψ' = gain."""
    lag = problem.hold_at(point.time_constant_s)
    now, before = lag.gain_now, lag.gain_before
    late = round(point.dead_time_s / problem.sample_period_s)
    rows = problem.usable.rows[problem.usable.later] - late
    rows = np.clip(rows, 1, gain.size - 1)
    # Beyond these the recursion would turn round within one sample, or the lag run away; a fit
    # passes through such models on its way.
    lowest = -min(0.5 / max(now, 1e-12), 0.9 * (1.0 + taps.pole) / max(before, 1e-12))
    capped = np.clip(gain, lowest, 1.0)
    return 1.0 - now * capped[rows], taps.pole + before * capped[rows - 1]


def _newton_step(
    problem: LagProblem,
    taps: DelayedLag,
    forcing: FloatArray,
    state: FloatArray,
    initial: FloatArray,
    ahead: FloatArray,
    behind: FloatArray,
) -> FloatArray:
    from scipy.linalg import solve_banded

    usable = problem.usable
    later, starts = usable.later, usable.segments.starts
    band = np.zeros((2, state.size))
    band[0] = 1.0
    band[0, later] = ahead
    band[1, later - 1] = -behind
    target = np.empty(state.size)
    target[starts] = initial - state[starts]
    drive = taps.drive(forcing, usable.rows[later])
    target[later] = taps.pole * state[later - 1] + drive - state[later]
    return np.asarray(solve_banded((1, 0), band, target))


def _drive(problem: LagProblem, taps: DelayedLag, forcing: FloatArray) -> FloatArray:
    """Return the drive at every usable row; the first of each run has none."""
    usable = problem.usable
    drive = np.zeros(usable.rows.size)
    drive[usable.later] = taps.drive(forcing, usable.rows[usable.later])
    return drive


def _when_inputs_act(problem: LagProblem, state: FloatArray, dead_time_s: float) -> FloatArray:
    """Return simulated ψ' at the times when the inputs of each row of the record act."""
    usable = problem.usable
    samples = dead_time_s / problem.sample_period_s
    if samples == 0.0 and usable.rows.size == problem.output.size:
        return state
    whole = int(np.floor(samples))
    part = samples - whole
    n_segments = problem.segments.starts.size
    low = np.zeros(n_segments, dtype=np.intp)
    high, offset = low.copy(), low.copy()
    low[usable.home] = usable.rows[usable.segments.starts]
    high[usable.home] = usable.rows[usable.segments.stops - 1]
    offset[usable.home] = usable.segments.starts
    home = np.repeat(np.arange(n_segments), problem.segments.lengths)
    at = np.arange(problem.output.size) + whole
    near = offset[home] + np.clip(at, low[home], high[home]) - low[home]
    far = offset[home] + np.clip(at + 1, low[home], high[home]) - low[home]
    return np.asarray((1 - part) * state[near] + part * state[far])


def _bend(forcing: FloatArray, segments: Segments) -> FloatArray:
    """Return minus a twelfth of the second difference; 0 within three rows of a segment's ends."""
    if forcing.size < _SECOND_DIFFERENCE.size:
        return np.zeros_like(forcing)
    bent = np.convolve(forcing, -_SECOND_DIFFERENCE / 12, mode="same")
    offsets = segments.offsets()
    to_end = np.repeat(segments.lengths, segments.lengths) - 1 - offsets
    return np.where((offsets >= 3) & (to_end >= 3), bent, 0.0)


def noise_in_inputs(problem: LagProblem, eq: Equations, point: Point) -> FloatArray:
    """Return the expected noise of the inputs given the residual, -σ_φ² D Bᵀ T⁻¹ A e.

    Five standard deviations at most: a structure that is far off blames more on its inputs than
    any noise can do, and the terms would be evaluated outside their range.

    Returns
    -------
    ndarray of shape (n_rows, n_inputs)
        The noise.
    """
    taps = problem.taps_at(point.time_constant_s, point.dead_time_s)
    at = problem.usable.rows[problem.usable.later]
    back = np.zeros(problem.output.size)
    for number, tap in enumerate(taps.weights[0]):
        back[at - taps.shift - number] += tap * eq.weighted
    levels = problem.noise.inputs
    return np.clip((-(levels[:, None] ** 2) * eq.slopes * back).T, -5 * levels, 5 * levels)
