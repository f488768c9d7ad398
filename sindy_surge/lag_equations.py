"""The equations of the lag with noise on both channels, about any point, and their terms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sindy_surge.free_run import driven, run_lag, solve_recursion
from sindy_surge.lag_problem import LagProblem
from sindy_surge.noise import Whitener
from sindy_surge.segments import Segments
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray

_SMALL_STEP = 1e-5


@dataclass(frozen=True)
class Features:
    """Terms along the record."""

    values: FloatArray  # (n_rows, n_columns): The terms
    slopes: FloatArray  # (n_inputs, n_rows, n_columns): Derivatives with respect to each input
    # (n_rows, n_columns): Derivatives with respect to ψ'; zero where no state was given
    state_slopes: FloatArray


def features(
    problem: LagProblem,
    inputs: FloatArray,
    blur: FloatArray,
    support: Sequence[int],
    state: FloatArray | None = None,
) -> Features:
    """Evaluate some of the usable terms and undo the bend that remaining noise gives them.

    Noise of standard deviation s left in φ turns g into G g, its Gaussian average. The value
    returned is 3g - 3Gg + GGg, exact for powers up to five with the three-point Gauss-Hermite rule
    used here (nodes 0 and ±√3 s). The slope is the central difference over the same nodes. ψ' is
    the simulated one: it carries next to no noise.

    ``blur`` is s of each input; ``state`` is ψ' at the times when the inputs (n_rows, n_inputs)
    act, needed for the terms that hold it.
    """
    least = _SMALL_STEP * np.ptp(problem.inputs, axis=0)
    least[least == 0] = _SMALL_STEP
    reach = np.sqrt(3.0) * blur
    steps = np.maximum(reach, least)
    wanted = problem.columns[list(support)].tolist()

    def at(move: FloatArray | float, psi_p: FloatArray | None = state) -> FloatArray:
        return problem.terms(inputs + move, psi_p, wanted, strict=False)

    base = at(0.0)
    values, slopes = base.copy(), []
    for number, step in enumerate(steps):
        unit = step * np.eye(steps.size)[number]
        above, below = _where_defined(base, at(unit), at(-unit))
        slopes.append((above - below) / (2 * step))
        if step > least[number]:
            further, back = _where_defined(base, at(2 * unit), at(-2 * unit))
            once = 2 / 3 * base + (above + below) / 6
            twice = base / 2 + 2 / 9 * (above + below) + (further + back) / 36
            values += 2 * base - 3 * once + twice
    state_slopes = np.zeros_like(base)
    if state is not None and any(i >= problem.terms.n_without_state for i in wanted):
        move = _SMALL_STEP * max(float(np.ptp(problem.output)), 1e-300)
        state_slopes = (at(0.0, state + move) - at(0.0, state - move)) / (2 * move)
    return Features(values, np.stack(slopes), state_slopes)


def _where_defined(
    base: FloatArray, above: FloatArray, below: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Prolong a term as a straight line where it is not defined on one side (√φ at zero)."""
    high = np.where(np.isfinite(above), above, 2 * base - below)
    low = np.where(np.isfinite(below), below, 2 * base - above)
    return np.where(np.isfinite(high), high, base), np.where(np.isfinite(low), low, base)


# Second difference by a parabola through seven points (Savitzky & Golay 1964, table of 2nd
# derivatives): a plain one would be mostly noise.
_SECOND_DIFFERENCE = np.array([5.0, 0.0, -3.0, -4.0, -3.0, 0.0, 5.0]) / 42
_MOST_NEWTON_STEPS = 25
_CHORD_DOUBT = 2.0


@dataclass(frozen=True)
class Point:
    """Where a fit stands."""

    time_constant_s: float  # τ and the dead time, in seconds
    dead_time_s: float
    coefficients: FloatArray  # (n_support,): β
    bend: float  # Share of the smooth-signal correction
    input_noise: FloatArray  # (n_rows, n_inputs): Estimated noise of the inputs
    blur: FloatArray  # (n_inputs,): Standard deviation of the noise it leaves
    initial: FloatArray  # (n_runs,): ψ' at the first usable row of each run
    state: FloatArray | None  # (n_usable,): Simulated ψ'; None before the first simulation


