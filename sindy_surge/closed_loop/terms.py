"""Candidate terms of the closed loop: products of powers of φ, ψ' and the plenum pressure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from surge_core.errors import InputError
from surge_core.types import FloatArray, IndexArray

__all__ = ["STATES", "StateTerms", "surge_library"]


# The states of the loop, in the order of every array of states.
STATES = ("phi", "psi_p", "plenum")

# A term is a product of powers of these. The last two are functions of one state each: the flow
# through a throttle, in the direction of the pressure, and the flow while it is reversed.
_FACTORS = (*STATES, "sqrt(plenum)", "phi[phi<0]")
_ROOT, _REVERSED = 3, 4
# The state that each factor is a function of.
_STATE_OF = (0, 1, 2, 2, 0)
# The slope of the root is bounded where the pressure passes through zero.
_LEAST_ROOT = 1e-4


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

    @cached_property
    def _used(self) -> tuple[int, ...]:
        """Factors that occur in any term."""
        return tuple(np.flatnonzero(self.exponents.any(axis=0)).tolist())

    @cached_property
    def _degree(self) -> int:
        """Highest power of any factor."""
        return max(int(self.exponents.max(initial=1)), 1)

    def __len__(self) -> int:
        return len(self.exponents)

    def subset(self, chosen: tuple[int, ...]) -> StateTerms:
        """Return some of the terms, in the order given."""
        return StateTerms(self.exponents[list(chosen)])

    def values(self, states: FloatArray) -> FloatArray:
        """Evaluate the terms.

        Parameters
        ----------
        states : ndarray of shape (..., 3)
            φ, ψ' and Ψ.

        Returns
        -------
        ndarray of shape (..., n_terms)
            The terms.
        """
        powers = _powers(states.reshape(-1, len(STATES)), self._degree)
        return self._product(powers).T.reshape(*states.shape[:-1], len(self))

    def values_and_slopes(self, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Evaluate the terms and their derivatives with respect to the states.

        Parameters
        ----------
        states : ndarray of shape (n_points, 3)
            φ, ψ' and Ψ.

        Returns
        -------
        values : ndarray of shape (n_points, n_terms)
            The terms.
        slopes : ndarray of shape (n_points, n_terms, 3)
            Their derivatives.
        """
        powers = _powers(states, self._degree)
        derived = np.zeros_like(powers)
        derived[1:] = np.arange(1, len(powers))[:, None, None] * powers[:-1]
        slopes = np.zeros((len(STATES), len(self), len(states)))
        for factor in self._used:
            slope = self._product(powers, derived, factor)
            if factor == _ROOT:
                slope *= 0.5 / np.maximum(np.abs(powers[1, _ROOT]), _LEAST_ROOT)
            elif factor == _REVERSED:
                slope *= states[:, 0] < 0
            slopes[_STATE_OF[factor]] += slope
        return self._product(powers).T, slopes.T

    def _product(
        self, powers: FloatArray, derived: FloatArray | None = None, by: int = -1
    ) -> FloatArray:
        """Multiply the powers of each term; the factor `by` is taken from `derived`."""
        result = np.ones((len(self), powers.shape[-1]))
        for factor in self._used:
            source = powers if derived is None or factor != by else derived
            result *= source[self.exponents[:, factor], factor]
        return result


def _powers(states: FloatArray, highest: int) -> FloatArray:
    """Return the powers 0 to `highest` of all factors: (power, factor, point)."""
    powers = np.ones((highest + 1, len(_FACTORS), len(states)))
    factors = powers[1]
    factors[:3] = states.T
    factors[_ROOT] = np.copysign(np.sqrt(np.abs(factors[2])), factors[2])
    factors[_REVERSED] = np.minimum(factors[0], 0.0)
    for degree in range(2, highest + 1):
        powers[degree] = powers[degree - 1] * factors
    return powers


def _name(exponents: IndexArray) -> str:
    parts = []
    for factor, power in zip(_FACTORS, exponents.tolist(), strict=True):
        if power:
            head, bracket, tail = factor.partition("[")
            parts.append(head + (f"^{power}" if power > 1 else "") + bracket + tail)
    return " ".join(parts) or "1"


def surge_library(degree: int = 2, flow_degree: int = 5) -> StateTerms:
    """Build the candidate terms, one list for all three equations.

    Polynomials of the three states (pysindy's `PolynomialLibrary`), higher powers of φ for the
    characteristic, φ² of reversed flow, and √Ψ for the throttle: 15 terms by default.

    Parameters
    ----------
    degree : int
        Highest total degree of the products of the states, at least 1.
    flow_degree : int
        Highest power of φ alone.

    Returns
    -------
    StateTerms
        The library.

    Raises
    ------
    InputError
        If `degree` is less than 1.
    """
    from pysindy.feature_library import PolynomialLibrary

    if degree < 1:
        raise InputError("degree", expected="at least 1", found=f"{degree}")

    polynomials = PolynomialLibrary(degree=degree).fit(np.zeros((2, len(STATES))))
    products = np.zeros((len(polynomials.powers_), len(_FACTORS)), dtype=np.intp)
    products[:, :3] = polynomials.powers_
    higher = np.zeros((max(flow_degree - degree, 0), len(_FACTORS)), dtype=np.intp)
    higher[:, 0] = np.arange(degree + 1, degree + 1 + len(higher))
    special = np.zeros((2, len(_FACTORS)), dtype=np.intp)
    special[0, _REVERSED] = 2
    special[1, _ROOT] = 1
    return StateTerms(np.vstack((products, higher, special)))
