"""The terms s_i(φ) of a characteristic (paper, Eq 8, 12 and 14), and a fitted lag in words."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from surge_core.display import Field, Grid, Sheet
from surge_core.errors import InputError
from surge_core.fit_state import FitState
from surge_core.rounding import bracketed, round_to_error
from surge_core.terms import signed_sum
from surge_core.types import FloatArray


def lag_sheet(fit: Any, state: str, *more: Field) -> Sheet:
    """Return what is shown of a fitted lag: equation, state and τ, then more fields, and the terms.

    The fit has the attributes of an estimator; ``state`` is its state in words. A τ that was held
    has no error.
    """
    errors = np.sqrt(np.maximum(np.diag(fit.covariance_), 0.0)).tolist()
    named = list(zip(fit.terms_, fit.coef_.tolist(), errors, strict=True))
    equation, tau = f"y = {signed_sum(named, str)}", "not known"
    if np.isfinite(fit.time_constant_s_):
        lag_ms = 1e3 * fit.time_constant_s_, 1e3 * fit.time_constant_stderr_s_
        equation = f"{bracketed(*lag_ms)} ms · dy/dt + {equation}"
        tau = f"{round_to_error(*lag_ms)} ms" + (" (held)" if lag_ms[1] == 0.0 else "")
    tone = "good" if fit.fit_state_ is FitState.CONVERGED else "advice"
    fields = (
        Field("equation", equation),
        Field("state", state, tone),
        Field("time constant τ", tau),
        *more,
    )
    rows = tuple((name, round_to_error(value, error)) for name, value, error in named)
    head = ("term", "coefficient ± std error")
    return Sheet(type(fit).__name__, fields, (Grid("Quasi-steady characteristic", head, rows),))


class PiecewiseLinear(TransformerMixin, BaseEstimator):
    """The inputs of Fig 22: a constant and one slope for each piece of a continuous line.

    Parameters
    ----------
    breakpoints : array-like of float
        Increasing flow coefficients d₁ < d₂ < … at which the slope changes.

    Notes
    -----
    s₁ = 1, s₂ = min(φ, d₁), s₃ = clip(φ - d₁, 0, d₂ - d₁), …, last = max(φ - d_last, 0); each
    coefficient after the first is the slope of its piece (paper, Eq 14 and Fig 22, the figure
    reconstructed).
    """

    def __init__(self, breakpoints: ArrayLike = (0.1,)) -> None:
        self.breakpoints = breakpoints

    def fit(self, X: ArrayLike, y: object = None) -> Self:
        """Check the breakpoints against one input column.

        Parameters
        ----------
        X : array-like of shape (n, 1)
            Flow coefficient.
        y : ignored
            Present for scikit-learn's sake.
        """
        points = np.atleast_1d(np.asarray(self.breakpoints, dtype=np.float64))
        if points.ndim != 1 or points.size == 0 or np.any(np.diff(points) <= 0.0):
            raise InputError(
                "breakpoints of PiecewiseLinear",
                expected="one or more increasing flow coefficients",
                found=repr(self.breakpoints),
            )
        array = validate_data(self, X)
        if array.shape[1] != 1:
            raise InputError(
                "X of PiecewiseLinear", expected="one column, φ", found=f"{array.shape[1]} columns"
            )
        self.breakpoints_ = points
        return self

    def transform(self, X: ArrayLike) -> FloatArray:
        """Return the inputs s_i, of shape (n, n_breakpoints + 2)."""
        check_is_fitted(self)
        phi = validate_data(self, X, reset=False)[:, 0]
        points = self.breakpoints_
        pieces = [np.ones_like(phi), np.minimum(phi, points[0])]
        pieces += [np.clip(phi - low, 0.0, high - low) for low, high in pairwise(points)]
        pieces.append(np.maximum(phi - points[-1], 0.0))
        return np.column_stack(pieces)

    def get_feature_names_out(self, input_features: ArrayLike | None = None) -> FloatArray:
        """Return the names of the inputs: ``1``, ``min(phi,0.1)``, …"""
        check_is_fitted(self)
        name = "phi" if input_features is None else str(np.asarray(input_features)[0])
        points = self.breakpoints_
        names = ["1", f"min({name},{points[0]:g})"]
        names += [f"clip({name}-{low:g},0,{high - low:g})" for low, high in pairwise(points)]
        names.append(f"relu({name}-{points[-1]:g})")
        return np.asarray(names, dtype=object)


def polynomial_names(name: str, degree: int) -> list[str]:
    """Name the terms 1, φ, φ², … of a polynomial in one input (paper, Eq 12)."""
    return ["1", name, *(f"{name}^{power}" for power in range(2, degree + 1))][: degree + 1]


def feature_names(n_features: int, given: ArrayLike | None) -> list[str]:
    """Name the inputs: as given, else ``phi`` for one and ``x0``, ``x1``, … for several."""
    if given is not None:
        return [str(name) for name in np.asarray(given)]
    return ["phi"] if n_features == 1 else [f"x{i}" for i in range(n_features)]


def term_names(basis: Any, inputs: list[str], n_terms: int) -> list[str]:
    """Ask a fitted transformer for the names of its terms, numbering those it cannot name."""
    namer = getattr(basis, "get_feature_names_out", None)
    if namer is None:
        return [f"s{i + 1}" for i in range(n_terms)]
    try:
        return [str(name) for name in namer(inputs)]
    except ValueError:
        # A transformer that saw other names (or none) insists on its own.
        return [str(name) for name in namer()]
