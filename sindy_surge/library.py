"""The default candidate terms of ψ'_QS: powers, kinks, the reverse-flow branch, exponentials."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sindy_surge.noise import difference_noise
from sindy_surge.segments import Segments
from surge_core.types import FloatArray

# Highest total degree of the polynomials; less for many inputs.
_DEGREE = 5
# No record of a few thousand rows separates more polynomial terms than this.
_MAX_POLYNOMIAL_TERMS = 70
# Several inputs: the one-variable terms of each are added up to this number of inputs.
_MAX_INPUTS_WITH_OWN_TERMS = 2
_NOISE_REACH = 2.0
_MOST_REACH = 0.05
_FEWEST_TERMS = 15


@dataclass
class StallLibrary:
    """pysindy's polynomials, and terms of a compressor characteristic for each input on its own.

    `relu(phi-k)` is a kink at k (max(φ - k, 0)); `phi^2[phi<0]` the reverse-flow branch; and
    `exp(-phi/s)` the fall of the unstalled line. φ|φ| is left out: it equals φ² - 2 φ²[φ<0], so it
    would be an exact alias. The fits evaluate the library hundreds of times, a few terms at a time,
    hence plain arrays and products in place of powers.

    ``degree`` is the highest total degree of the polynomials; knots k and scales s are one sequence
    for each input, and without them there are polynomials alone.
    """

    degree: int
    knots: Sequence[Sequence[float]] = ()
    scales: Sequence[Sequence[float]] = ()

    def fit(self, X: FloatArray, y: Any = None) -> StallLibrary:
        """List the terms for so many inputs."""
        from pysindy.feature_library import PolynomialLibrary

        self._polynomials = PolynomialLibrary(degree=self.degree).fit(np.zeros((2, X.shape[1])))
        self._powers: NDArray[np.int64] = self._polynomials.powers_
        self._special: list[tuple[int, str, float]] = []
        for j, (knots, scales) in enumerate(zip(self.knots, self.scales, strict=True)):
            self._special += [(j, "hinge", float(k)) for k in knots]
            self._special.append((j, "reverse", 0.0))
            self._special += [(j, "fall", float(s)) for s in scales]
        return self

    def transform(self, X: FloatArray) -> FloatArray:
        """Evaluate all terms: (n_rows, n_inputs) to (n_rows, n_terms)."""
        special = [_SPECIAL[kind][0](X[:, j], value) for j, kind, value in self._special]
        return np.column_stack([monomials(X, self._powers), *special])

    def get_feature_names(self, input_features: Sequence[str]) -> list[str]:
        """Return the names, e.g. ``phi^2`` or ``relu(phi-0.05)``."""
        names: list[str] = self._polynomials.get_feature_names(list(input_features))
        return names + [_SPECIAL[kind][1](input_features[j], v) for j, kind, v in self._special]


def monomials(x: FloatArray, powers: NDArray[np.int64]) -> FloatArray:
    """Return Π_j x_j^p_ij (n_rows, n_terms) of factors (n_rows, n), exponents (n_terms, n)."""
    columns = np.ones((x.shape[0], len(powers)), order="F")
    # Products, one degree after the other: numpy's power takes ten times as long.
    chains = np.ones((int(powers.max(initial=0)) + 1, *x.T.shape))
    for power in range(1, len(chains)):
        np.multiply(chains[power - 1], x.T, out=chains[power])
    for number, exponents in enumerate(powers.tolist()):
        for own, power in enumerate(exponents):
            if power:
                columns[:, number] *= chains[power, own]
    return columns


def power_name(name: str, power: int) -> str:
    """Return the name of a power, e.g. ``phi`` or ``phi^2``."""
    return name if power == 1 else f"{name}^{power}"


def monomial_name(names: Sequence[str], powers: Sequence[int]) -> str:
    """Return the name of a product of powers, e.g. ``1`` or ``psi_p phi^2``."""
    factors = zip(names, powers, strict=True)
    return " ".join(power_name(name, power) for name, power in factors if power) or "1"


def hinge_name(name: str, knot: float) -> str:
    """Return the name of a hinge, e.g. ``relu(phi-0.05)``."""
    if knot == 0:
        return f"relu({name})"
    return f"relu({name}{'-' if knot > 0 else '+'}{abs(knot):.12g})"


# What a term of one input and one number is, and its name.
_SPECIAL: dict[str, tuple[Callable[[FloatArray, float], FloatArray], Callable[..., str]]] = {
    "hinge": (lambda x, knot: np.maximum(x - knot, 0.0), hinge_name),
    "reverse": (lambda x, _: np.square(np.minimum(x, 0.0)), lambda name, _: f"{name}^2[{name}<0]"),
    "fall": (lambda x, s: np.exp(-x / s), lambda name, s: f"exp(-{name}/{s:.12g})"),
}


def default_knots(phi: FloatArray, noise: float = 0.0) -> tuple[float, ...]:
    """Return round numbers inside the range of φ, where a hinge may sit; none if it is constant.

    The step is the largest of 1, 2.5, 5 times a power of ten that is at most a sixth of the range:
    0.05 both for a surge record in stall (-0.03 to 0.27) and for a whole surge cycle (-0.04 to
    0.51). A knot needs two per cent of the samples on either side, beyond the reach of noise, whose
    standard deviation is given: a hinge at the very end of the range fits the errors of its ends.
    """
    step = _round_step(phi)
    if step == 0.0:
        return ()
    # Of a rough excitation differences take most for noise; its range is still its own.
    reach = min(_NOISE_REACH * noise, _MOST_REACH * float(np.ptp(phi)))
    low, high = np.quantile(phi, [0.02, 0.98]) + np.array([reach, -reach])
    first, last = int(np.ceil(low / step)), int(np.floor(high / step))
    digits = max(0, 2 - int(np.floor(np.log10(step))))
    return tuple(
        round(k * step, digits) + 0.0 for k in range(first, last + 1) if low < k * step < high
    )


def _round_step(phi: FloatArray) -> float:
    span = float(np.ptp(phi))
    if not span > 1e-9 * max(float(np.max(np.abs(phi))), 1e-300):
        return 0.0
    target = span / 6 * (1 + 1e-9)
    decade = 10.0 ** np.floor(np.log10(target))
    return float(max(m * decade for m in (1.0, 2.5, 5.0) if m * decade <= target))


def default_library(X: FloatArray) -> StallLibrary:
    """Build the library of candidate terms that suits the ranges of inputs (n_rows, n_inputs).

    Polynomials, hinges, the reverse-flow branch and exponentials: at least 15 terms for one input.
    """
    n_inputs, degree = X.shape[1], _DEGREE
    while degree > 1 and comb(n_inputs + degree, degree) > _MAX_POLYNOMIAL_TERMS:
        degree -= 1
    if n_inputs > _MAX_INPUTS_WITH_OWN_TERMS:
        return StallLibrary(degree)
    each_knots, each_scales = [], []
    for phi in X.T:
        step = _round_step(phi)
        whole = Segments.from_labels(None, phi.size)
        each_knots.append(default_knots(phi, difference_noise(phi, whole)))
        scales = (step, 2 * step) if step else (0.05, 0.1)
        # exp overflows for a range far below zero compared with its own width.
        each_scales.append(tuple(s for s in scales if -float(np.min(phi)) / s < 50))
        missing = _FEWEST_TERMS - (degree + 2 + len(each_knots[-1]) + len(each_scales[-1]))
        if missing > 0:
            each_knots[-1] = _finer(each_knots[-1], phi, missing)
    return StallLibrary(degree, each_knots, each_scales)


def piecewise_linear_library(X: FloatArray) -> StallLibrary:
    """Build the library of piecewise-linear characteristics, as in Fig 22 of the paper.

    1, the inputs (n_rows, n_inputs), their hinges and the reverse-flow branch.
    """
    knots = [default_knots(phi) for phi in X.T]
    return StallLibrary(1, knots, [() for _ in knots])


def _finer(knots: tuple[float, ...], phi: FloatArray, missing: int) -> tuple[float, ...]:
    """Add evenly spread knots, rounded to three digits of the range, until enough are there."""
    low, high = float(np.min(phi)), float(np.max(phi))
    span = high - low if high > low else 1.0
    digits = 3 - int(np.floor(np.log10(span)))
    grid: list[float] = []
    n = missing
    while len(grid) < missing:
        even = low + span * np.arange(1, n + 1) / (n + 1)
        grid = [k for k in dict.fromkeys(np.round(even, digits).tolist()) if k not in knots]
        n += 1
    return tuple(sorted({*knots, *grid[:missing]}))
