"""Several estimators side by side: fits, reconstructions, held-out scores, and the table.

All are scored on the same rows, those of the series' segments. They are fitted to these too, but
for those that take whole unfiltered records where the series carry them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from classic_ml.checks import CheckRow, coverage, input_correlation, residual_checks
from classic_ml.lag_regressor import LagRegressor
from classic_ml.series import CoefficientSeries
from classic_ml.whole_run import WholeRunFit
from comparisons.harness.estimators import EstimatorSpec, default_estimators, psi_breakpoints
from comparisons.harness.fit_quality import (
    FitScore,
    block_errors,
    paired_difference,
    score_fit,
    trusted_range,
)
from comparisons.harness.lag_value import FittedLag
from comparisons.harness.reconstruction import free_run_over
from comparisons.harness.record_cautions import (
    TAU_AGREEMENT,
    comparison_cautions,
    spread_speeds,
    told_time_constants,
)
from comparisons.harness.rows import FitRows, stack_rows
from comparisons.harness.structure import StructureChoice, structure_of
from surge_core.display import Displayed, Sheet
from surge_core.lag import Hold
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from comparisons.missing_effect.extended_lag import ExtendedLag

__all__ = ["Comparison", "ComparisonRow", "EstimatorResult", "compare_records"]

CURVE_POINTS = 121
Progress = Callable[[Iterable[EstimatorSpec]], Iterable[EstimatorSpec]]


@dataclass(frozen=True)
class EstimatorResult:
    """What one estimator made of the rows.

    Parameters
    ----------
    name, label : str
        Key and what people call it.
    model : FittedLag
        The fitted model as a value, from all rows.
    state, advice : str
        Code of how the fit ended and what to do about it.
    equation : str
        The model in one line.
    free_run, one_step : FitScore
        Scores over all rows.
    held_out : FitScore or None
        Free run on the rows held out, by a fit to the others; None where there were too few.
    reconstruction : ndarray of shape (n,)
        Free run over the fitted rows from each segment's measured start.
    trained : ndarray of shape (n,)
        The same by the fit to the training rows alone: what the held-out rows are scored with.
    errors_one_step : ndarray of shape (n,)
        One-step errors.
    held_out_blocks : ndarray of shape (n_blocks, 2)
        Squared error and rows of each held-out block, for paired differences.
    checks : tuple of CheckRow
        Residual checks.
    seconds : float
        Time of the fit.
    whole_run : WholeRunFit or None
        The free run through whole records behind it; None where it was fitted to the rows.
    structure : StructureChoice or None
        How sure the choice of terms is; None where they were given.
    remarks : tuple of str
        What the estimator itself warns of.
    extended : ExtendedLag or None
        The model with its effects, where it has any; ``model`` is then its characteristic and τ.
    """

    name: str
    label: str
    model: FittedLag
    state: str
    advice: str
    equation: str
    free_run: FitScore
    one_step: FitScore
    held_out: FitScore | None
    reconstruction: FloatArray
    trained: FloatArray
    errors_one_step: FloatArray
    held_out_blocks: FloatArray
    checks: tuple[CheckRow, ...]
    seconds: float
    whole_run: WholeRunFit | None = None
    structure: StructureChoice | None = None
    remarks: tuple[str, ...] = ()
    extended: ExtendedLag | None = None

    @property
    def converged(self) -> bool:
        """Whether the fit ended well."""
        return self.state == "converged"


@dataclass(frozen=True)
class ComparisonRow:
    """One line of the comparison table.

    Parameters
    ----------
    estimator, label : str
        Key and what people call it.
    rank : int
        1 for the least held-out error.
    held_out_rms : float
        Free-run error on held-out rows.
    difference, paired_error : float
        Of that rms to the best estimator's, on the same blocks.
    time_constant_s, time_constant_stderr_s : float
        τ and its standard error.
    trust : str
        A word on what to trust in this line.
    """

    estimator: str
    label: str
    rank: int
    held_out_rms: float
    difference: float
    paired_error: float
    time_constant_s: float
    time_constant_stderr_s: float
    trust: str


@dataclass(frozen=True)
class Comparison(Displayed):
    """Estimators side by side on the same rows of one or several records.

    Parameters
    ----------
    records : tuple of CoefficientSeries
        What was compared.
    rows : FitRows
        The rows that were fitted.
    results : tuple of EstimatorResult
        One for each estimator.
    table : tuple of ComparisonRow
        Best first.
    valid_phi : tuple of float
        Range of φ in which the curves can be trusted.
    cautions : tuple of str
        What a reader should know of all lines, from the records' ledgers.
    """

    records: tuple[CoefficientSeries, ...]
    rows: FitRows
    results: tuple[EstimatorResult, ...]
    table: tuple[ComparisonRow, ...]
    valid_phi: tuple[float, float]
    cautions: tuple[str, ...]

    @property
    def quotable(self) -> tuple[str, ...]:
        """Keys of the estimators whose τ is free of what a low-pass does: fitted, and measured.

        From whole unfiltered records of one speed, with all probes and the stall state from hub and
        tip, φ joined by lines, not refused, not held, told from zero and with φ over its range.
        """
        if spread_speeds(self.records) or not all(map(_is_clean_run, self.records)):
            return ()
        return tuple(
            result.name
            for result in self.results
            if result.whole_run is not None
            and result.converged
            and result.model.hold == "first"
            and all(check.passed for check in result.checks if check.check == "phi_coverage")
            and 0.0 < 2.0 * result.model.time_constant_stderr_s < result.model.time_constant_s
        )

    @property
    def has_whole_run(self) -> bool:
        """Whether an estimator was fitted to whole unfiltered records and not refused."""
        return any(
            result.whole_run is not None and math.isfinite(result.model.time_constant_s)
            for result in self.results
        )

    def result(self, name: str) -> EstimatorResult:
        """Return the result of one estimator."""
        return next(result for result in self.results if result.name == name)

    def _sheet(self) -> Sheet:
        from comparisons.show.sheets import comparison_sheet

        return comparison_sheet(self)


def compare_records(
    records: Sequence[CoefficientSeries],
    *,
    target: str = "psi_p",
    degree: int = 2,
    hold: Hold = "first",
    time_constant_s: float | None = None,
    estimators: Sequence[EstimatorSpec] | None = None,
    progress: Progress = iter,
) -> Comparison:
    """Fit each estimator to the same rows and set them side by side.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        One or several records at one sample rate.
    target : {"psi_p", "psi"}
        Which coefficient is modelled.
    degree : int
        Degree of the classical pressure characteristic.
    hold : {"zero", "first"}
        How φ acts between samples, for all estimators.
    time_constant_s : float, optional
        Hold τ of the classical estimators at this value, in seconds.
    estimators : sequence of EstimatorSpec, optional
        In place of :func:`default_estimators`.
    progress : callable
        Wraps the iteration over the estimators, to show how far it is.

    Raises
    ------
    InputError
        When the records do not go together or there is nothing to fit.
    """
    rows = stack_rows(records, target)
    # Fixed beforehand for all fits, as in the paper; one search serves them all.
    breakpoints = psi_breakpoints(rows, hold) if target == "psi" and not estimators else None
    specs = estimators or default_estimators(
        degree=degree, hold=hold, breakpoints=breakpoints, time_constant_s=time_constant_s
    )
    valid_phi = trusted_range(rows.phi)
    results = tuple(_run(spec, rows, records, hold, valid_phi) for spec in progress(specs))
    return Comparison(
        tuple(records),
        rows,
        results,
        _table(results),
        valid_phi,
        (
            *comparison_cautions(
                records, rows, results, degree=degree, hold=hold, held=time_constant_s is not None
            ),
            *(f"{result.name}: {text}" for result in results for text in result.remarks),
        ),
    )


def _is_clean_run(record: CoefficientSeries) -> bool:
    """Tell whether the ledger shows a free run on all probes, with the state from hub and tip."""
    return any(
        entry.step == "free run"
        and entry.parameters.get("stall_rule", "hub-tip") == "hub-tip"
        and entry.parameters.get("probes", "all") == "all"
        for entry in record.history
    )


def _run(
    spec: EstimatorSpec,
    rows: FitRows,
    records: Sequence[CoefficientSeries],
    hold: Hold,
    valid_phi: tuple[float, float],
) -> EstimatorResult:
    begin = time.perf_counter()
    estimator = spec.fitted(rows, records, None)
    seconds = time.perf_counter() - begin
    model = _value(estimator, spec, rows, hold, valid_phi)
    extended = getattr(estimator, "extended_", None)
    reconstruction = free_run_over(extended or model, rows, records)
    predicted, known = _one_step(estimator, model, rows, records)
    trained = _trained(spec, rows, records, hold, valid_phi)
    held_out, blocks = _held_out(rows, trained)
    state, advice = _state(estimator)
    errors = np.where(known, rows.measured - predicted, 0.0)
    return EstimatorResult(
        spec.name,
        spec.label,
        model,
        state,
        advice,
        (extended or model).equation(),
        score_fit(rows.measured, reconstruction),
        score_fit(rows.measured, predicted, known),
        held_out,
        reconstruction,
        reconstruction if trained is None else trained,
        errors,
        blocks,
        _checks(estimator, errors, rows, valid_phi),
        seconds,
        estimator if isinstance(estimator, WholeRunFit) else None,
        structure_of(estimator),
        tuple(text for text in getattr(estimator, "cautions_", ()) if text != advice),
        extended,
    )


def _value(
    estimator: Any,
    spec: EstimatorSpec,
    rows: FitRows,
    hold: Hold,
    valid_phi: tuple[float, float],
) -> FittedLag:
    grid = np.linspace(float(rows.phi.min()), float(rows.phi.max()), CURVE_POINTS)
    return FittedLag.from_estimator(estimator, spec.name, rows.target, hold, grid, valid_phi)


def _one_step(
    estimator: Any, model: FittedLag, rows: FitRows, records: Sequence[CoefficientSeries]
) -> tuple[FloatArray, Any]:
    """Ask the estimator for its own one-step predictor, or take the plain lag's."""
    if hasattr(estimator, "extended_"):
        prediction, known = estimator.extended_.one_step_over(rows, records)
        return prediction, known
    if hasattr(estimator, "one_step"):
        prediction, known = estimator.one_step(rows.X, rows.measured, rows.labels)
        return prediction, known
    prediction = model.one_step(rows.phi, rows.measured, rows.sample_period_s, rows.labels)
    known = np.ones(rows.measured.size, dtype=np.bool_)
    known[[run.start for run in rows.runs]] = False
    return prediction, known


