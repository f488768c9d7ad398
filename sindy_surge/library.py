"""The candidate terms of ψ'_QS: a pysindy library over φ, in physical units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pysindy.feature_library import ConcatLibrary, PolynomialLibrary
from pysindy.feature_library.base import BaseFeatureLibrary, x_sequence_or_item
from pysindy.utils import AxesArray

from sindy_surge.segments import Segments
from sindy_surge.whitening import difference_noise
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "Powers",
    "StallLibrary",
    "StallTerms",
    "default_knots",
    "default_library",
    "hinge_name",
    "piecewise_linear_library",
]


# More polynomial terms than this cannot be told apart on a record of a few thousand rows.
_MAX_POLYNOMIAL_TERMS = 70
# Several inputs: the one-variable terms of each are added up to this number of inputs.
_MAX_INPUTS_WITH_OWN_TERMS = 2
_NOISE_REACH = 2.0
_MOST_REACH = 0.05


def default_knots(phi: FloatArray, noise: float = 0.0) -> tuple[float, ...]:
    """Return round numbers inside the range of φ, where a hinge may sit.

    The step is the largest of 1, 2.5, 5 times a power of ten that is at most a sixth of the
    range: 0.05 both for a surge record in stall (-0.03 to 0.27) and for a whole surge cycle
    (-0.04 to 0.51). A knot needs two per cent of the samples on either side, beyond the reach of
    noise: a hinge at the very end of the range fits the errors of its ends.

    Parameters
    ----------
    phi : ndarray of shape (n_rows,)
        Flow coefficient.
    noise : float
        Standard deviation of its noise.

    Returns
    -------
    tuple of float
        The knots, rising; empty if φ is constant.
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


class Powers(PolynomialLibrary):
    """pysindy's polynomials, evaluated on plain arrays.

    The fits evaluate the library hundreds of times, and pysindy's array type costs a third of a
    millisecond for each term, whatever the number of rows.
    """

    def columns_at(self, x: FloatArray, wanted: Sequence[int]) -> FloatArray:
        """Evaluate some of the terms.

        Parameters
        ----------
        x : ndarray of shape (n_rows, n_inputs)
            The inputs.

        Returns
        -------
        ndarray of shape (n_rows, n_wanted)
            The terms.
        """
        return _products(x, self.powers_[list(wanted)])

    @x_sequence_or_item
    def transform(self, x_full: Any) -> list[Any]:
        """Evaluate the powers and products."""
        return [
            AxesArray(_products(np.asarray(x), self.powers_), {"ax_sample": 0, "ax_coord": 1})
            for x in x_full
        ]


def _products(x: FloatArray, powers: NDArray[np.int64]) -> FloatArray:
    columns = np.ones((x.shape[0], len(powers)), order="F")
    # Chains of multiplications: numpy's power takes ten times as long.
    chain: dict[tuple[int, int], FloatArray] = {}
    for number, exponents in enumerate(powers):
        for j in np.flatnonzero(exponents):
            columns[:, number] *= _chained(x, int(j), int(exponents[j]), chain)
    return columns


def _chained(
    x: FloatArray, j: int, power: int, chain: dict[tuple[int, int], FloatArray]
) -> FloatArray:
    if (j, power) not in chain:
        chain[j, power] = (
            np.ascontiguousarray(x[:, j])
            if power == 1
            else _chained(x, j, power - 1, chain) * _chained(x, j, 1, chain)
        )
    return chain[j, power]


class StallTerms(BaseFeatureLibrary):
    """Non-polynomial terms of a compressor characteristic, for each input on its own.

    `relu(phi-k)` is a kink at k (max(φ - k, 0)); `phi^2[phi<0]` the reverse-flow branch; and
    `exp(-phi/s)` the fall of the unstalled line. φ|φ| is left out: it equals
    φ² - 2 φ²[φ<0], so it would be an exact alias.

    Parameters
    ----------
    knots : sequence of sequences of float
        Knots of the hinges, one sequence for each input.
    scales : sequence of sequences of float
        Decay scales of the exponentials, one sequence for each input.
    """

    def __init__(self, knots: Any, scales: Any) -> None:
        self.knots = knots
        self.scales = scales

    @x_sequence_or_item
    def fit(self, x_full: Any, y: Any = None) -> StallTerms:
        """Count the output features."""
        self.n_features_in_ = x_full[0].shape[-1]
        if len(self.knots) != self.n_features_in_ or len(self.scales) != self.n_features_in_:
            raise InputError(
                "StallTerms",
                expected=f"knots and scales for each of {self.n_features_in_} inputs",
                found=f"{len(self.knots)} and {len(self.scales)}",
            )
        self._plan: list[tuple[int, str, float]] = []
        for j, (knots, scales) in enumerate(zip(self.knots, self.scales, strict=True)):
            self._plan += [(j, "hinge", float(k)) for k in knots]
            self._plan.append((j, "reverse", 0.0))
            self._plan += [(j, "fall", float(s)) for s in scales]
        self.n_output_features_ = len(self._plan)
        return self

    @x_sequence_or_item
    def transform(self, x_full: Any) -> list[Any]:
        """Evaluate the terms."""
        return [
            AxesArray(self._columns(np.asarray(x)), {"ax_sample": 0, "ax_coord": 1}) for x in x_full
        ]

    def _columns(self, x: FloatArray) -> FloatArray:
        return self.columns_at(x, range(self.n_output_features_))

    def columns_at(self, x: FloatArray, wanted: Sequence[int]) -> FloatArray:
        """Evaluate some of the terms; see `Powers.columns_at`."""
        columns = np.empty((x.shape[0], len(wanted)), order="F")
        for number, position in enumerate(wanted):
            j, kind, value = self._plan[position]
            phi = x[:, j]
            if kind == "hinge":
                columns[:, number] = np.maximum(phi - value, 0.0)
            elif kind == "reverse":
                columns[:, number] = np.square(np.minimum(phi, 0.0))
            else:
                columns[:, number] = np.exp(-phi / value)
        return columns

    def get_feature_names(self, input_features: Any = None) -> list[str]:
        """Return the names, e.g. ``relu(phi-0.05)``."""
        if input_features is None:
            input_features = [f"x{j}" for j in range(self.n_features_in_)]
        names = []
        for name, knots, scales in zip(input_features, self.knots, self.scales, strict=True):
            names += [hinge_name(name, k) for k in knots]
            names.append(f"{name}^2[{name}<0]")
            names += [f"exp(-{name}/{s:.12g})" for s in scales]
        return names


