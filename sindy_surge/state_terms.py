"""Candidate terms that hold ψ' itself: its powers and its products with φ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import comb
from typing import NamedTuple

import numpy as np

from sindy_surge.library import power_name
from surge_core.types import FloatArray

# ψ'², ψ'φ, ψ'φ²: the ones that take over when the lag is not linear, and the fingerprint of
# a time shift between the channels.
_OWN_POWERS = (2,)
_PRODUCT_POWERS = (1, 2)


@dataclass(frozen=True)
class ProductStateTerms:
    """Powers of z = (ψ' - centre)/scale and its products with powers of the inputs.

    ψ' runs from 0.35 to 0.53 in a surge record, over which 1, ψ', ψ'² and ψ'³ are all but
    collinear; z runs from -1 to 1.
    """

    names: tuple[str, ...]  # Names in terms of ψ' itself, e.g. ``psi_p^2`` or ``psi_p phi``
    # For each term the power of z, the input and its power
    exponents: tuple[tuple[int, int, int], ...]
    centre: float  # Middle and half range of ψ'
    scale: float

    @classmethod
    def of(
        cls,
        psi_p: FloatArray,
        input_names: Sequence[str],
        output_name: str,
        known: Sequence[str],
    ) -> ProductStateTerms:
        """Make the terms for the range of ψ', beside the terms `known` of the inputs."""
        names = [f"{output_name}^{power}" for power in _OWN_POWERS]
        exponents = [(power, 0, 0) for power in _OWN_POWERS]
        for j, name in enumerate(input_names):
            for power in _PRODUCT_POWERS:
                names.append(f"{output_name} {power_name(name, power)}")
                exponents.append((1, j, power))
        low, high = float(np.min(psi_p)), float(np.max(psi_p))
        centre, scale = (high + low) / 2, (high - low) / 2
        if not scale > 1e-9 * max(abs(low), abs(high)):
            centre, scale = 0.0, max(abs(low), abs(high)) or 1.0
        # Products about the centre are the same model only beside what they expand to.
        needed = {
            "1",
            *(power_name(name, power) for name in input_names for power in _PRODUCT_POWERS),
        }
        return cls(tuple(names), tuple(exponents), centre if needed <= set(known) else 0.0, scale)

    def __call__(self, X: FloatArray, psi_p: FloatArray) -> FloatArray:
        """Evaluate every term in z: X (n_rows, n_inputs), ψ' (n_rows,) to (n_rows, n_terms)."""
        z = (psi_p - self.centre) / self.scale
        columns = np.empty((z.size, len(self.exponents)), order="F")
        for number, (own, j, power) in enumerate(self.exponents):
            columns[:, number] = z**own * X[:, j] ** power
        return columns

    def physical(self) -> ProductStateTerms:
        """Return the same terms in ψ' itself."""
        return replace(self, centre=0.0, scale=1.0)


class PhysicalForm(NamedTuple):
    """A model τ dψ'/dt + ψ' = Σ β_i s_i in physical units; the covariance of β and, last, τ."""

    names: tuple[str, ...]
    coefficients: FloatArray
    time_constant_s: float
    covariance: FloatArray


def physical_form(
    names: Sequence[str],
    coefficients: FloatArray,
    time_constant_s: float,
    covariance: FloatArray,
    states: ProductStateTerms | None,
    input_names: Sequence[str],
) -> PhysicalForm:
    """Write a model that was found in z = (ψ' - c)/s in ψ' itself.

    γ z^p φ^q expands to γ s^-p Σ_i C(p, i) (-c)^(p-i) ψ'^i φ^q. What falls to ψ' itself, L ψ',
    joins the lag: τ dψ'/dt + (1 - L) ψ' = …, which is divided by 1 - L. The covariance is that of
    the coefficients, those of terms with ψ' in z, and, last, τ.
    """
    if states is None or not set(names) & set(states.names):
        return PhysicalForm(tuple(names), coefficients, time_constant_s, covariance)
    # Rows of the map: physical terms; its last row is the share L of ψ' itself.
    rows: dict[str, FloatArray] = {}
    lag_share = np.zeros(len(names))

    def add(name: str, number: int, value: float) -> None:
        if value != 0.0:
            rows.setdefault(name, np.zeros(len(names)))[number] += value

    output = states.names[0].partition("^")[0]
    for number, name in enumerate(names):
        if name not in states.names:
            add(name, number, 1.0)
            continue
        power, j, q = states.exponents[states.names.index(name)]
        factor = power_name(input_names[j], q) if q else ""
        for i in range(power + 1):
            value = comb(power, i) * (-states.centre) ** (power - i) / states.scale**power
            if i == 0:
                add(factor or "1", number, value)
            elif i == 1 and not factor:
                lag_share[number] += value
            else:
                add(f"{power_name(output, i)} {factor}".strip(), number, value)
    matrix = np.array(list(rows.values()))
    whole = 1.0 - float(lag_share @ coefficients)
    numerators = matrix @ coefficients
    beta, tau = numerators / whole, time_constant_s / whole
    # d(numerator/whole) = (dn + (n/whole) L·dγ)/whole.
    top = (matrix + np.outer(beta, lag_share)) / whole
    bottom = np.append(tau * lag_share, 1.0) / whole
    jacobian = np.vstack((np.column_stack((top, np.zeros(len(rows)))), bottom))
    return PhysicalForm(tuple(rows), beta, tau, jacobian @ covariance @ jacobian.T)
