"""A run linearised: how its outputs answer to small changes of numbers, starts and structure.

The transition matrices are exponentials (Magnus, fourth order) on two steps a sample; a change is
a forcing that they carry on. In the kernels ``states`` is a run on the fine grid, of shape
(FINE·(n − 1) + 1, n_X), and ``system`` what `dynamics.extended_rhs` takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from comparisons.missing_effect.systems.compiled import call_at
from comparisons.missing_effect.systems.dynamics import (
    HEAD,
    ROW,
    SLOTS,
    System,
    add_effect,
    extended_output,
    extended_rhs,
    prepare,
    scratch_for,
    views,
)
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.pointers import kernel
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.simulate import (
    FINE,
    Path,
    black_box_path,
    outputs_along,
    own_starts,
)
from comparisons.missing_effect.systems.structure import Run, Structure
from surge_core.types import FloatArray, IntArray

RELATIVE_STEP = 1e-6
# Sizes that matrices are scaled to before their exponential, and beyond which there is none.
SCALED, RAN_AWAY = 0.25, 1e12
# Of the coefficients of the recording filter.
FILTER_STEP = 1e-4
# Amplitude at which an effect that is linear in it, but no term, is laid along the run.
SMALL = 1e-4
# Steps of differences of a black box over those of a model that is integrated here: what runs
# within it rounds as it likes.
BLACK_BOX_STEP = 100.0

Laid = tuple[Placed, tuple[float, ...]]


@dataclass(frozen=True, eq=False)
class Linearised:
    """A run, and how its outputs answer to small changes.

    Parameters
    ----------
    structure : Structure
        Model and effects.
    run : Run
        Inputs and clock.
    theta : ndarray
        Parameters, offsets, effects.
    path : Path
        The run there.
    scale : ndarray of shape (n_X,)
        Size of each state, for differences.
    """

    structure: Structure
    run: Run
    theta: FloatArray
    path: Path
    scale: FloatArray

    @cached_property
    def system(self) -> System:
        """What the kernels take."""
        return self.run.system(self.structure, self.theta)

    @cached_property
    def transitions(self) -> tuple[FloatArray, FloatArray] | None:
        """Transition matrices over whole and second half steps; a black box has none."""
        if self.structure.model.simulate is not None:
            return None
        slopes = _jacobians(self.path.states, self.system, self.scale)
        whole, half = _propagators(slopes, 2.0 * self.run.sample_period_s / FINE)
        units = self.scale[:, None] / self.scale
        return whole * units, half * units

    def to_numbers(self, which: IntArray) -> FloatArray:
        """Return how the outputs answer to numbers of θ, and then to each state at the start.

        Parameters
        ----------
        which : ndarray of int, shape (m,)
            The numbers.

        Returns
        -------
        ndarray of shape (n, n_y, m + n_X)
            Not a number where the run has no reading.
        """
        steps = self.structure.steps(self.theta)[which]
        if self.transitions is None:
            return self._read(self._differences(which, steps))
        (rows, n_X), m = self.path.states.shape, which.size
        forcing = np.zeros((rows, n_X, m + n_X))
        forcing[:, :, :m] = _parameter_forcing(self.path.states, self.system, which, steps)
        direct = np.zeros((*self.run.outputs.shape, m + n_X))
        at = self.structure.recording
        for c, number in enumerate(which):
            if at is not None and at <= number <= at + 1:
                forcing[:, :, c], direct[:, :, c] = self._through_filter(int(number))
        start = np.hstack([np.zeros((n_X, m)), np.eye(n_X)])
        return self._carried(forcing, start, direct, which, steps)

    def to_effects(self, laid: Sequence[Laid]) -> FloatArray:
        """Return how the outputs would answer to each of some effects, to first order.

        Parameters
        ----------
        laid : sequence of (Placed, tuple of float)
            Effects at their places and their numbers; an amplitude is replaced by a small one.

        Returns
        -------
        ndarray of shape (n, n_y, effects)
            Not a number where the run has no reading.
        """
        direct = np.zeros((*self.run.outputs.shape, len(laid)))
        forcing = np.zeros((*self.path.states.shape, len(laid)))
        for c, (placed, start) in enumerate(laid):
            extended, linear = self.structure.with_effect(placed), placed.effect.linear
            size = SMALL if linear and placed.effect.kind != Kind.TERM else 1.0
            numbers = (size, *start[1:]) if linear else start
            theta = np.concatenate([self.theta, extended.slots(numbers)])
            if self.transitions is None:
                with_it = black_box_path(extended, self.run, theta, self.path.states[0]).outputs
                direct[:, :, c] = (with_it - self.path.outputs) / size
                continue
            n_X = self.structure.n_states
            own = own_starts(extended, self.run, self.path.states[0])[n_X:]
            changed = self.run.system(extended, theta)
            forced, seen = _along(self.path.states, own, changed, self.system)
            # The answer through the recording filter, and what a new one does to the run itself.
            seen = self.structure.recorded(seen, self.theta)
            if placed.effect.kind == Kind.RECORDING:
                seen += extended.recorded(self.path.outputs, theta) - self.path.outputs
            forcing[:, :, c], direct[:, :, c] = forced / size, seen / size
        if self.transitions is None:
            return self._read(direct)
        nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
        return self._carried(forcing, np.zeros(forcing.shape[1:]), direct, *nothing)

    def _carried(
        self,
        forcing: FloatArray,
        start: FloatArray,
        direct: FloatArray,
        which: IntArray,
        steps: FloatArray,
    ) -> FloatArray:
        """Return the outputs' answers to what is added to dX/dt, to the start, and to them."""
        assert self.transitions is not None
        fine_s = self.run.sample_period_s / FINE
        moved = _forced(*self.transitions, forcing, start, fine_s)
        slopes = _output_slopes(self.path.states, moved, self.system, which, steps, self.scale)
        return self._read(self.structure.recorded(slopes, self.theta) + direct)

    def _read(self, columns: FloatArray) -> FloatArray:
        """Return columns that are not a number where the run has no reading."""
        columns[~self.run.valid] = np.nan
        return columns

    def _through_filter(self, which: int) -> tuple[FloatArray, FloatArray]:
        """Return ∂f/∂θ through the undone input filter, and how the outputs' filter answers."""
        above, below = self.theta.copy(), self.theta.copy()
        above[which] += FILTER_STEP
        below[which] -= FILTER_STEP
        recorded = self.structure.recorded
        changed, unchanged = (
            (*self.system[:3], self.run.pieces_for(self.structure, side), self.run.clock)
            for side in (above, below)
        )
        forcing, direct = _along(self.path.states, np.zeros(0), changed, unchanged)
        bare = outputs_along(self.path.states, self.system)
        through = recorded(bare, above) - recorded(bare, below)
        direct = recorded(direct, self.theta) + through
        return forcing / (2.0 * FILTER_STEP), direct / (2.0 * FILTER_STEP)

    def _differences(self, which: IntArray, steps: FloatArray) -> FloatArray:
        """Return how a black box answers to each parameter, and to those of its record."""
        start, out = self.path.states[0], []
        ranges = [p.high - p.low for p in self.structure.model.per_record.values()]
        for c, step in enumerate([*(BLACK_BOX_STEP * steps), *(SMALL * size for size in ranges)]):
            sides = []
            for side in (step, -step):
                theta, begun = self.theta.copy(), start.copy()
                if c < which.size:
                    theta[which[c]] += side
                else:
                    begun[c - which.size] += side
                sides.append(black_box_path(self.structure, self.run, theta, begun).outputs)
            out.append((sides[0] - sides[1]) / (2.0 * step))
        return np.stack(out, axis=2) if out else np.zeros((*self.run.outputs.shape, 0))