def _trained(
    spec: EstimatorSpec,
    rows: FitRows,
    records: Sequence[CoefficientSeries],
    hold: Hold,
    valid_phi: tuple[float, float],
) -> FloatArray | None:
    """Return the free run over all rows of a fit to the training rows, or None without both."""
    if rows.train.all() or not rows.train.any():
        return None
    train = rows.part(rows.train)
    until_s = [
        float(train.time_s[train.record == i].max(initial=-np.inf)) for i in range(len(records))
    ]
    estimator = spec.fitted(train, records, until_s)
    model = _value(estimator, spec, train, hold, valid_phi)
    # Where the one segment is cut in two, the held-out part has a measured start of its own.
    labels = 2 * rows.labels + ~rows.train
    return free_run_over(getattr(estimator, "extended_", None) or model, rows, records, labels)


def _held_out(rows: FitRows, trained: FloatArray | None) -> tuple[FitScore | None, FloatArray]:
    if trained is None:
        return None, np.zeros((0, 2))
    test = rows.part(~rows.train)
    free_run = trained[~rows.train]
    return score_fit(test.measured, free_run), block_errors(test.measured - free_run, test.runs)


def _checks(
    estimator: Any, errors: FloatArray, rows: FitRows, valid_phi: tuple[float, float]
) -> tuple[CheckRow, ...]:
    if isinstance(estimator, WholeRunFit):
        return estimator.checks(valid_phi)
    if isinstance(estimator, LagRegressor):
        return residual_checks(estimator, rows.X, rows.measured, rows.labels, stated_phi=valid_phi)
    # The plain lag's prediction from a noisy row before it is never white: no noise model, no test
    # of one.
    return (
        input_correlation(errors, rows.phi, rows.runs),
        coverage(rows.phi, rows.runs, valid_phi),
    )


