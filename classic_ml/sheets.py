"""What is shown of a fitted lag, a record, a series and a reduction."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from surge_core.display import Field, Grid, Sheet
from surge_core.fit_state import FitState
from surge_core.rounding import bracketed, round_to_error, significant

if TYPE_CHECKING:
    from classic_ml.lag_model import LagRegressor
    from classic_ml.records import LedgerEntry, Record
    from classic_ml.reduction import Reduction
    from classic_ml.series import CoefficientSeries
    from classic_ml.whole_run import WholeRunFit

__all__ = ["lag_sheet", "record_sheet", "reduction_sheet", "series_sheet", "whole_run_sheet"]

SIGNALS = {
    "phi": ("φ", 1.0, ""),
    "psi_p": ("ψ'", 1.0, ""),
    "psi": ("ψ", 1.0, ""),
    "T25_K": ("T25", 1.0, " K"),
    "Nc_frac": ("corrected speed", 100.0, " % of design"),
}


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


def record_sheet(record: Record) -> Sheet:
    """Return what is shown of a record; no channel is read for it.

    Parameters
    ----------
    record : Record
        The record.
    """
    n = record.n_samples
    end_s = record.start_s + (n - 1) / record.sample_rate_hz
    fields = (
        Field("source", record.source or "none"),
        Field("rows", f"{n} at {record.sample_rate_hz:g} Hz"),
        Field("facility clock", f"{record.start_s:.3f} to {end_s:.3f} s"),
        Field("ledger", _ledger_words(record.history)),
    )
    rows = tuple((name, channel.unit) for name, channel in record.channels.items())
    title = f"{len(rows)} channels"
    channels = Grid(title, ("channel", "unit"), rows, frozenset({0, 1}), folded=len(rows) > 12)
    return Sheet("Record", fields, (channels, *_ledger_grid(record.history)))


def series_sheet(series: CoefficientSeries) -> Sheet:
    """Return what is shown of a series of coefficients.

    Parameters
    ----------
    series : CoefficientSeries
        The series.
    """
    return Sheet(
        "CoefficientSeries",
        (Field("source", series.source), *_series_fields(series)),
        _ledger_grid(series.history),
    )


def reduction_sheet(reduction: Reduction) -> Sheet:
    """Return what is shown of a reduction.

    Parameters
    ----------
    reduction : Reduction
        The reduction.
    """
    settings, (from_s, to_s) = reduction.settings, reduction.window_s
    low_pass = (
        "none"
        if settings.phase == "none"
        else f"order {settings.filter_order} at {settings.cutoff_hz:g} Hz, phase “{settings.phase}”"
    )
    flags = tuple(flag for entry in reduction.record.history for flag in entry.flags)
    fields = (
        Field("test", reduction.test.name),
        Field("quasi-steady cycles", f"{from_s:.3f} to {to_s:.3f} s"),
        Field("low-pass", low_pass),
        *_series_fields(reduction.series),
        *((Field("flags", flags, "advice"),) if flags else ()),
    )
    return Sheet("Reduction", fields, _ledger_grid(reduction.record.history))


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


def _series_fields(series: CoefficientSeries) -> tuple[Field, ...]:
    fitted = int(np.count_nonzero(series.segment))
    fields = [
        Field("rows", f"{series.n_samples} at {series.sample_rate_hz:g} Hz"),
        Field("facility clock", f"{series.time_s[0]:.3f} to {series.time_s[-1]:.3f} s"),
        Field("to be fitted", f"{fitted} rows in {_count(series.n_segments, 'segment')}"),
    ]
    for name, (label, factor, unit) in SIGNALS.items():
        values = getattr(series, name)
        if values is not None:
            fields.append(Field(label, f"{_range(values, factor)}{unit}"))
    if series.in_stall is not None:
        fields.append(Field("in stall", f"{100.0 * float(np.mean(series.in_stall)):.0f} % of rows"))
    if series.free_run is not None:
        scored = int(np.count_nonzero(series.free_run == 2))
        fields.append(Field("whole run", f"unfiltered columns are there; {scored} rows scored"))
    fields.append(Field("ledger", _ledger_words(series.history)))
    return tuple(fields)


def _range(values: NDArray[np.float64], factor: float) -> str:
    low, high = factor * float(np.min(values)), factor * float(np.max(values))
    return f"{significant(low, 3)} to {significant(high, 3)}"


def _milliseconds(value_s: float, stderr_s: float) -> str:
    if not math.isfinite(value_s):
        return "not known"
    return f"{round_to_error(1e3 * value_s, 1e3 * stderr_s)} ms"


def _ledger_words(history: tuple[LedgerEntry, ...]) -> str:
    dropped = sum(len(entry.dropped) for entry in history)
    flags = sum(len(entry.flags) for entry in history)
    left_out, flagged = _count(dropped, "thing"), _count(flags, "flag")
    return f"{_count(len(history), 'step')}; {left_out} left out, {flagged}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _ledger_grid(history: tuple[LedgerEntry, ...]) -> tuple[Grid, ...]:
    rows = tuple(
        (
            entry.step,
            entry.did,
            _parameters(entry.parameters),
            "; ".join(f"{d.what} ({d.count}): {d.why}" for d in entry.dropped) or "nothing",
            "; ".join(entry.flags) or "none",
        )
        for entry in history
    )
    header = ("step", "did", "parameters", "left out", "flags")
    words = frozenset(range(len(header)))
    return (Grid("Ledger", header, rows, words, folded=True),) if rows else ()


def _parameters(parameters: Mapping[str, str | int | float | bool]) -> str:
    told = (
        f"{name} = {f'{value:.6g}' if isinstance(value, float) else value}"
        for name, value in parameters.items()
    )
    return "; ".join(told) or "none"