def start_point(problem: LagProblem, tau_s: float, coefficients: FloatArray) -> Point:
    """Return a point at the measured inputs, each run starting at its measured ψ'."""
    first = problem.usable.rows[problem.usable.segments.starts]
    silent = np.zeros_like(problem.inputs)
    blur, initial = problem.noise.inputs.copy(), problem.output[first].copy()
    return Point(tau_s, problem.dead_time_s, coefficients, 0.0, silent, blur, initial, None)


@dataclass(frozen=True)
class Equations:
    """The equations of the lag about one point; vectors over them are not yet whitened."""

    whitener: Whitener  # Whitens vectors over the equations
    residual: FloatArray  # (n_equations,): A e
    # (n_equations, n_columns): Derivatives with respect to the coefficients of the model's terms,
    # or of the whole library
    columns: FloatArray
    # (n_equations, n_nuisances): Derivatives with respect to the bend (hold "first" only), the dead
    # time (if fitted) and, last, τ
    nuisances: FloatArray
    slopes: FloatArray  # (n_inputs, n_rows): dψ'_QS/dφ along the record
    # (n_runs,): ψ' at the first usable row of each run, by generalised least squares
    initial: FloatArray
    state: FloatArray  # (n_usable,): Simulated ψ'
    weighted: FloatArray  # (n_equations,): T⁻¹ A e
    # Greatest ∂ψ'_QS/∂ψ' on the record; from 1 on the lag would run away there
    greatest_gain: float

    def white_derivatives(self) -> FloatArray:
        """Return the whitened derivatives, those with respect to coefficients first."""
        return self.whitener(np.column_stack((self.columns, self.nuisances)))


def equations_about(
    problem: LagProblem, support: tuple[int, ...], point: Point, *, whole: bool = False
) -> Equations:
    """Set up residual, derivatives and whitening about one point.

    With e the error of the free run and D n the noise of φ in ψ'_QS, A e = A v - B D n. A is
    the recursion of the lag, linearised about the simulated ψ' where terms hold ψ'.
    """
    usable = problem.usable
    segments, later, at = usable.segments, usable.later, usable.ends
    lag = problem.lag(point.time_constant_s, point.dead_time_s)
    run = _run(problem, support, point, lag)
    gap = problem.output[usable.rows] - run.state
    residual = run.ahead * gap[later] - run.behind * gap[later - 1]
    residual -= driven(lag, (run.slopes * point.input_noise.T).sum(axis=0), at)
    nuisances: list[FloatArray] = []
    doubt: FloatArray | float = 0.0
    if problem.hold == "first":
        nuisances.append(driven(lag, run.bent, at))
        # Where a kink lies between two samples, the correction for chords is wrong by as much as
        # it is large.
        doubt = _CHORD_DOUBT * np.abs(nuisances[0])
    whitener = Whitener(
        lag, run.slopes, problem.noise, segments, usable.rows, run.ahead, run.behind, doubt
    )
    weighted = whitener.precision(residual)
    # Generalised least squares for the free initial state: y[0] - E[v[0] | A e].
    initial = problem.output[usable.rows[segments.starts]].copy()
    first = whitener.equation_segments.starts
    pull = run.behind[first] * problem.noise.output**2 * weighted[first]
    initial[segments.lengths > 1] += pull
    state = run.state
    if not problem.holds_state(support):
        state = run_lag(_drive(problem, lag, run.forcing), segments, lag.a, initial)
    if problem.fits_dead_time:
        by_inputs = driven(lag, run.forcing, at, by=2) / problem.sample_period_s
        nuisances.append(by_inputs + driven(lag, _late_state(problem, run, point), at))
    # The simulated ψ', not the measured one: noise in the sensitivity would bias τ.
    by_tau = lag.d_a * state[later - 1] + driven(lag, run.forcing, at, by=1)
    nuisances.append(by_tau / lag.tau_s)
    return Equations(
        whitener,
        residual,
        driven(lag, _whole_library(problem, run, point) if whole else run.values, at),
        np.column_stack(nuisances),
        run.slopes,
        initial,
        state,
        weighted,
        float(run.gain.max()),
    )