def _state(estimator: Any) -> tuple[str, str]:
    """Return code and advice of how a fit ended; an estimator without a state ended well."""
    state = getattr(estimator, "fit_state_", None)
    if state is None:
        return "converged", ""
    code = str(getattr(state, "code", state))
    return ("converged" if code == "ok" else code), str(getattr(state, "advice", ""))


def _table(results: tuple[EstimatorResult, ...]) -> tuple[ComparisonRow, ...]:
    def held_out_rms(result: EstimatorResult) -> float:
        return result.held_out.rms if result.held_out else math.nan

    ranked = sorted(results, key=lambda r: (math.isnan(held_out_rms(r)), held_out_rms(r)))
    best = ranked[0]
    rows = []
    for rank, result in enumerate(ranked, start=1):
        difference, paired_error = 0.0, 0.0
        if result is not best and result.held_out and best.held_out:
            difference, paired_error = paired_difference(
                result.held_out_blocks, best.held_out_blocks
            )
        rows.append(
            ComparisonRow(
                result.name,
                result.label,
                rank,
                held_out_rms(result),
                difference,
                paired_error,
                result.model.time_constant_s,
                result.model.time_constant_stderr_s,
                _trust(result, results, difference, paired_error),
            )
        )
    return tuple(rows)


def _trust(
    result: EstimatorResult,
    results: tuple[EstimatorResult, ...],
    difference: float,
    paired_error: float,
) -> str:
    """Say in words what in this line should not be relied on."""
    words = []
    if not result.converged:
        words.append(result.advice.rstrip("."))
    if result.held_out is None:
        words.append("no held-out rows: the rms is of the fit itself")
    elif result.held_out.r2 < 0.0:
        words.append("worse than a constant on held-out cycles")
    elif 0.0 < abs(difference) < 2.0 * paired_error:
        words.append("no worse than the best within the paired error")
    if result.whole_run is not None:
        words.append("fitted to unfiltered signals, scored here on the filtered rows of the others")
    # With an effect τ means another thing: a model that has one is measured by no other.
    plain = tuple(r for r in results if r.whole_run is None and r.extended is None)
    taus = told_time_constants(plain)
    tau = result.model.time_constant_s
    if len(taus) > 1 and tau in taus and abs(tau / np.median(taus) - 1.0) > TAU_AGREEMENT:
        words.append("τ off the others by more than 15 %")
    failed = [check.check for check in result.checks if not check.passed]
    if failed:
        words.append("failed: " + ", ".join(failed))
    return "; ".join(words) or "nothing speaks against it"