class StallLibrary(ConcatLibrary):
    """Polynomials and `StallTerms` side by side, with any of their terms alone."""

    def columns_at(self, x: FloatArray, wanted: Sequence[int]) -> FloatArray:
        """Evaluate some of the terms; see `Powers.columns_at`."""
        powers, special = self.libraries
        edge = powers.n_output_features_
        order = np.argsort([position >= edge for position in wanted], kind="stable")
        first = [wanted[i] for i in order if wanted[i] < edge]
        second = [wanted[i] - edge for i in order if wanted[i] >= edge]
        columns = np.empty((x.shape[0], len(wanted)), order="F")
        columns[:, order[: len(first)]] = powers.columns_at(x, first)
        columns[:, order[len(first) :]] = special.columns_at(x, second)
        return columns


def hinge_name(name: str, knot: float) -> str:
    """Return the name of max(φ - k, 0), e.g. ``relu(phi-0.05)``."""
    if knot == 0:
        return f"relu({name})"
    return f"relu({name}{'-' if knot > 0 else '+'}{abs(knot):.12g})"


def default_library(
    X: FloatArray, *, degree: int = 5, knots: ArrayLike | None = None
) -> BaseFeatureLibrary:
    """Build the library of candidate terms that suits the range of the data.

    Parameters
    ----------
    X : ndarray of shape (n_rows, n_inputs)
        The inputs; only their ranges are used.
    degree : int
        Highest total degree of the polynomials; lowered for many inputs so that at most 70
        polynomial terms remain.
    knots : array-like of float or None
        Knots of the hinges; None takes `default_knots`.

    Returns
    -------
    pysindy.feature_library.base.BaseFeatureLibrary
        Polynomials, hinges, the reverse-flow branch and exponentials: at least 15 terms for one
        input.
    """
    n_inputs = X.shape[1]
    while degree > 1 and _n_polynomials(n_inputs, degree) > _MAX_POLYNOMIAL_TERMS:
        degree -= 1
    polynomials = Powers(degree=degree, include_bias=True)
    if n_inputs > _MAX_INPUTS_WITH_OWN_TERMS:
        return polynomials
    each_knots, each_scales = [], []
    for phi in X.T:
        step = _round_step(phi)
        # Without a range there is nothing to place knots in; the usual ones then stay in the
        # list as constants, which cannot be selected beside "1".
        usual = tuple(round(0.05 * k, 2) for k in range(1, 7))
        whole = Segments.from_labels(None, phi.size)
        auto = default_knots(phi, difference_noise(phi, whole)) if step else usual
        each_knots.append(auto if knots is None else tuple(map(float, np.ravel(knots))))
        scales = (step, 2 * step) if step else (0.05, 0.1)
        # exp overflows for a range far below zero compared with its own width.
        each_scales.append(tuple(s for s in scales if -float(np.min(phi)) / s < 50))
        missing = 15 - (degree + 2 + len(each_knots[-1]) + len(each_scales[-1]))
        if missing > 0 and knots is None:
            each_knots[-1] = _finer(each_knots[-1], phi, missing)
    return StallLibrary([polynomials, StallTerms(each_knots, each_scales)])


def piecewise_linear_library(X: FloatArray) -> BaseFeatureLibrary:
    """Build the library of piecewise-linear characteristics, as in Fig 22 of the paper.

    Parameters
    ----------
    X : ndarray of shape (n_rows, n_inputs)
        The inputs; only their ranges are used.

    Returns
    -------
    pysindy.feature_library.base.BaseFeatureLibrary
        1, the inputs, their hinges and the reverse-flow branch.
    """
    knots = [default_knots(phi) for phi in X.T]
    return StallLibrary([Powers(degree=1), StallTerms(knots, [() for _ in knots])])


def _finer(knots: tuple[float, ...], phi: FloatArray, missing: int) -> tuple[float, ...]:
    """Add evenly spread knots, rounded to three digits of the range, until enough are there."""
    low, high = float(np.min(phi)), float(np.max(phi))
    span = high - low if high > low else 1.0
    digits = 3 - int(np.floor(np.log10(span)))
    extra: list[float] = []
    n = missing
    while len(extra) < missing:
        grid = (round(low + span * (i + 1) / (n + 1), digits) for i in range(n))
        extra = [k for k in dict.fromkeys(grid) if k not in knots][:missing]
        n += 1
    return tuple(sorted({*knots, *extra}))


def _n_polynomials(n_inputs: int, degree: int) -> int:
    from math import comb

    return comb(n_inputs + degree, degree)
