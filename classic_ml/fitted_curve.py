"""A fitted lag in words: its equation and its terms, each number with its error."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from surge_core.display import Grid
from surge_core.rounding import bracketed, round_to_error
from surge_core.types import FloatArray

__all__ = ["FittedCurve", "characteristic_grid", "equation_with_errors", "factor", "milliseconds"]


class FittedCurve(Protocol):
    """What is shown of a fitted lag."""

    @property
    def time_constant_s_(self) -> float:
        """τ in seconds."""

    @property
    def time_constant_stderr_s_(self) -> float:
        """Its standard error, in seconds."""

    @property
    def terms_(self) -> list[str]:
        """Names of the terms."""

    @property
    def coef_(self) -> FloatArray:
        """β, of shape (q,)."""

    @property
    def covariance_(self) -> FloatArray:
        """Covariance of β, of shape (q, q)."""


def characteristic_grid(fitted: FittedCurve) -> Grid:
    """Return the terms of a fitted lag as a table.

    Parameters
    ----------
    fitted : FittedCurve
        Fitted.
    """
    errors = np.sqrt(np.maximum(np.diag(fitted.covariance_), 0.0))
    rows = tuple(
        (name, round_to_error(float(value), float(error)))
        for name, value, error in zip(fitted.terms_, fitted.coef_, errors, strict=True)
    )
    return Grid("Quasi-steady characteristic", ("term", "coefficient ± std error"), rows)


def equation_with_errors(fitted: FittedCurve) -> str:
    """Write a fitted lag with the error of each number in its last digits.

    Parameters
    ----------
    fitted : FittedCurve
        Fitted.
    """
    errors = np.sqrt(np.maximum(np.diag(fitted.covariance_), 0.0))
    right = ""
    for name, value, error in zip(fitted.terms_, fitted.coef_, errors, strict=True):
        sign = "−" if value < 0.0 else "+"
        right += f" {sign} {bracketed(abs(float(value)), float(error))}{factor(name)}"
    right = right.removeprefix(" + ").strip()
    if not np.isfinite(fitted.time_constant_s_):
        return f"y = {right}"
    tau = bracketed(1e3 * fitted.time_constant_s_, 1e3 * fitted.time_constant_stderr_s_)
    return f"{tau} ms · dy/dt + y = {right}"


def milliseconds(value_s: float, stderr_s: float) -> str:
    """Write a time with its error in milliseconds.

    Parameters
    ----------
    value_s, stderr_s : float
        In seconds; nan where it is not known.
    """
    if not np.isfinite(value_s):
        return "not known"
    return f"{round_to_error(1e3 * value_s, 1e3 * stderr_s)} ms"


def factor(name: str) -> str:
    """Return a term as a factor behind its coefficient; nothing for the constant.

    Parameters
    ----------
    name : str
        The term.
    """
    return "" if name == "1" else f" {name}"
