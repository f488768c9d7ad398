"""How visible an effect is: what is left of it once the model without it is fitted again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize_scalar

from comparisons.rig.coefficient_effects import FORMS
from comparisons.rig.coefficient_kernels import constant_lag
from comparisons.rig.coefficient_plant import Plant, Points, lay_grid
from comparisons.rig.coefficient_runs import run_record
from surge_core.types import FloatArray

__all__ = ["BaseRefit", "Sized", "size_effect"]


# The part of the first records that a model is fitted to; the rest is held out.
_TRAIN_SHARE = 0.6
_TRAIN_RECORDS = 2
_SUBSTEPS = 2
# ln τ of the refit is looked for this far to either side.
_LOG_TAU_REACH = 1.5
_TAU_TOLERANCE = 1e-5
_SIZE_TOLERANCE = 1e-3
_MAX_TRIALS = 25


@dataclass(frozen=True)
class Sized:
    """An effect of the strength that was asked for.

    Parameters
    ----------
    parameters : mapping of str to float
        All its parameters.
    strength : float
        Strength reached, in sigma: less than asked only where the effect cannot be made so large.
    """

    parameters: Mapping[str, float]
    strength: float


@dataclass(frozen=True)
class BaseRefit:
    """Output-error fit of τ and of a polynomial characteristic to the noise-free start of a test.

    Parameters
    ----------
    plant : Plant
        The test.
    times_s : tuple of ndarray
        Samples of every record on the facility clock, in seconds.
    degree : int
        Degree of the polynomial.
    """

    plant: Plant
    times_s: tuple[FloatArray, ...]
    degree: int

    @cached_property
    def train_times_s(self) -> tuple[FloatArray, ...]:
        """First 60 % of the first two records."""
        return tuple(t[: max(int(_TRAIN_SHARE * t.size), 2)] for t in self.times_s[:_TRAIN_RECORDS])

    @cached_property
    def _grids(self) -> tuple[Points, ...]:
        return tuple(
            lay_grid(self.plant, i, t, substeps=_SUBSTEPS) for i, t in enumerate(self.train_times_s)
        )

    @cached_property
    def _powers(self) -> tuple[tuple[FloatArray, ...], ...]:
        """Powers of φ from the first on, of each record; those of the constant need no lag."""
        return tuple(
            tuple(np.ascontiguousarray(grid.phi**k) for k in range(1, self.degree + 1))
            for grid in self._grids
        )

    def run(self, planted: Mapping[str, Mapping[str, float]]) -> FloatArray:
        """Simulate the rows that are fitted, with these effects.

        Parameters
        ----------
        planted : mapping of str to mapping
            Parameters of each effect, by name.

        Returns
        -------
        ndarray of shape (n,)
            ψ' of the rows, one record after the other.
        """
        return np.concatenate(
            [
                run_record(self.plant, i, t, planted, substeps=_SUBSTEPS)
                for i, t in enumerate(self.train_times_s)
            ]
        )

    def residual(self, psi: FloatArray) -> tuple[FloatArray, float]:
        """Fit the base model.

        Parameters
        ----------
        psi : ndarray of shape (n,)
            ψ' of the rows of `run`.

        Returns
        -------
        residual : ndarray of shape (n,)
            What the best base model leaves of it.
        tau_s : float
            Time constant of that model, in seconds.
        """
        found = minimize_scalar(
            lambda x: float(np.sum(self._left(psi, np.exp(x)) ** 2)),
            bounds=np.log(self.plant.tau_s) + np.array([-_LOG_TAU_REACH, _LOG_TAU_REACH]),
            method="bounded",
            options={"xatol": _TAU_TOLERANCE},
        )
        tau_s = float(np.exp(found.x))
        return self._left(psi, tau_s), tau_s

    def _left(self, psi: FloatArray, tau_s: float) -> FloatArray:
        columns = [np.ones_like(psi)]
        for k in range(self.degree):
            parts = [
                constant_lag(grid.step_s, powers[k], tau_s, float(powers[k][0, 0]))[grid.samples]
                for grid, powers in zip(self._grids, self._powers, strict=True)
            ]
            columns.append(np.concatenate(parts))
        orthogonal, _ = np.linalg.qr(np.column_stack(columns))
        return psi - orthogonal @ (orthogonal.T @ psi)

    def excess(self, planted: Mapping[str, Mapping[str, float]]) -> float:
        """Return the rms of what effects leave after the refit."""
        residual, _ = self.residual(self.run(planted))
        return float(np.sqrt(np.mean(residual**2)))


def size_effect(
    refit: BaseRefit,
    name: str,
    rng: np.random.Generator,
    *,
    strength: float,
    sigma: float,
) -> Sized:
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
    Sized
        The effect, alone in its test.
    """
    form, plant = FORMS[name], refit.plant
    others = form.draw(plant, rng)
    sign = 1.0 if not form.signed or rng.random() < 0.5 else -1.0
    limit = form.limit(plant)

    def parameters(size: float) -> dict[str, float]:
        return {form.size: sign * size, **others}

    if strength == 0.0:
        return Sized(parameters(0.0), 0.0)
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
        size = proposed if low < proposed < high else _between(low, high, limit)
    return Sized(parameters(size), reached)


def _between(low: float, high: float, limit: float) -> float:
    if high >= limit:
        # Not yet known to be too large: the limit itself answers whether it can be reached.
        return limit
    return 0.5 * (low + high)
