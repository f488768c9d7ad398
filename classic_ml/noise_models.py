"""What the fit takes the error of ψ' to be: arx, armax or output error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from surge_core.types import FloatArray

NoiseKind = Literal["arx", "armax", "output-error"]
NOISE_KINDS: tuple[NoiseKind, ...] = ("arx", "armax", "output-error")
MAXIMUM_ORDER = 2


@dataclass(frozen=True)
class MovingAverage:
    """The polynomial C(q) = 1 + c₁q⁻¹ + c₂q⁻² of an armax error, invertible by construction.

    Parameters
    ----------
    free : ndarray of shape (order,)
        Unbounded parameters ρ; the partial coefficients are κ = tanh ρ, and c₁ = κ₁(1 + κ₂),
        c₂ = κ₂ (Barndorff-Nielsen and Schou 1973), so that every ρ gives roots inside the unit
        circle and the whitening filter 1/C never blows up.
    """

    free: FloatArray

    @classmethod
    def from_coefficients(cls, c: FloatArray) -> MovingAverage:
        """Build from c₁ (and c₂), clipped to the invertible region."""
        c = np.asarray(c, dtype=np.float64)
        # tanh(3) = 0.995: a start closer to the unit circle has no gradient left to move by.
        limit = np.tanh(3.0)
        partial = c.copy()
        if c.size == MAXIMUM_ORDER:
            partial[1] = np.clip(c[1], -limit, limit)
            partial[0] = c[0] / (1.0 + partial[1])
        return cls(np.arctanh(np.clip(partial, -limit, limit)))

    @property
    def order(self) -> int:
        """Degree of C."""
        return int(self.free.size)

    @property
    def coefficients(self) -> FloatArray:
        """c₁ … c_order."""
        partial = np.tanh(self.free)
        if self.order == MAXIMUM_ORDER:
            return np.array([partial[0] * (1.0 + partial[1]), partial[1]])
        return np.asarray(partial, dtype=np.float64)

    @property
    def jacobian(self) -> FloatArray:
        """∂c/∂ρ, of shape (order, order)."""
        partial = np.tanh(self.free)
        slope = 1.0 - partial**2
        if self.order == MAXIMUM_ORDER:
            upper = [slope[0] * (1.0 + partial[1]), partial[0] * slope[1]]
            return np.array([upper, [0.0, slope[1]]])
        return np.diag(slope)

    @property
    def largest_root(self) -> float:
        """Largest modulus of the roots of C: how fast the filter 1/C forgets."""
        if self.order < MAXIMUM_ORDER:
            return float(np.max(np.abs(self.coefficients), initial=0.0))
        c1, c2 = self.coefficients
        # Of a complex pair c2 is the squared modulus.
        return float(np.sqrt(c2) if c1**2 < 4.0 * c2 else 0.5 * (abs(c1) + np.sqrt(c1**2 - 4 * c2)))

    def whiten(self, rows: FloatArray) -> FloatArray:
        """Return C(q)⁻¹ of the equation errors of one stretch, of shape (n,) or (n, p)."""
        if self.order == 0 or rows.shape[0] == 0:
            return rows
        from scipy.signal import lfilter

        return np.asarray(lfilter([1.0], [1.0, *self.coefficients], rows, axis=0))

    def reach(self, n_rows: int) -> FloatArray:
        """Return what the errors before a stretch add to its equations, the oldest error first.

        e[0] adds c₁ to the first equation and c₂ to the second, e[-1] adds c₂ to the first.
        """
        from scipy.linalg import toeplitz

        newest_last = self.coefficients[::-1]
        first = np.zeros(n_rows)
        first[:1] = newest_last[:1]
        return np.asarray(toeplitz(first, newest_last))
