"""Candidate terms of the closed loop: products of powers of φ, ψ' and the plenum pressure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surge_core.types import FloatArray, IndexArray

__all__ = ["STATES", "StateTerms", "surge_library"]


# The states of the loop, in the order of every array of states.
STATES = ("phi", "psi_p", "plenum")

# A term is a product of powers of these. The last two are functions of one state each: the flow
# through a throttle, in the direction of the pressure, and the flow while it is reversed.
_FACTORS = (*STATES, "sqrt(plenum)", "phi[phi<0]")
_ROOT, _REVERSED = 3, 4


@dataclass(frozen=True)
class StateTerms:
    """Terms of the three states, each a product of powers.

    Parameters
    ----------
    exponents : ndarray of int of shape (n_terms, 5)
        Powers of φ, ψ', Ψ, sign(Ψ) √|Ψ| and min(φ, 0).
    """

    exponents: IndexArray

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each term, e.g. ``1``, ``phi^2 psi_p``, ``phi^2[phi<0]``."""
        return tuple(_name(row) for row in self.exponents)

    def __len__(self) -> int:
        return len(self.exponents)

    def subset(self, chosen: Sequence[int]) -> StateTerms:
        """Return some of the terms, in the order given."""
        return StateTerms(self.exponents[list(chosen)])

    def values(self, states: FloatArray) -> FloatArray:
        """Evaluate the terms: states (..., 3) to values (..., n_terms)."""
        phi, _, plenum = states.T
        root = np.copysign(np.sqrt(np.abs(plenum)), plenum)
        result = np.ones((len(self), *phi.shape))
        factors = (*states.T, root, np.minimum(phi, 0.0))
        for factor, powers in zip(factors, self.exponents.T, strict=True):
            for degree in range(1, powers.max() + 1):
                result[powers >= degree] *= factor
        return result.T


def _name(exponents: IndexArray) -> str:
    parts = []
    for factor, power in zip(_FACTORS, exponents.tolist(), strict=True):
        if power:
            head, bracket, tail = factor.partition("[")
            parts.append(head + (f"^{power}" if power > 1 else "") + bracket + tail)
    return " ".join(parts) or "1"


def surge_library() -> StateTerms:
    """Build the 15 candidate terms, one list for all three equations.

    Quadratic polynomials of the three states (pysindy's `PolynomialLibrary`), powers of φ up to
    the fifth for the characteristic, φ² of reversed flow, and √Ψ for the throttle.
    """
    from pysindy.feature_library import PolynomialLibrary

    products = PolynomialLibrary(degree=2).fit(np.zeros((2, len(STATES)))).powers_
    unit = np.eye(len(_FACTORS), dtype=np.intp)
    higher = [power * unit[0] for power in (3, 4, 5)]
    special = [2 * unit[_REVERSED], unit[_ROOT]]
    return StateTerms(np.vstack((products @ unit[:3], *higher, *special)).astype(np.intp))
