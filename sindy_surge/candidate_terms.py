"""The candidate terms of a fit, and which of them its data can separate."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sindy_surge.library import StallLibrary, default_library, hinge_name
from sindy_surge.state_terms import PhysicalForm, ProductStateTerms, physical_form
from surge_core.errors import InputError
from surge_core.types import FloatArray

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

        ``wanted`` are positions of terms, rising; without them it is all, or without ψ' at the same
        rows all that do not hold it. Where ``strict``, a term that is not finite somewhere is
        refused.
        """
        own, edge = len(self._own_names), self.n_without_state
        if wanted is None:
            wanted = range(edge if psi_p is None else len(self.names))
        parts: list[FloatArray] = []
        inputs_alone = [i for i in wanted if i < own]
        if inputs_alone:
            parts.append(self._of_inputs(X, inputs_alone, strict=strict))
        extra = [self._extra[i - own] for i in wanted if own <= i < edge]
        parts += [np.maximum(X[:, 0] - knot, 0.0)[:, None] for knot in extra]
        with_state = [i - edge for i in wanted if i >= edge]
        if with_state and self.states is not None and psi_p is not None:
            parts.append(self.states(X, psi_p)[:, with_state])
        if not parts:
            return np.empty((X.shape[0], 0))
        return parts[0] if len(parts) == 1 else np.asfortranarray(np.hstack(parts))

    def _of_inputs(
        self, X: FloatArray, wanted: Sequence[int] | None = None, *, strict: bool = True
    ) -> FloatArray:
        """Evaluate terms of the library as a plain array."""
        # A plain float array: pysindy hands back its own subclass, slow in everything after.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if wanted is not None and hasattr(self._library, "columns_at"):
                values = self._library.columns_at(X, wanted)
            else:
                values = self._library.transform(X)
                values = np.array(values, dtype=np.float64, order="F", subok=False)
                values = values if wanted is None else values[:, list(wanted)]
        bad = np.argwhere(~np.isfinite(values)) if strict else np.empty((0, 2))
        if bad.size:
            row, column = bad[0].tolist()
            position = column if wanted is None else wanted[column]
            raise InputError(
                "library",
                expected="finite terms over the whole range of the data",
                found=f"an infinite or NaN value of {self._own_names[position]!r}, "
                f"first at inputs {np.round(X[row], 6).tolist()}",
                remedy="leave that term out, or restrict the range",
            )
        result: FloatArray = values
        return result


def fitted_library(
    library: Any, X: FloatArray, input_names: Sequence[str]
) -> tuple[Any, tuple[str, ...]]:
    """Fit a copy of a library to inputs (n_rows, n_inputs) and name its terms, or refuse it."""
    try:
        # CustomLibrary keeps its functions where sklearn's clone does not look.
        with np.errstate(all="ignore"):
            fitted = copy.deepcopy(library).fit(X)
            n_terms = np.shape(fitted.transform(X[:1]))[1]
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(
            "library",
            expected="a pysindy feature library or a scikit-learn transformer that takes the "
            "inputs",
            found=f"{type(library).__name__}: {error}",
            remedy="a function in it must be written in Python, as lambda x: np.sin(x)",
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
