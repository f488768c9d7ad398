"""A fitted lag in words: its equation and its terms, each number with its error."""

from __future__ import annotations

from typing import Any

import numpy as np

from surge_core.display import Field, Grid, Sheet
from surge_core.fit_state import FitState
from surge_core.rounding import bracketed, round_to_error


def lag_sheet(fit: Any, state: str, *more: Field) -> Sheet:
    """Return what is shown of a fitted lag: equation, state and τ, then more fields, and the terms.

    The fit has the attributes of an estimator; ``state`` is its state in words. A τ that was held
    has no error.
    """
    errors = np.sqrt(np.maximum(np.diag(fit.covariance_), 0.0)).tolist()
    named = list(zip(fit.terms_, fit.coef_.tolist(), errors, strict=True))
    right = "".join(
        f" {'−' if value < 0.0 else '+'} {bracketed(abs(value), error)}{factor(name)}"
        for name, value, error in named
    )
    equation, tau = f"y = {right.removeprefix(' + ').strip()}", "not known"
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


def factor(name: str) -> str:
    """Return a term as a factor behind its coefficient; nothing for the constant."""
    return "" if name == "1" else f" {name}"