def noise_in_inputs(problem: LagProblem, eq: Equations, point: Point) -> FloatArray:
    """Return the expected noise of the inputs given the residual, -σ_φ² D Bᵀ T⁻¹ A e.

    Five standard deviations at most: a structure that is far off blames more on its inputs than any
    noise can do, and the terms would be evaluated outside their range.
    """
    lag = problem.lag(point.time_constant_s, point.dead_time_s)
    at = problem.usable.ends - lag.whole_samples
    back = np.zeros(problem.output.size)
    for number, tap in enumerate(lag.taps[0]):
        back[at - number] += tap * eq.weighted
    levels = problem.noise.inputs
    return np.clip((-(levels[:, None] ** 2) * eq.slopes * back).T, -5 * levels, 5 * levels)


@dataclass(frozen=True)
class _Run:
    """A free run: terms, their slopes, forcing, its correction for chords, ψ', the recursion."""

    values: FloatArray
    slopes: FloatArray
    forcing: FloatArray
    bent: FloatArray
    state: FloatArray
    gain: FloatArray
    ahead: FloatArray
    behind: FloatArray


def _run(problem: LagProblem, support: tuple[int, ...], point: Point, lag: FirstOrderLag) -> _Run:
    inputs, beta = problem.inputs - point.input_noise, point.coefficients
    state, acting = None, None
    if problem.holds_state(support):
        state = _newton(problem, support, point, lag)
        acting = _when_inputs_act(problem, state, point.dead_time_s)
    found = features(problem, inputs, point.blur, support, acting)
    forcing = found.values @ beta
    bent = _bend(forcing, problem.segments)
    forcing = forcing + point.bend * bent
    if state is None:
        drive = _drive(problem, lag, forcing)
        state = run_lag(drive, problem.usable.segments, lag.a, point.initial)
        gain = np.zeros(problem.output.size)
    else:
        gain = found.state_slopes @ beta
    recursion = _recursion(problem, gain, point)
    return _Run(found.values, found.slopes @ beta, forcing, bent, state, gain, *recursion)


def _newton(
    problem: LagProblem, support: tuple[int, ...], point: Point, lag: FirstOrderLag
) -> FloatArray:
    """Run a model whose terms hold ψ': x[k] = a x[k-1] + Σ taps f(φ, x), by Newton's method.

    The terms are joined by straight lines like those of φ alone (an exponential integrator of
    second order). Each Newton step is one bidiagonal solution.
    """
    usable, segments = problem.usable, problem.usable.segments
    measured = problem.output[usable.rows]
    state = measured if point.state is None else point.state
    inputs, beta = problem.inputs - point.input_noise, point.coefficients
    wanted = problem.columns[list(support)].tolist()
    acting = _when_inputs_act(problem, state, point.dead_time_s)
    found = features(problem, inputs, point.blur, support, acting)
    # What the blur of φ adds, held while ψ' moves.
    plain = problem.terms(inputs, acting, wanted) @ beta
    rest = found.values @ beta - plain
    low, high = measured.min() - 2 * np.ptp(measured), measured.max() + 2 * np.ptp(measured)
    recursion = _recursion(problem, found.state_slopes @ beta, point)
    for _ in range(_MOST_NEWTON_STEPS):
        forcing = plain + rest
        forcing = forcing + point.bend * _bend(forcing, problem.segments)
        target = _drive(problem, lag, forcing) - state
        target[usable.later] += lag.a * state[usable.later - 1]
        target[segments.starts] = point.initial - state[segments.starts]
        change = solve_recursion(*recursion, target, segments)
        state = np.clip(state + change, low, high)
        if np.max(np.abs(change)) < 1e-9 * (high - low):
            break
        acting = _when_inputs_act(problem, state, point.dead_time_s)
        plain = problem.terms(inputs, acting, wanted) @ beta
    return state


