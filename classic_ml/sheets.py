"""What is shown of a fitted lag and of a fit to whole runs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from surge_core.display import Field, Grid, Sheet
from surge_core.fit_state import FitState
from surge_core.rounding import bracketed, round_to_error, significant

if TYPE_CHECKING:
    from classic_ml.lag_model import LagRegressor
    from classic_ml.whole_run import WholeRunFit

__all__ = ["lag_sheet", "whole_run_sheet"]


def lag_sheet(fitted: LagRegressor) -> Sheet:
    """Return what is shown of a fitted lag regressor.

    Parameters
    ----------
    fitted : LagRegressor
        Fitted.
    """
    state = fitted.fit_state_
    held = " (held)" if fitted.time_constant_s is not None else ""
    fields = [
        Field("equation", _equation(fitted)),
        Field(
            "state",
            f"{state.code}: {state.advice}",
            "good" if state is FitState.CONVERGED else "advice",
        ),
        Field(
            "time constant τ",
            _milliseconds(fitted.time_constant_s_, fitted.time_constant_stderr_s_) + held,
        ),
    ]
    if fitted.dead_time_s_:
        fields.append(
            Field("dead time", _milliseconds(fitted.dead_time_s_, fitted.dead_time_stderr_s_))
        )
    fields += [
        Field("noise", f"{fitted.noise}, hold “{fitted.hold}”"),
        Field("residual (std)", significant(fitted.residual_std_, 3)),
        Field("scored", f"{fitted.n_scored_} rows; errors from {fitted.n_blocks_} blocks"),
    ]
    return Sheet("LagRegressor", tuple(fields), (_characteristic(fitted),))


def whole_run_sheet(fitted: WholeRunFit) -> Sheet:
    """Return what is shown of a fit to whole runs.

    Parameters
    ----------
    fitted : WholeRunFit
        The fit.
    """
    state = fitted.fit_state_
    held = " (held)" if fitted.model_.time_constant_s is not None else ""
    n_rows = sum(row.phi.size for row in fitted.rows_)
    fields = (
        Field("equation", _equation(fitted)),
        Field("state", state.advice, "good" if state is FitState.CONVERGED else "advice"),
        Field(
            "time constant τ",
            _milliseconds(fitted.time_constant_s_, fitted.time_constant_stderr_s_) + held,
        ),
        Field(
            "fitted to",
            f"{_count(len(fitted.rows_), 'run')} of unfiltered signals, {n_rows} rows, averaged "
            "over one period of the stall cells",
        ),
        Field(
            "scored",
            f"{fitted.n_scored_} rows in forward flow in stall; errors from {fitted.n_blocks_} "
            "blocks, with those that all cycles share",
        ),
    )
    return Sheet("WholeRunFit", fields, (_characteristic(fitted),))


def _characteristic(fitted: LagRegressor | WholeRunFit) -> Grid:
    errors = np.sqrt(np.maximum(np.diag(fitted.covariance_), 0.0))
    rows = tuple(
        (name, round_to_error(float(value), float(error)))
        for name, value, error in zip(fitted.terms_, fitted.coef_, errors, strict=True)
    )
    return Grid("Quasi-steady characteristic", ("term", "coefficient ± std error"), rows)


def _equation(fitted: LagRegressor | WholeRunFit) -> str:
    """Write the model with the error of each number in its last digits."""
    errors = np.sqrt(np.maximum(np.diag(fitted.covariance_), 0.0))
    right = ""
    for name, value, error in zip(fitted.terms_, fitted.coef_, errors, strict=True):
        sign = "−" if value < 0.0 else "+"
        factor = "" if name == "1" else f" {name}"
        right += f" {sign} {bracketed(abs(float(value)), float(error))}{factor}"
    right = right.removeprefix(" + ").strip()
    if not math.isfinite(fitted.time_constant_s_):
        return f"y = {right}"
    tau = bracketed(1e3 * fitted.time_constant_s_, 1e3 * fitted.time_constant_stderr_s_)
    return f"{tau} ms · dy/dt + y = {right}"


def _milliseconds(value_s: float, stderr_s: float) -> str:
    if not math.isfinite(value_s):
        return "not known"
    return f"{round_to_error(1e3 * value_s, 1e3 * stderr_s)} ms"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")
