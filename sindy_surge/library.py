"""The candidate terms of ψ'_QS: a pysindy library over φ, in physical units."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pysindy.feature_library import ConcatLibrary, PolynomialLibrary
from pysindy.feature_library.base import BaseFeatureLibrary, x_sequence_or_item
from pysindy.utils import AxesArray

from sindy_surge.errors import InputError

__all__ = [
    "CandidateTerms",
    "Powers",
    "StallTerms",
    "default_knots",
    "default_library",
    "independent_columns",
    "polynomial_degree",
]

FloatArray = NDArray[np.float64]

# More polynomial terms than this cannot be told apart on a record of a few thousand rows.
_MAX_POLYNOMIAL_TERMS = 70
# Several inputs: the one-variable terms of each are added up to this number of inputs.
_MAX_INPUTS_WITH_OWN_TERMS = 2


def default_knots(phi: FloatArray) -> tuple[float, ...]:
    """Return round numbers inside the range of φ, where a hinge may sit.

    The step is the largest of 1, 2.5, 5 times a power of ten that is at most a sixth of the
    range: 0.05 both for a surge record in stall (-0.03 to 0.27) and for a whole surge cycle
    (-0.04 to 0.51). A knot needs two per cent of the samples on either side.

    Parameters
    ----------
    phi : ndarray of shape (n_rows,)
        Flow coefficient.

    Returns
    -------
    tuple of float
        The knots, rising; empty if φ is constant.
    """
    step = _round_step(phi)
    if step == 0.0:
        return ()
    low, high = np.quantile(phi, [0.02, 0.98])
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

    @x_sequence_or_item
    def transform(self, x_full: Any) -> list[Any]:
        """Evaluate the powers and products."""
        return [
            AxesArray(_products(np.asarray(x), self.powers_), {"ax_sample": 0, "ax_coord": 1})
            for x in x_full
        ]


def _products(x: FloatArray, powers: NDArray[np.int64]) -> FloatArray:
    columns = np.ones((x.shape[0], len(powers)), order="F")
    for number, exponents in enumerate(powers):
        for j in np.flatnonzero(exponents):
            columns[:, number] *= x[:, j] ** int(exponents[j])
    return columns


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
        self.n_output_features_ = sum(
            len(k) + 1 + len(s) for k, s in zip(self.knots, self.scales, strict=True)
        )
        return self

    @x_sequence_or_item
    def transform(self, x_full: Any) -> list[Any]:
        """Evaluate the terms."""
        return [
            AxesArray(self._columns(np.asarray(x)), {"ax_sample": 0, "ax_coord": 1}) for x in x_full
        ]

    def _columns(self, x: FloatArray) -> FloatArray:
        columns = []
        for j, (knots, scales) in enumerate(zip(self.knots, self.scales, strict=True)):
            phi = x[:, j]
            columns += [np.maximum(phi - k, 0.0) for k in knots]
            columns.append(np.where(phi < 0, phi**2, 0.0))
            columns += [np.exp(-phi / s) for s in scales]
        return np.column_stack(columns)

    def get_feature_names(self, input_features: Any = None) -> list[str]:
        """Return the names, e.g. ``relu(phi-0.05)``."""
        if input_features is None:
            input_features = [f"x{j}" for j in range(self.n_features_in_)]
        names = []
        for name, knots, scales in zip(input_features, self.knots, self.scales, strict=True):
            names += [_hinge_name(name, k) for k in knots]
            names.append(f"{name}^2[{name}<0]")
            names += [f"exp(-{name}/{s:.12g})" for s in scales]
        return names


def _hinge_name(name: str, knot: float) -> str:
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
        auto = default_knots(phi) if step else usual
        each_knots.append(auto if knots is None else tuple(map(float, np.ravel(knots))))
        scales = (step, 2 * step) if step else (0.05, 0.1)
        # exp overflows for a range far below zero compared with its own width.
        each_scales.append(tuple(s for s in scales if -float(np.min(phi)) / s < 50))
        missing = 15 - (degree + 2 + len(each_knots[-1]) + len(each_scales[-1]))
        if missing > 0 and knots is None:
            each_knots[-1] = _finer(each_knots[-1], phi, missing)
    return ConcatLibrary([polynomials, StallTerms(each_knots, each_scales)])


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


class _Evaluator(Protocol):
    def transform(self, x: Any) -> Any: ...


class CandidateTerms:
    """A fitted library with its names and the columns that can be told apart on this data.

    Parameters
    ----------
    library : pysindy library, scikit-learn transformer or None
        Deep-copied, then fitted to `X`; None builds `default_library`.
    X : ndarray of shape (n_rows, n_inputs)
        The inputs.
    input_names : list of str
        Name of each input, used in the names of the terms.
    degree, knots
        See `default_library`; unused with a library of one's own.
    """

    def __init__(
        self,
        library: Any,
        X: FloatArray,
        input_names: list[str],
        *,
        degree: int = 5,
        knots: ArrayLike | None = None,
    ) -> None:
        chosen = default_library(X, degree=degree, knots=knots) if library is None else library
        for method in ("fit", "transform"):
            if not hasattr(chosen, method):
                raise InputError(
                    "library",
                    expected="a pysindy feature library or a scikit-learn transformer",
                    found=f"{type(chosen).__name__}, which has no `{method}`",
                )
        self._library: _Evaluator = copy.deepcopy(chosen).fit(X)
        self.names = _names(self._library, input_names, self(X[:1]).shape[1])

    def __call__(self, X: FloatArray) -> FloatArray:
        """Evaluate every term.

        Parameters
        ----------
        X : ndarray of shape (n_rows, n_inputs)
            The inputs.

        Returns
        -------
        ndarray of shape (n_rows, n_terms)
            The terms in physical units.

        Raises
        ------
        InputError
            If a term is not finite somewhere.
        """
        # A plain float array: pysindy hands back its own subclass, slow in everything after.
        with np.errstate(over="ignore", invalid="ignore"):
            values = self._library.transform(X)
        if hasattr(values, "toarray"):
            values = values.toarray()
        values = np.array(values, dtype=np.float64, order="F", subok=False)
        if not np.all(np.isfinite(values)):
            column = int(np.flatnonzero(~np.all(np.isfinite(values), axis=0))[0])
            raise InputError(
                "library",
                expected="finite terms over the whole range of the data",
                found=f"infinite or NaN values in column {column}",
                remedy="leave that term out, or restrict the range",
            )
        return values


def _names(library: Any, input_names: list[str], n_terms: int) -> tuple[str, ...]:
    if hasattr(library, "get_feature_names"):
        names = library.get_feature_names(input_names)
    elif hasattr(library, "get_feature_names_out"):
        names = library.get_feature_names_out(np.asarray(input_names, dtype=object))
    else:
        names = [f"s{i}" for i in range(n_terms)]
    # pysindy and scikit-learn write a product as "a b".
    return tuple(str(name) for name in names)


def independent_columns(values: FloatArray, tolerance: float = 1e-9) -> NDArray[np.intp]:
    """Return the columns, first come first kept, that no earlier ones reproduce.

    Zero columns (the reverse branch of a record that never reverses) and exact aliases go.

    Parameters
    ----------
    values : ndarray of shape (n_rows, n_terms)
        The terms over the data.
    tolerance : float
        Least share of a column's norm that must be new.

    Returns
    -------
    ndarray of int
        Indices of the columns kept.
    """
    norms = np.linalg.norm(values, axis=0)
    # The triangular factor holds all inner products in as many rows as there are terms.
    scaled = values / np.where(norms > 0, norms, 1.0)
    triangle: FloatArray = np.asarray(np.linalg.qr(scaled, mode="r"))
    basis = np.empty((triangle.shape[0], 0))
    kept: list[int] = []
    for j, norm in enumerate(norms):
        if norm == 0.0 or len(kept) >= values.shape[0]:
            continue
        rest = triangle[:, j]
        for _ in range(2):  # twice is enough (Kahan, in Parlett, The Symmetric Eigenvalue Problem)
            rest = rest - basis @ (basis.T @ rest)
        size = float(np.linalg.norm(rest))
        if size > tolerance:
            basis = np.column_stack((basis, rest / size))
            kept.append(j)
    return np.array(kept, dtype=np.intp)


def polynomial_degree(name: str, input_names: Sequence[str]) -> int | None:
    """Return the total degree of a term, or None if it is no power or product of the inputs.

    Parameters
    ----------
    name : str
        Name of the term, e.g. ``1``, ``phi^2`` or ``x0 x1^2``.
    input_names : sequence of str
        Names of the inputs.

    Returns
    -------
    int or None
        Sum of the exponents; 0 for ``1``.
    """
    if name == "1":
        return 0
    degree = 0
    for factor in name.split(" "):
        base, _, power = factor.partition("^")
        if base not in input_names or not (power == "" or power.isdecimal()):
            return None
        degree += int(power or 1)
    return degree
