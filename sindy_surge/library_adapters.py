"""A library of terms, pysindy's or scikit-learn's, as plain arrays and names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["evaluated", "fitted_library", "term_names"]


def fitted_library(library: Any, X: FloatArray) -> Any:
    """Fit a library, or refuse what is none.

    Parameters
    ----------
    library : pysindy feature library or scikit-learn transformer
        The library.
    X : ndarray of shape (n_rows, n_inputs)
        What to fit it to.
    """
    if not (hasattr(library, "fit") and hasattr(library, "transform")):
        raise InputError(
            "library",
            expected="a pysindy feature library or a scikit-learn transformer",
            found=type(library).__name__,
        )
    return library.fit(X)


def evaluated(
    library: Any,
    X: FloatArray,
    wanted: Sequence[int] | None = None,
    names: Sequence[str] = (),
    *,
    strict: bool = True,
) -> FloatArray:
    """Evaluate a fitted library as a plain array, and refuse what is not finite.

    Parameters
    ----------
    library : object
        From `fitted_library`.
    X : ndarray of shape (n_rows, n_inputs)
        Its inputs.
    wanted : sequence of int or None
        Positions of the terms; None for all of them.
    names : sequence of str
        Names of all its terms.
    strict : bool
        Refuse what is not finite.

    Returns
    -------
    ndarray of shape (n_rows, n_terms)
        The terms.

    Raises
    ------
    InputError
        If a term is not finite somewhere.
    """
    # A plain float array: pysindy hands back its own subclass, slow in everything after.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if wanted is not None and hasattr(library, "columns_at"):
            values = np.asarray(library.columns_at(X, wanted), dtype=np.float64)
        else:
            values = library.transform(X)
            if hasattr(values, "toarray"):
                values = values.toarray()
            values = np.array(values, dtype=np.float64, order="F", subok=False)
            if wanted is not None and len(wanted) != values.shape[1]:
                values = values[:, list(wanted)]
    bad = np.argwhere(~np.isfinite(values))
    if strict and bad.size:
        row, column = bad[0]
        name = names[column if wanted is None else wanted[column]] if names else f"term {column}"
        raise InputError(
            "library",
            expected="finite terms over the whole range of the data",
            found=f"an infinite or NaN value of {name!r}, first at inputs "
            f"{np.round(X[row], 6).tolist()}",
            remedy="leave that term out, or restrict the range",
        )
    result: FloatArray = values
    return result


def term_names(library: Any, input_names: list[str], n_terms: int) -> tuple[str, ...]:
    """Return the names of a library's terms."""
    if hasattr(library, "get_feature_names"):
        names = library.get_feature_names(input_names)
    elif hasattr(library, "get_feature_names_out"):
        names = library.get_feature_names_out(np.asarray(input_names, dtype=object))
    else:
        names = [f"s{i}" for i in range(n_terms)]
    # pysindy and scikit-learn write a product as "a b".
    return tuple(str(name) for name in names)