def _whole_library(problem: LagProblem, run: _Run, point: Point) -> FloatArray:
    acting = None
    if problem.columns.size > problem.n_without_state:
        acting = _when_inputs_act(problem, run.state, point.dead_time_s)
    inputs, every = problem.inputs - point.input_noise, range(problem.columns.size)
    return features(problem, inputs, point.blur, every, acting).values


def _late_state(problem: LagProblem, run: _Run, point: Point) -> FloatArray:
    """Return what a later dead time changes through ψ' in the terms, which act on time."""
    step = 1e-3 * problem.sample_period_s
    above = _when_inputs_act(problem, run.state, point.dead_time_s + step)
    below = _when_inputs_act(problem, run.state, point.dead_time_s - step)
    return run.gain * (above - below) / (2 * step)


def _recursion(
    problem: LagProblem, gain: FloatArray, point: Point
) -> tuple[FloatArray, FloatArray]:
    """Return the weights of e[k] and -e[k-1] where ∂(terms)/∂ψ' = gain."""
    lag = problem.lag(point.time_constant_s)
    now, before = lag.gain_now, lag.gain_before
    late = round(point.dead_time_s / problem.sample_period_s)
    rows = np.clip(problem.usable.ends - late, 1, gain.size - 1)
    # Beyond these the recursion would turn round within one sample, or the lag run away; a fit
    # passes through such models on its way.
    lowest = -min(0.5 / max(now, 1e-12), 0.9 * (1.0 + lag.a) / max(before, 1e-12))
    capped = np.clip(gain, lowest, 1.0)
    return 1.0 - now * capped[rows], lag.a + before * capped[rows - 1]


def _drive(problem: LagProblem, lag: FirstOrderLag, forcing: FloatArray) -> FloatArray:
    """Return the drive at every usable row; the first of each run has none."""
    usable = problem.usable
    drive = np.zeros(usable.rows.size)
    drive[usable.later] = driven(lag, forcing, usable.ends)
    return drive


def _when_inputs_act(problem: LagProblem, state: FloatArray, dead_time_s: float) -> FloatArray:
    """Return simulated ψ' at the times when the inputs of each row of the record act."""
    usable, segments = problem.usable, problem.segments
    samples = dead_time_s / problem.sample_period_s
    if samples == 0.0 and usable.rows.size == problem.output.size:
        return state
    whole = int(np.floor(samples))
    known = np.full(problem.output.size, state[0])
    known[usable.rows] = state
    bounds = np.zeros((2, segments.starts.size), dtype=np.intp)
    bounds[0, usable.home] = usable.rows[usable.segments.starts]
    bounds[1, usable.home] = usable.rows[usable.segments.stops - 1]
    low, high = np.repeat(bounds, segments.lengths, axis=1)
    at = np.arange(known.size) + whole
    near, far = known[np.clip(at, low, high)], known[np.clip(at + 1, low, high)]
    return np.asarray((1 - samples + whole) * near + (samples - whole) * far)


def _bend(forcing: FloatArray, segments: Segments) -> FloatArray:
    """Return minus a twelfth of the second difference; 0 within three rows of a segment's ends."""
    if forcing.size < _SECOND_DIFFERENCE.size:
        return np.zeros_like(forcing)
    bent = np.convolve(forcing, -_SECOND_DIFFERENCE / 12, mode="same")
    offsets = segments.offsets()
    to_end = np.repeat(segments.lengths, segments.lengths) - 1 - offsets
    return np.where((offsets >= 3) & (to_end >= 3), bent, 0.0)
