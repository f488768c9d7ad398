"""A run linearised: how its outputs answer to small changes of numbers, starts and structure.

The transition matrices are exponentials (Magnus, fourth order) on two steps a sample; a change is
a forcing that they carry on. Runs are on the fine grid, of shape (FINE·(n − 1) + 1, n_X).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from comparisons.missing_effect.systems.dynamics import System, along, answers
from comparisons.missing_effect.systems.places import Placed
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.simulate import FINE, Path, black_box_path, own_starts
from comparisons.missing_effect.systems.structure import Run, Structure
from surge_core.types import FloatArray, IntArray

RELATIVE_STEP = 1e-6
# Sizes that matrices are scaled to before their exponential, and beyond which there is none.
SCALED, RAN_AWAY = 0.25, 1e12
# Amplitude at which an effect that is linear in it, but no term, is laid along the run.
SMALL = 1e-4
# Steps of differences of a black box over those of a model that is integrated here: what runs
# within it rounds as it likes.
BLACK_BOX_STEP = 100.0

# What runs away is found by its numbers, which are no numbers then.
QUIET = np.errstate(invalid="ignore", over="ignore")
# No state of an effect that the run has not.
NONE = np.zeros(0)
Laid = tuple[Placed, tuple[float, ...]]


@dataclass(frozen=True, eq=False)
class Linearised:
    """A run, and how its outputs answer to small changes.

    ``path`` is the run at ``theta``, and ``scale`` the size of each state, for differences.
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
    def _answers(self) -> tuple[FloatArray, FloatArray]:
        """How slopes and outputs answer to each state, in its own unit; one for all if alike."""
        states, n = self.path.states, self.path.states.shape[1]
        steps = RELATIVE_STEP * (np.abs(states) + self.scale)
        # Neighbours move against each other, none as far as another.
        shares = (0.5 + 0.618 * np.arange(n) % 1.0) * (-1.0) ** np.arange(n)
        return answers(states, steps, shares, self.system, FINE)

    @cached_property
    @QUIET
    def transitions(self) -> tuple[FloatArray, FloatArray] | None:
        """Transition matrices over whole and second half steps, one for all if alike.

        In units of the scale the exponentials need few squarings. A black box has none.
        """
        if self.structure.model.simulate is not None:
            return None
        units, step_s = self.scale[:, None] / self.scale, 2.0 * self.run.sample_period_s / FINE
        slopes = self._answers[0] / units
        slopes = slopes if len(slopes) > 1 else np.repeat(slopes, 3, axis=0)
        first, middle, last = slopes[:-1:2], slopes[1::2], slopes[2::2]
        mean = (first + 4.0 * middle + last) / 6.0
        twist = (last @ first - first @ last) / 12.0
        whole = _exponentials(mean * step_s + twist * step_s**2)
        return whole * units, _exponentials((middle + last) * (0.25 * step_s)) * units

    @QUIET
    def to_numbers(self, which: IntArray) -> FloatArray:
        """Return how the outputs answer to numbers of θ, and then to the starts estimated.

        Of shape (n, n_y, m + k), and not a number where the run has no reading.
        """
        up, down = (steps[which] for steps in self.structure.steps(self.theta))
        if self.transitions is None:
            return self._read(self._differences(which, up))
        (rows, n_X), m = self.path.states.shape, which.size
        starts = np.eye(n_X)[:, self.structure.started]
        forcing = np.zeros((rows, n_X, m))
        direct = np.zeros((*self.run.outputs.shape, m + starts.shape[1]))

        def at(number: int, step: float) -> tuple[FloatArray, FloatArray]:
            theta = self.theta.copy()
            theta[number] += step
            system = self.run.system(self.structure, theta)
            slopes, seen = along(self.path.states, NONE, system, FINE)
            return slopes, self.structure.recorded(seen, theta)

        here = at(0, 0.0)
        for c, number in enumerate(which):
            other = at(number, -down[c]) if down[c] else here
            forcing[:, :, c], direct[:, :, c] = (
                (b - a) / (up[c] + down[c]) for a, b in zip(other, at(number, up[c]), strict=True)
            )
        return self._carried(forcing, np.hstack([np.zeros((n_X, m)), starts]), direct)

    @QUIET
    def to_effects(self, laid: Sequence[Laid]) -> FloatArray:
        """Return how the outputs would answer to each of some effects, to first order.

        They come with their numbers, of which an amplitude is replaced by a small one. Of shape
        (n, n_y, effects), and not a number where the run has no reading.
        """
        states, black_box = self.path.states, self.transitions is None
        direct = np.zeros((*self.run.outputs.shape, len(laid)))
        forcing = np.zeros((*states.shape, len(laid)))
        unchanged = 0.0 if black_box else along(states, NONE, self.system, FINE)[0]
        for c, (placed, start) in enumerate(laid):
            extended, linear = self.structure.with_effect(placed), placed.effect.linear
            size = SMALL if linear and placed.effect.kind != Kind.TERM else 1.0
            numbers = (size, *start[1:]) if linear else start
            theta = np.concatenate([self.theta, extended.slots(numbers)])
            if black_box:
                seen = black_box_path(extended, self.run, theta, states[0]).outputs
            else:
                own = own_starts(extended, self.run, states[0])[states.shape[1] :]
                slopes, seen = along(states, own, self.run.system(extended, theta), FINE)
                forcing[:, :, c] = (slopes - unchanged) / size
                seen = extended.recorded(seen, theta)
            direct[:, :, c] = (seen - self.path.outputs) / size
        if black_box:
            return self._read(direct)
        return self._carried(forcing, np.zeros(forcing.shape[1:]), direct)

    def growth(self) -> float:
        """Return by how many powers of e changes of the state grow along the run, at most."""
        # A black box does not say how its states change.
        if self.transitions is None:
            return 0.0
        units = self.scale[:, None] / self.scale
        return float(_growth(self.transitions[0] / units, len(self.path.states) // 2))

    def _carried(self, forcing: FloatArray, start: FloatArray, direct: FloatArray) -> FloatArray:
        """Return the outputs' answers to what is added to dX/dt, to the start, and to them."""
        assert self.transitions is not None
        fine_s = self.run.sample_period_s / FINE
        moved = self._answers[1] @ _forced(*self.transitions, forcing, start, fine_s)
        return self._read(self.structure.recorded(moved, self.theta) + direct)

    def _read(self, columns: FloatArray) -> FloatArray:
        """Return columns that are not a number where the run has no reading."""
        columns[~self.run.valid] = np.nan
        return columns

    def _differences(self, which: IntArray, steps: FloatArray) -> FloatArray:
        """Return how a black box answers to each parameter, and to those of its record."""
        both, n = np.r_[self.theta, self.path.states[0]], self.theta.size
        ranges = [p.high - p.low for p in self.structure.model.per_record.values()]
        steps = np.r_[BLACK_BOX_STEP * steps, SMALL * np.array(ranges)]
        out = np.zeros((*self.run.outputs.shape, steps.size))
        for c, (i, step) in enumerate(zip([*which, *range(n, both.size)], steps, strict=True)):
            for side in (0.5, -0.5):
                moved = both + 2.0 * side * step * (np.arange(both.size) == i)
                path = black_box_path(self.structure, self.run, moved[:n], moved[n:])
                out[:, :, c] += side * path.outputs / step
        return out


def _exponentials(matrices: FloatArray) -> FloatArray:
    """Return the exponentials of small matrices: scaling, eight terms of the series, squaring.

    Products of many small matrices cost a fifth of as many solutions: of 16 states, 10 ms for 50.
    """
    size = np.max(np.sum(np.abs(matrices), axis=2), axis=1)
    gone = ~(size < RAN_AWAY)
    halvings = np.ceil(np.log2(np.maximum(np.where(gone, SCALED, size) / SCALED, 1.0)))
    A = np.where(gone[:, None, None], 0.0, matrices) * 0.5 ** halvings[:, None, None]
    square, one = A @ A, np.eye(A.shape[1])
    cube = square @ A
    out = cube @ (one / 6.0 + A / 24.0 + square / 120.0 + cube / 720.0 + square @ square / 5040.0)
    out += square / 2.0 + A + one
    for done in range(int(np.max(halvings, initial=0.0))):
        again = halvings > done
        out[again] = out[again] @ out[again]
    out[gone] = np.nan
    return out


@njit(cache=True, error_model="numpy")
def _growth(whole: FloatArray, steps: int) -> float:
    """Return the log of the largest size of the products of matrices, step by step."""
    change, size, most = np.eye(whole.shape[1]), 0.0, 0.0
    for k in range(steps):
        change = whole[k % len(whole)] @ change
        norm = np.sqrt(np.sum(change**2))
        if not 0.0 < norm < np.inf:
            break
        change, size = change / norm, size + np.log(norm)
        most = max(most, size)
    return most


@njit(cache=True, error_model="numpy")
def _forced(
    whole: FloatArray, half: FloatArray, forcing: FloatArray, start: FloatArray, fine_s: float
) -> FloatArray:
    """Return the linearised answer of the state at the samples, shape (n, n_X, c).

    The start, of shape (n_X, c), is its change, one column a change, and the forcing, of shape
    (FINE·(n − 1) + 1, n_X, c or fewer), what the first of them add to dX/dt.
    """
    steps, n = forcing.shape[0] // 2, start.shape[0]
    n_c, n_f = start.shape[1], forcing.shape[2]
    out = np.empty((steps // 2 + 1, n, n_c))
    now, after = start.copy(), np.empty((n, n_c))
    out[0] = now
    third = 2.0 * fine_s / 6.0
    for k in range(steps):
        w, h = k % whole.shape[0], k % half.shape[0]
        now[:, :n_f] += third * forcing[2 * k]
        after[:] = 0.0
        after[:, :n_f] = third * forcing[2 * k + 2]
        for i in range(n):
            for j in range(n):
                one, other = whole[w, i, j], half[h, i, j] * 4.0 * third
                for c in range(n_c):
                    after[i, c] += one * now[j, c]
                for c in range(n_f):
                    after[i, c] += other * forcing[2 * k + 1, j, c]
        now, after = after, now
        if k % 2 == 1:
            out[k // 2 + 1] = now
    return out
