"""How visible an effect is: what is left of it once the model without it is fitted again."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar

from comparisons.rig.coefficient_effects import FORMS
from comparisons.rig.coefficient_plant import Plant, lay_grid
from comparisons.rig.coefficient_runs import constant_lag, run_record
from surge_core.types import FloatArray, IntArray

__all__ = ["BaseRefit", "size_effect"]


# The part of the first records that a model is fitted to; the rest is held out.
_TRAIN_SHARE = 0.6
_TRAIN_RECORDS = 2
_SUBSTEPS = 2
# ln τ of the refit is looked for this far to either side.
_LOG_TAU_REACH = 1.5
_TAU_TOLERANCE = 1e-5
_SIZE_TOLERANCE = 1e-3
_MAX_TRIALS = 25


class BaseRefit:
    """Output-error fit of τ and of a polynomial characteristic to the noise-free start of a test.

    Parameters
    ----------
    plant : Plant
        The test.
    times_s : tuple of ndarray
        Samples of every record on the facility clock, in seconds; the first 60 % of the first two
        are fitted.
    degree : int
        Degree of the polynomial.
    """

    def __init__(self, plant: Plant, times_s: tuple[FloatArray, ...], degree: int) -> None:
        self.plant = plant
        self._degree = degree
        self._times_s = [t[: max(int(_TRAIN_SHARE * t.size), 2)] for t in times_s[:_TRAIN_RECORDS]]

    def excess(self, planted: Mapping[str, Mapping[str, float]]) -> float:
        """Return the rms of what effects, by name with their parameters, leave after the refit."""
        runs = [
            run_record(self.plant, i, t, planted, substeps=_SUBSTEPS)
            for i, t in enumerate(self._times_s)
        ]
        psi = np.concatenate(runs)
        found = minimize_scalar(
            lambda x: float(np.sum(self._left(psi, np.exp(x)) ** 2)),
            bounds=np.log(self.plant.tau_s) + np.array([-_LOG_TAU_REACH, _LOG_TAU_REACH]),
            method="bounded",
            options={"xatol": _TAU_TOLERANCE},
        )
        return float(np.sqrt(np.mean(self._left(psi, float(np.exp(found.x))) ** 2)))

    @cached_property
    def _inputs(self) -> list[tuple[FloatArray, list[FloatArray], IntArray]]:
        """Steps, powers of φ from the first on, and samples of each record."""
        grids = [
            lay_grid(self.plant, i, t, substeps=_SUBSTEPS) for i, t in enumerate(self._times_s)
        ]
        powers = range(1, self._degree + 1)
        return [
            (grid.step_s, [np.ascontiguousarray(grid.phi**k) for k in powers], grid.samples)
            for grid in grids
        ]

    def _left(self, psi: FloatArray, tau_s: float) -> FloatArray:
        """Return what the best polynomial leaves at a time constant; a constant needs no lag."""
        columns = [np.ones_like(psi)]
        for k in range(self._degree):
            parts = [
                constant_lag(step_s, powers[k], tau_s, float(powers[k][0, 0]))[samples]
                for step_s, powers, samples in self._inputs
            ]
            columns.append(np.concatenate(parts))
        orthogonal, _ = np.linalg.qr(np.column_stack(columns))
        return np.asarray(psi - orthogonal @ (orthogonal.T @ psi))


def size_effect(
    refit: BaseRefit,
    name: str,
    rng: np.random.Generator,
    *,
    strength: float,
    sigma: float,
) -> tuple[dict[str, float], float]:
    """Draw an effect and give it a strength.

    Parameters
    ----------
    refit : BaseRefit
        The model without it, on the test that it is planted in.
    name : str
        The effect.
    rng : Generator
        Source of its other parameters.
    strength : float
        Rms of what is left after the refit, in sigma.
    sigma : float
        Standard deviation of the noise.

    Returns
    -------
    dict of str to float
        All its parameters.
    float
        Strength reached, in sigma: less than asked only where the effect cannot be made so large.
    """
    form, plant = FORMS[name], refit.plant
    others = form.draw(plant, rng)
    sign = 1.0 if not form.signed or rng.random() < 0.5 else -1.0
    limit = form.limit(plant)

    def parameters(size: float) -> dict[str, float]:
        return {form.size: sign * size, **others}

    if strength == 0.0:
        return parameters(0.0), 0.0
    # What is left grows nearly in proportion to the size, and always with it.
    size, low, high = min(form.guess(plant), limit), 0.0, limit
    for _ in range(_MAX_TRIALS):
        reached = refit.excess({name: parameters(size)}) / sigma
        if abs(reached / strength - 1.0) < _SIZE_TOLERANCE:
            break
        if reached < strength:
            low = size
            if size >= limit:
                break
        else:
            high = size
        proposed = size * strength / max(reached, 1e-3 * strength)
        if not low < proposed < high:
            # A limit not yet known to be too large answers itself whether it can be reached.
            proposed = limit if high >= limit else 0.5 * (low + high)
        size = proposed
    return parameters(size), reached
