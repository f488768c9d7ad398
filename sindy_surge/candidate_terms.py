"""The candidate terms of a fit, with those that hold ψ', and which its data can separate."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import comb
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sindy_surge.library import StallLibrary, default_library, hinge_name, power_name
from surge_core.errors import InputError
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
        cls, psi_p: FloatArray, input_names: Sequence[str], output_name: str, known: Sequence[str]
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


# With more inputs their products with ψ' would be most of the library.
_MOST_INPUTS_WITH_STATE = 2


class CandidateTerms:
    """A fitted library with its names: terms of the inputs first, then those that hold ψ'.

    A pysindy library or a scikit-learn transformer is copied and fitted to the inputs; without one
    it is `default_library`. Terms that hold ψ', called ``output_name``, are offered where ``psi_p``
    is given at the rows of ``X``, with one or two inputs.
    """

    def __init__(
        self,
        library: Any,
        X: FloatArray,
        input_names: list[str],
        *,
        psi_p: FloatArray | None = None,
        output_name: str = "psi_p",
    ) -> None:
        chosen = default_library(X) if library is None else library
        self._library, self._own_names = fitted_library(chosen, X, input_names)
        self.input_names = tuple(input_names)
        self._extra: tuple[float, ...] = ()
        self.states: ProductStateTerms | None = None
        if psi_p is not None and len(input_names) <= _MOST_INPUTS_WITH_STATE:
            self.states = ProductStateTerms.of(psi_p, input_names, output_name, self._own_names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all terms; those that hold ψ' come last."""
        extra = tuple(hinge_name(self.input_names[0], knot) for knot in self._extra)
        return self._own_names + extra + (() if self.states is None else self.states.names)

    @property
    def knots(self) -> tuple[float, ...]:
        """Knots of all hinges of the first input."""
        own = self._library.knots if isinstance(self._library, StallLibrary) else ()
        return (*(own[0] if own else ()), *self._extra)

    @property
    def n_without_state(self) -> int:
        """Number of terms that do not hold ψ'."""
        return len(self._own_names) + len(self._extra)

    def written(
        self,
        selected: NDArray[np.intp],
        coefficients: FloatArray,
        time_constant_s: float = 1.0,
        covariance: FloatArray | None = None,
    ) -> PhysicalForm:
        """Return a structure in ψ' itself, with the covariance of its coefficients and τ."""
        names = [self.names[i] for i in selected]
        if covariance is None:
            covariance = np.zeros((len(names) + 1, len(names) + 1))
        given = names, coefficients, time_constant_s, covariance
        return physical_form(*given, self.states, self.input_names)

    def physical(self) -> CandidateTerms:
        """Return the library with terms in ψ' itself, as their names say."""
        plain = copy.copy(self)
        plain.states = None if self.states is None else self.states.physical()
        return plain

    def with_hinges(self, knots: Sequence[float]) -> CandidateTerms:
        """Return a library with hinges of its first input behind its terms of the inputs."""
        longer = copy.copy(self)
        longer._extra = tuple(knots)
        return longer

    def __call__(
        self,
        X: FloatArray,
        psi_p: FloatArray | None = None,
        wanted: Sequence[int] | None = None,
        *,
        strict: bool = True,
    ) -> FloatArray:
        """Evaluate terms in physical units, (n_rows, n_wanted), at inputs (n_rows, n_inputs).

        ``wanted`` are positions of terms; without them it is all, or without ψ' at the same rows
        all that do not hold it. Where ``strict``, a term that is not finite somewhere is refused.
        """
        # pysindy hands back its own subclass, slow in everything after.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            given = self._library.transform(X)
            given = given.toarray() if hasattr(given, "toarray") else given
            values = np.array(given, dtype=np.float64, subok=False)
        asked = range(len(self._own_names)) if wanted is None else wanted
        own = [i for i in asked if i < len(self._own_names)]
        bad = np.argwhere(~np.isfinite(values[:, own])) if strict else np.empty((0, 2))
        if bad.size:
            row, column = bad[0].tolist()
            raise InputError(
                "library",
                expected="finite terms over the whole range of the data",
                found=f"an infinite or NaN value of {self._own_names[own[column]]!r}, "
                f"first at inputs {np.round(X[row], 6).tolist()}",
                remedy="leave that term out, or restrict the range",
            )
        columns = [values, *(np.maximum(X[:, 0] - knot, 0.0) for knot in self._extra)]
        if self.states is not None and psi_p is not None:
            columns.append(self.states(X, psi_p))
        every = np.column_stack(columns)
        return every if wanted is None else every[:, list(wanted)]


def fitted_library(
    library: Any, X: FloatArray, input_names: Sequence[str]
) -> tuple[Any, tuple[str, ...]]:
    """Fit a copy of a library to inputs (n_rows, n_inputs) and name its terms, or refuse it."""
    try:
        # CustomLibrary keeps its functions where sklearn's clone does not look.
        with np.errstate(all="ignore"):
            fitted = copy.deepcopy(library).fit(X)
            n_terms = np.shape(fitted.transform(X[:1]))[1]
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        # Derivatives and integrals over rows look for more of them than one.
        derived = isinstance(error, IndexError)
        raise InputError(
            "library",
            expected="a pysindy feature library or a scikit-learn transformer, its terms functions "
            "of one row",
            found=f"{type(library).__name__}: {error}",
            remedy="a function in it must be written in Python, as lambda x: np.sin(x)"
            if hasattr(library, "fit") and not (isinstance(library, type) or derived)
            else "pass PolynomialLibrary(degree=3), for one",
        ) from error
    if hasattr(fitted, "get_feature_names"):
        names = fitted.get_feature_names(list(input_names))
    elif hasattr(fitted, "get_feature_names_out"):
        names = fitted.get_feature_names_out(np.asarray(input_names, dtype=object))
    else:
        names = [f"s{i}" for i in range(n_terms)]
    # pysindy and scikit-learn write a product as "a b".
    return fitted, tuple(str(name) for name in names)


def independent_columns(values: FloatArray, tolerance: float = 1e-9) -> NDArray[np.intp]:
    """Return the columns, first come first kept, that no earlier ones reproduce.

    Zero columns (the reverse branch of a record that never reverses) and exact aliases go.
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
    """Return the total degree of a term, e.g. 3 of ``x0 x1^2``; None if it is no such product."""
    if name == "1":
        return 0
    degree = 0
    for factor in name.split(" "):
        base, _, power = factor.partition("^")
        if base not in input_names or not (power == "" or power.isdecimal()):
            return None
        degree += int(power or 1)
    return degree
