"""What a wrong surge start and a wrong plenum volume do to both methods, recomputed for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.records import Record
from classic_ml.reduction import reduce_record
from classic_ml.reduction_settings import ReductionSettings
from comparisons.harness.estimators import default_estimators
from comparisons.harness.rows import stack_rows
from comparisons.total_system.fit import fit_total_system
from comparisons.total_system.fitted import ALIGNED, MULTIPLE, TotalSystemSettings
from comparisons.total_system.measured import measured_signals
from surge_core.display import Field, Grid, Sheet
from surge_core.rounding import NOT_KNOWN, round_to_error, significant

COMPONENT = "component"
METHODS = (COMPONENT, MULTIPLE, ALIGNED)
# The paper's own range of trust at 98.5 % ends at 0.175; below 0 nothing is measured well.
PHI_OF_TABLE = np.array([0.0, 0.05, 0.1, 0.15])
# Start errors in seconds and factors on the volume: shifts that the notes on the rig measured the
# output error of, and a wrong volume.
ERRORS = ((0.002, 1.0), (0.010, 1.0), (0.040, 1.0), (0.0, 1.1))
NO_ERROR = (0.0, 1.0)
# Rows of the whole table: each method without an error and under each.
N_ROWS = len(METHODS) * (1 + len(ERRORS))


def sensitivity_rows(
    record: Record,
    test: TestDescription,
    settings: TotalSystemSettings,
    *,
    errors: Sequence[tuple[float, float]] = ERRORS,
    progress: Callable[[str], object] = lambda _: None,
) -> list[dict[str, Any]]:
    """Return β and τ of both methods, each without an error and under each error.

    A start error of e says that the surge began e later on the facility's clock than it did. The
    total-system method runs its model from there. The component method gets the record with its
    clock moved by as much against test.toml's near-stall reading and window, and is reduced and
    fitted again; the only volume that it takes is the one between the planes, which is scaled by
    the same factor.

    Parameters
    ----------
    record : Record
        The raw record.
    test : TestDescription
        Its test.
    settings : TotalSystemSettings
        Facility and switches; ``start``, ``start_error_s`` and ``volume_factor`` are set here.
    errors : sequence of (float, float)
        Start errors in seconds with volume factors.
    progress : callable
        Called with a word on each fit before it runs.

    Returns
    -------
    list of dict
        By method, the one without an error first: ``method`` ("component", or how the total-system
        method takes the surge start); ``perturbation``, what was wrong, in words, and in numbers
        ``start_error_s`` and ``volume_factor``; ``beta``, ``tau_s`` and their standard errors;
        ``state`` in which the fit ended; ``P31_rms`` over its swing, NaN for the component method,
        which does not simulate it; and against the same method without the error ``tau_change`` as
        a share, ``beta_change``, and ``curve_change``, the largest of ψ'_QS at `PHI_OF_TABLE`.

    Raises
    ------
    InputError
        When the record cannot be used.
    """
    measured = measured_signals(record, test)
    rows: list[dict[str, Any]] = []
    for method in METHODS:
        right: dict[str, Any] = {}
        for error_s, factor in (NO_ERROR, *errors):
            words = f"start {1e3 * error_s:+g} ms" if error_s else f"volume x {factor:g}"
            words = "none" if (error_s, factor) == NO_ERROR else words
            progress(f"{method}: {words}")
            row: dict[str, Any] = {
                "method": method,
                "perturbation": words,
                "start_error_s": error_s,
                "volume_factor": factor,
            }
            if method == COMPONENT:
                row |= _component(record, test, error_s, factor)
            else:
                chosen = replace(
                    settings, start=method, start_error_s=error_s, volume_factor=factor
                )
                fit = fit_total_system(measured, chosen)
                names = ("beta", "beta_stderr", "tau_s", "tau_stderr_s")
                row |= {name: getattr(fit, name) for name in names}
                row |= {"state": fit.state.code, "P31_rms": fit.relative_rms["P31"]}
            right = right or row
            change = np.subtract(row["beta"], right["beta"])
            curve = np.polynomial.polynomial.polyval(PHI_OF_TABLE, change)
            row["tau_change"] = row["tau_s"] / right["tau_s"] - 1.0
            row["beta_change"] = tuple(change.tolist())
            row["curve_change"] = float(np.max(np.abs(curve)))
            rows.append(row)
    return rows


def _component(
    record: Record, test: TestDescription, error_s: float, factor: float
) -> dict[str, Any]:
    """Reduce and fit the component method again with what it would take as known."""
    volume_m3 = factor * test.compressor.internal_volume_m3
    machine = test.compressor.model_copy(update={"internal_volume_m3": volume_m3})
    moved = replace(record, start_s=record.start_s - error_s)
    reduction = reduce_record(moved, replace(test, compressor=machine), ReductionSettings())
    rows = stack_rows([reduction.series])
    spec = next(s for s in default_estimators() if s.name == "classic_ml")
    model = spec.fit_rows(rows, [reduction.series])
    return {
        "beta": tuple(model.coef_.tolist()),
        "beta_stderr": tuple(np.sqrt(np.diag(model.covariance_)).tolist()),
        "tau_s": float(model.time_constant_s_),
        "tau_stderr_s": float(model.time_constant_stderr_s_),
        "state": model.fit_state_.code,
        "P31_rms": float("nan"),
    }


def sensitivity_table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as an aligned table for a terminal.

    Parameters
    ----------
    rows : sequence of dict
        As of `sensitivity_rows`.
    """
    heads = ("method", "wrong", "β₁", "β₂", "β₃", "τ [ms]", "Δτ", "Δψ'_QS", "P31", "state")
    legend = (
        "Δ: against the same method without the error",
        "Δψ'_QS: largest of φ = 0, 0.05, 0.1, 0.15",
        "P31: residual over swing",
    )
    grid = Grid("β and τ", heads, tuple(map(_cells, rows)), frozenset((0, 1, len(heads) - 1)))
    title = "What wrong numbers do to both methods"
    return Sheet(title, (Field("columns", legend),), (grid,)).text()


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    share = f"{100.0 * row['P31_rms']:.1f} %" if np.isfinite(row["P31_rms"]) else NOT_KNOWN
    return (
        row["method"],
        row["perturbation"],
        *map(round_to_error, row["beta"], row["beta_stderr"]),
        round_to_error(1e3 * row["tau_s"], 1e3 * row["tau_stderr_s"]),
        f"{100.0 * row['tau_change']:+.1f} %",
        significant(row["curve_change"], 2) if row["curve_change"] else "0",
        share,
        row["state"],
    )