@njit(cache=True, error_model="numpy")
def _jacobians(states: FloatArray, system: System, scale: FloatArray) -> FloatArray:
    """Return ∂f/∂X along a run in units of the scale, by central differences.

    In these units the exponential needs few squarings.
    """
    m, n = states.shape
    out, scratch = np.empty((m, n, n)), scratch_for(system[1])
    moved, above, below = np.empty(n), np.empty(n), np.empty(n)
    for k in range(m):
        t = k * system[4][1] / FINE
        moved[:] = states[k]
        for i in range(n):
            value = moved[i]
            step = RELATIVE_STEP * (abs(value) + scale[i])
            moved[i] = value + step
            extended_rhs(t, moved, system, above, scratch)
            moved[i] = value - step
            extended_rhs(t, moved, system, below, scratch)
            moved[i] = value
            for j in range(n):
                out[k, j, i] = (above[j] - below[j]) / (2.0 * step) * (scale[i] / scale[j])
    return out


@njit(cache=True, error_model="numpy")
def _propagators(slopes: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the transition matrices over whole and second half steps, two steps a sample."""
    steps, n = (slopes.shape[0] - 1) // 2, slopes.shape[1]
    whole, half = np.empty((steps, n, n)), np.empty((steps, n, n))
    for k in range(steps):
        first, middle, last = slopes[2 * k], slopes[2 * k + 1], slopes[2 * k + 2]
        mean = (first + 4.0 * middle + last) / 6.0
        twist = (_product(last, first) - _product(first, last)) / 12.0
        whole[k] = _exponential(mean * step_s + twist * step_s**2)
        half[k] = _exponential((middle + last) * (0.25 * step_s))
    return whole, half


@njit(cache=True, error_model="numpy")
def _exponential(matrix: FloatArray) -> FloatArray:
    """Return the exponential of a small matrix: scaling, Padé (3, 3), squaring."""
    size = np.max(np.sum(np.abs(matrix), axis=1))
    if not size < RAN_AWAY:
        return np.full_like(matrix, np.nan)
    halvings = 0
    while size > SCALED:
        size, halvings = 0.5 * size, halvings + 1
    A = matrix * 0.5**halvings
    square = _product(A, A)
    even = square / 10.0 + np.eye(A.shape[0])
    odd = A / 2.0 + _product(square, A) / 120.0
    out = even + odd
    _solve(even - odd, out)
    for _ in range(halvings):
        out = _product(out, out)
    return out


@njit(cache=True, error_model="numpy")
def _product(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return A·B of small matrices, for which a library takes far longer to be called."""
    n = A.shape[0]
    out = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            for k in range(n):
                out[i, j] += A[i, k] * B[k, j]
    return out


@kernel
def _solve(A: FloatArray, B: FloatArray) -> None:
    """Replace B by A⁻¹B and destroy A, which is so near to one that it needs no pivots."""
    n = A.shape[0]
    for k in range(n):
        for i in range(k + 1, n):
            share = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= share * A[k, j]
            for j in range(n):
                B[i, j] -= share * B[k, j]
    for i in range(n - 1, -1, -1):
        for j in range(n):
            for k in range(i + 1, n):
                B[i, j] -= A[i, k] * B[k, j]
            B[i, j] /= A[i, i]


@njit(cache=True, error_model="numpy")
def _acts_alone(i: int, ints: IntArray) -> bool:
    """Tell whether number i of θ acts in one place, so that nothing else need be worked out.

    A parameter of the model acts in its equations, unless an output of it drives a further lag; a
    number of a term, an overflow or a hysteresis in what that adds.
    """
    n_p, first = ints[4], ints[4] + ints[3]
    if i < n_p:
        return not np.any(ints[HEAD::ROW] == 6)
    kind = ints[HEAD + ROW * ((i - first) // SLOTS)] if i >= first else -1
    return kind in (0, 9, 10)


@kernel
def _moved_alone(
    i: int, t: float, X: FloatArray, by: float, system: System, out: FloatArray, scratch: FloatArray
) -> None:
    """Fill out with what number i of θ, moved already by so much, has a hand in."""
    ints = system[1]
    x, u, p, _ = views(ints, scratch)
    for j in range(out.size):
        out[j] = 0.0
    if i >= p.size:
        add_effect((i - p.size - u.size) // SLOTS, t, X, system, out, scratch)
        return
    value = p[i]
    p[i] = value + by
    call_at(ints[0], t, x, u, p, out)
    p[i] = value


@njit(cache=True, error_model="numpy")
def _parameter_forcing(
    states: FloatArray, system: System, which: IntArray, steps: FloatArray
) -> FloatArray:
    """Return ∂f/∂θ along a run, by central differences, one column a number of θ."""
    theta, ints, floats, pieces, clock = system
    m, n = states.shape
    out = np.zeros((m, n, which.size))
    space, dX = np.empty((2, n)), np.empty(n)
    moved, scratch, spare = theta.copy(), scratch_for(ints), scratch_for(ints)
    alone = np.array([_acts_alone(i, ints) for i in which])
    changed = (moved, ints, floats, pieces, clock)
    for k in range(m):
        t, X = k * clock[1] / FINE, states[k]
        prepare(t, X, system, dX, scratch)
        for c in range(which.size):
            i = which[c]
            for side in range(2):
                by = steps[c] if side == 0 else -steps[c]
                moved[i] = theta[i] + by
                if alone[c]:
                    _moved_alone(i, t, X, by, changed, space[side], scratch)
                else:
                    extended_rhs(t, X, changed, space[side], spare)
            moved[i] = theta[i]
            for j in range(n):
                out[k, j, c] = (space[0, j] - space[1, j]) / (2.0 * steps[c])
    return out


@njit(cache=True, error_model="numpy")
def _forced(
    whole: FloatArray, half: FloatArray, forcing: FloatArray, start: FloatArray, fine_s: float
) -> FloatArray:
    """Return the linearised answer of the state at the samples, shape (n, n_X, c).

    The forcing, of shape (FINE·(n − 1) + 1, n_X, c), is what is added to dX/dt, and the start, of
    shape (n_X, c), its change; one column a change.
    """
    steps, n = whole.shape[0], whole.shape[1]
    n_c = start.shape[1]
    out = np.empty((steps // 2 + 1, n, n_c))
    now, after = start.copy(), np.empty((n, n_c))
    out[0] = now
    third = 2.0 * fine_s / 6.0
    for k in range(steps):
        for i in range(n):
            for c in range(n_c):
                total = third * forcing[2 * k + 2, i, c]
                for j in range(n):
                    total += whole[k, i, j] * (now[j, c] + third * forcing[2 * k, j, c])
                    total += half[k, i, j] * 4.0 * third * forcing[2 * k + 1, j, c]
                after[i, c] = total
        now, after = after, now
        if k % 2 == 1:
            out[k // 2 + 1] = now
    return out


@njit(cache=True, error_model="numpy")
def _along(
    states: FloatArray, begun: FloatArray, changed: System, unchanged: System
) -> tuple[FloatArray, FloatArray]:
    """Return what a change adds to dX/dt and to the outputs along a run that lacks it.

    Begun holds where the state of a new effect begins; it is empty for one that has none.
    """
    theta, ints = changed[0], changed[1]
    m, n = states.shape
    n_y, fine_s = ints[5], unchanged[4][1] / FINE
    forcing, direct = np.empty((m, n)), np.empty(((m - 1) // FINE + 1, n_y))
    X, y, y_base = np.empty(n + begun.size), np.empty(n_y), np.empty(n_y)
    X[n:] = begun
    dX, base = np.empty(X.size), np.empty(n)
    scratch, own_scratch = scratch_for(unchanged[1]), scratch_for(ints)
    for k in range(m):
        t = k * fine_s
        X[:n] = states[k]
        extended_rhs(t, X, changed, dX, own_scratch)
        extended_rhs(t, states[k], unchanged, base, scratch)
        forcing[k] = dX[:n] - base
        if k % FINE == 0:
            extended_output(t, X, changed, y, own_scratch)
            extended_output(t, states[k], unchanged, y_base, scratch)
            direct[k // FINE] = y - y_base
        if begun.size:
            X[n] += fine_s * dX[n]
            # A hysteresis stays within its bounds; other states of effects are readings.
            if ints[HEAD + ROW * (ints[7] - 1)] == 10:
                most = 2.0 / max(1.0 + theta[theta.size - SLOTS + 2], 0.1)
                X[n] = min(max(X[n], -most), most)
    return forcing, direct


@njit(cache=True, error_model="numpy")
def _output_slopes(
    states: FloatArray,
    moved_states: FloatArray,
    system: System,
    which: IntArray,
    steps: FloatArray,
    scale: FloatArray,
) -> FloatArray:
    """Return how the outputs answer at the samples: through the state, and to θ directly.

    The first columns of the moved states, of shape (n, n_X, c), stand for numbers of θ.
    """
    theta, ints, floats, pieces, clock = system
    n, n_x, n_c = moved_states.shape
    n_y = ints[5]
    out = np.zeros((n, n_y, n_c))
    above, below = np.empty(n_y), np.empty(n_y)
    X, moved, scratch = np.empty(n_x), theta.copy(), scratch_for(ints)
    changed = (moved, ints, floats, pieces, clock)
    for k in range(n):
        t = k * clock[1]
        X[:] = states[FINE * k]
        for i in range(n_x):
            value = X[i]
            step = RELATIVE_STEP * (abs(value) + scale[i])
            X[i] = value + step
            extended_output(t, X, system, above, scratch)
            X[i] = value - step
            extended_output(t, X, system, below, scratch)
            X[i] = value
            for j in range(n_y):
                slope = (above[j] - below[j]) / (2.0 * step)
                for c in range(n_c):
                    out[k, j, c] += slope * moved_states[k, i, c]
        for c in range(which.size):
            i = which[c]
            moved[i] = theta[i] + steps[c]
            extended_output(t, X, changed, above, scratch)
            moved[i] = theta[i] - steps[c]
            extended_output(t, X, changed, below, scratch)
            moved[i] = theta[i]
            for j in range(n_y):
                out[k, j, c] += (above[j] - below[j]) / (2.0 * steps[c])
    return out
