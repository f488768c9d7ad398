"""What a wrong surge start and a wrong plenum volume do to both methods, recomputed for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.records import Record
from classic_ml.reduction import ReductionSettings, reduce_record
from comparisons.harness.estimators import default_estimators
from comparisons.harness.rows import stack_rows
from comparisons.total_system.facility import Facility
from comparisons.total_system.fit import fit_total_system
from comparisons.total_system.measured import measured_signals
from surge_core.display import Field, Grid, Sheet
from surge_core.rounding import round_to_error, significant

__all__ = ["ERRORS", "METHODS", "SensitivityRow", "sensitivity_rows", "sensitivity_table"]

COMPONENT = "component"
METHODS = (COMPONENT, "total-system")
# The paper's own range of trust at 98.5 % ends at 0.175; below 0 nothing is measured well.
PHI_OF_TABLE = np.array([0.0, 0.05, 0.1, 0.15])
# Start errors in seconds and factors on the volume, each row's words with it: shifts that the notes
# on the rig measured the output error of, and a wrong volume.
ERRORS = {
    "none": (0.0, 1.0),
    "start +2 ms": (0.002, 1.0),
    "start +10 ms": (0.010, 1.0),
    "start +40 ms": (0.040, 1.0),
    "volume x 1.1": (0.0, 1.1),
}


@dataclass(frozen=True)
class SensitivityRow:
    """One method under one error of what it takes as known.

    Parameters
    ----------
    method : {"component", "total-system"}
        The method.
    perturbation : str
        What was wrong: a key of `ERRORS`.
    beta, beta_stderr : tuple of float
        Coefficients of ψ'_QS on 1, φ, φ².
    tau_s, tau_stderr_s : float
        Time constant, in seconds.
    state : str
        How the fit ended.
    tau_change : float
        Change of τ over the same method's τ without the error.
    curve_change : float
        Largest change of ψ'_QS at φ = 0, 0.05, 0.1 and 0.15.
    """

    method: str
    perturbation: str
    beta: tuple[float, ...]
    beta_stderr: tuple[float, ...]
    tau_s: float
    tau_stderr_s: float
    state: str
    tau_change: float = 0.0
    curve_change: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Return the row as plain JSON types."""
        return asdict(self)

    def against(self, right: SensitivityRow) -> SensitivityRow:
        """Return the row with its changes against the same method without an error."""
        change = np.subtract(self.beta, right.beta)
        curve = np.polynomial.polynomial.polyval(PHI_OF_TABLE, change)
        return replace(
            self,
            tau_change=self.tau_s / right.tau_s - 1.0,
            curve_change=float(np.max(np.abs(curve))),
        )


def sensitivity_rows(
    record: Record,
    test: TestDescription,
    facility: Facility,
    *,
    errors: Sequence[str] = tuple(ERRORS),
    progress: Callable[[], object] = lambda: None,
) -> list[SensitivityRow]:
    """Return β and τ of both methods under each error.

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
    facility : Facility
        The facility's numbers.
    errors : sequence of str
        Keys of `ERRORS`, "none" first.
    progress : callable
        Called after each fit.

    Returns
    -------
    list of SensitivityRow
        By method, then by error.

    Raises
    ------
    InputError
        When the record cannot be used.
    """
    measured = measured_signals(record, test)
    right = fit_total_system(measured, facility)
    rows: list[SensitivityRow] = []
    for method in METHODS:
        own: list[SensitivityRow] = []
        for words in errors:
            error_s, factor = ERRORS[words]
            if method == COMPONENT:
                row = _component(record, test, words)
            else:
                volumes = facility.volumes
                wrong = volumes.model_copy(update={"discharge_m3": factor * volumes.discharge_m3})
                chosen = facility.model_copy(update={"volumes": wrong})
                fit = fit_total_system(measured, chosen, start_error_s=error_s, near=right)
                row = SensitivityRow(
                    method,
                    words,
                    fit.beta,
                    fit.beta_stderr,
                    fit.tau_s,
                    fit.tau_stderr_s,
                    fit.state.code,
                )
            own.append(row.against(own[0] if own else row))
            progress()
        rows += own
    return rows


def _component(record: Record, test: TestDescription, words: str) -> SensitivityRow:
    """Reduce and fit the component method again with what it would take as known."""
    error_s, factor = ERRORS[words]
    volume_m3 = factor * test.compressor.internal_volume_m3
    machine = test.compressor.model_copy(update={"internal_volume_m3": volume_m3})
    moved = replace(record, start_s=record.start_s - error_s)
    series = reduce_record(moved, replace(test, compressor=machine), ReductionSettings()).series
    spec = next(s for s in default_estimators() if s.name == "classic_ml")
    model = spec.fit_rows(stack_rows([series]), [series])
    return SensitivityRow(
        COMPONENT,
        words,
        tuple(model.coef_.tolist()),
        tuple(np.sqrt(np.diag(model.covariance_)).tolist()),
        float(model.time_constant_s_),
        float(model.time_constant_stderr_s_),
        model.fit_state_.code,
    )


def sensitivity_table(rows: Sequence[SensitivityRow]) -> str:
    """Return the rows as an aligned table for a terminal.

    Parameters
    ----------
    rows : sequence of SensitivityRow
        Rows of `sensitivity_rows`.
    """
    heads = ("method", "wrong", "β₁", "β₂", "β₃", "τ [ms]", "Δτ", "Δψ'_QS", "state")
    legend = (
        "Δ: against the same method without the error",
        "Δψ'_QS: largest of φ = 0, 0.05, 0.1, 0.15",
    )
    cells = tuple(
        (
            row.method,
            row.perturbation,
            *map(round_to_error, row.beta, row.beta_stderr),
            round_to_error(1e3 * row.tau_s, 1e3 * row.tau_stderr_s),
            f"{100.0 * row.tau_change:+.1f} %",
            significant(row.curve_change, 2) if row.curve_change else "0",
            row.state,
        )
        for row in rows
    )
    grid = Grid("β and τ", heads, cells, frozenset((0, 1, len(heads) - 1)))
    title = "What wrong numbers do to both methods"
    return Sheet(title, (Field("columns", legend),), (grid,)).text()
