"""A fitted lag in words: its equation and its terms, each number with its error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surge_core.display import Grid
from surge_core.rounding import bracketed, round_to_error
from surge_core.types import FloatArray


def characteristic_grid(terms: Sequence[str], coef: FloatArray, covariance: FloatArray) -> Grid:
    """Return the terms of a fitted lag as a table.

    Parameters
    ----------
    terms : sequence of str
        Their names.
    coef, covariance : ndarray of shape (q,), (q, q)
        β and its covariance.
    """
    rows = tuple(
        (name, round_to_error(value, error))
        for name, value, error in zip(terms, coef.tolist(), _errors(covariance), strict=True)
    )
    return Grid("Quasi-steady characteristic", ("term", "coefficient ± std error"), rows)


def equation_with_errors(
    lag: tuple[float, float], terms: Sequence[str], coef: FloatArray, covariance: FloatArray
) -> str:
    """Write a fitted lag with the error of each number in its last digits.

    Parameters
    ----------
    lag : tuple of float
        τ and its standard error, in seconds; nan where it is not known.
    terms, coef, covariance
        As for :func:`characteristic_grid`.
    """
    right = ""
    for name, value, error in zip(terms, coef.tolist(), _errors(covariance), strict=True):
        sign = "−" if value < 0.0 else "+"
        right += f" {sign} {bracketed(abs(value), error)}{factor(name)}"
    right = right.removeprefix(" + ").strip()
    if not np.isfinite(lag[0]):
        return f"y = {right}"
    return f"{bracketed(1e3 * lag[0], 1e3 * lag[1])} ms · dy/dt + y = {right}"


def _errors(covariance: FloatArray) -> list[float]:
    errors: list[float] = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
    return errors


def milliseconds(value_s: float, stderr_s: float) -> str:
    """Write a time with its error in milliseconds, both given in seconds."""
    if not np.isfinite(value_s):
        return "not known"
    return f"{round_to_error(1e3 * value_s, 1e3 * stderr_s)} ms"


def factor(name: str) -> str:
    """Return a term as a factor behind its coefficient; nothing for the constant."""
    return "" if name == "1" else f" {name}"
