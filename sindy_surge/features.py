"""Values and slopes of the terms where φ carries noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sindy_surge.lag_problem import LagProblem
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
