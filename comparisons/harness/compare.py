"""Several estimators side by side: fits, reconstructions, held-out scores, and the table.

Each is scored on rows of the kind that it was fitted to: those of the series' segments, or the
averaged unfiltered rows of whole records. Errors are compared within a kind alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from classic_ml.checks import CheckRow, coverage, input_correlation, residual_checks
from classic_ml.lag_regressor import LagRegressor
from classic_ml.series import CoefficientSeries
from classic_ml.whole_run import WholeRunFit
from comparisons.harness.cautions import (
    comparison_cautions,
    spread_speeds,
    tau_caution,
)
from comparisons.harness.estimators import EstimatorSpec, default_estimators, psi_breakpoints
from comparisons.harness.fit_quality import rms, score_fit, trusted_range
from comparisons.harness.rows import averaged_rows, stack_rows
from comparisons.results import (
    Comparison,
    EstimatorResult,
    FitRows,
    FittedLag,
    LagModel,
)
from surge_core.fit_state import WITHHOLDING
from surge_core.lag import Hold
from surge_core.paired import block_errors, block_rms, compared
from surge_core.segments import runs_of
from surge_core.threads import one_thread
from surge_core.types import BoolArray, FloatArray

CURVE_POINTS = 121
Progress = Callable[[Iterable[EstimatorSpec]], Iterable[EstimatorSpec]]


@one_thread()
def compare_records(
    records: Sequence[CoefficientSeries],
    *,
    target: str = "psi_p",
    hold: Hold = "first",
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
    hold : {"zero", "first"}
        How φ acts between samples, for all estimators.
    estimators : sequence of EstimatorSpec, optional
        What is fitted, with this hold; without it :func:`default_estimators`.
    progress : callable
        Wraps the iteration over the estimators, to show how far it is.

    Raises
    ------
    InputError
        When the records do not go together or there is nothing to fit.
    """
    rows = stack_rows(records, target)
    # Fixed beforehand for all fits, as in the paper; one search serves them all.
    ends = psi_breakpoints(rows, hold) if target == "psi" and not estimators else None
    specs = estimators or default_estimators(hold=hold, breakpoints=ends)
    averaged = averaged_rows(records, _until_s(rows, records)) if target == "psi_p" else None
    found = tuple(_run(spec, rows, averaged, records, hold) for spec in progress(specs))
    quotable = _quotable(records, found)
    results = _in_order(found, quotable)
    histories = [record.history for record in records]
    biased = tau_caution(histories, target=target, quotable=quotable)
    cautions = (
        *([biased] if biased else []),
        *comparison_cautions(records, rows, results),
    )
    return Comparison(tuple(records), rows, results, cautions, quotable)


def _quotable(
    records: Sequence[CoefficientSeries], results: tuple[EstimatorResult, ...]
) -> tuple[str, ...]:
    """Return the estimators whose τ is free of what a low-pass does: fitted, and measured.

    From whole unfiltered records of one speed, with the stall state from hub and tip, φ joined by
    lines, not refused, not held, separated from zero, with φ over the range
    of the rows that were scored, and errors that do not depend on φ: else the model lacks something
    (a record whose plane 31 was 5 ms late read 34 ± 3 ms for 18).
    """
    if spread_speeds(records) or not all(map(_is_clean_run, records)):
        return ()
    first = [result for result in results if result.name == "classic_ml"]
    # Where `classic_ml` cannot tell, the others are not believed alone: they know no twins.
    if any(result.state in WITHHOLDING for result in first):
        return ()
    found = [
        result
        for result in results
        if result.whole_run is not None
        and result.converged
        and result.model.hold == "first"
        and result.model.measured
        and not {"phi_coverage", "input_correlation"}.intersection(result.failed)
    ]
    # Where it lacks something, another with the same curve lacks it too (13.8 ± 0.8 ms for 20).
    lacking = [each.model.terms for each in first if each not in found]
    names = [each.name for each in found if each.model.terms not in lacking]
    # The paper's estimator leads where both may be quoted.
    return tuple(sorted(names, key=lambda name: name != "classic_ml"))


def _is_clean_run(record: CoefficientSeries) -> bool:
    """Whether the ledger shows a free run with the state from hub and tip."""
    return any(
        entry.step == "free run" and entry.parameters.get("stall_rule", "hub-tip") == "hub-tip"
        for entry in record.history
    )


def _run(
    spec: EstimatorSpec,
    rows: FitRows,
    averaged: FitRows | None,
    records: Sequence[CoefficientSeries],
    hold: Hold,
) -> EstimatorResult:
    begin = time.perf_counter()
    estimator = spec.fitted(rows, records, None)
    seconds = time.perf_counter() - begin
    model = fitted_value(estimator, spec.name, rows, hold)
    extended = getattr(estimator, "extended_", None)
    scored = averaged if averaged and isinstance(estimator, WholeRunFit) else rows
    reconstruction = (extended or model).free_run_over(scored, records)
    free_run = score_fit(scored.measured, reconstruction)
    model = replace(model, rows=scored.kind, free_run_rms=free_run.rms)
    predicted, known = _one_step(estimator, model, scored, records)
    trained = _trained(spec, rows, scored, records, hold)
    held_out = None
    if trained is not None:
        held_out = score_fit(scored.measured, trained, ~scored.train)
    state, advice = _state(estimator)
    errors = np.where(known, scored.measured - predicted, 0.0)
    return EstimatorResult(
        name=spec.name,
        label=_label(spec, estimator),
        model=model,
        state=state,
        advice=advice,
        equation=(extended or model).equation(),
        rows=scored,
        free_run=free_run,
        one_step=score_fit(scored.measured, predicted, known),
        held_out=held_out,
        reconstruction=reconstruction,
        trained=reconstruction if trained is None else trained,
        checks=_checks(estimator, errors, rows, model.valid_phi),
        seconds=seconds,
        whole_run=estimator if isinstance(estimator, WholeRunFit) else None,
        remarks=tuple(text for text in getattr(estimator, "cautions_", ()) if text != advice),
        extended=extended,
    )


def _label(spec: EstimatorSpec, estimator: Any) -> str:
    """Name an estimator of whole runs that had to take the rows by what it then is."""
    if spec.fit_records is None or isinstance(estimator, WholeRunFit):
        return spec.label
    noise = getattr(estimator, "noise", None)
    return spec.label if noise is None else f"{noise} on the rows"


def fitted_value(estimator: Any, name: str, rows: FitRows, hold: Hold) -> FittedLag:
    """Take the numbers out of a fitted estimator of this name, its curve over the φ of the rows.

    It has ``time_constant_s_``, ``time_constant_stderr_s_``, ``terms_``, ``coef_``, ``covariance_``
    and ``characteristic(phi)``.
    """
    grid = np.linspace(float(rows.phi.min()), float(rows.phi.max()), CURVE_POINTS)
    value, stderr = estimator.characteristic(grid)
    phi = rows.phi
    if isinstance(estimator, WholeRunFit):
        # It scores rows in forward flow alone: those in reversed flow, which the others fit, it
        # simulates through.
        trusted = estimator.trusted_phi
        phi = trusted if trusted.size else phi
    return FittedLag(
        name,
        rows.target,
        float(estimator.time_constant_s_),
        float(estimator.time_constant_stderr_s_),
        tuple(estimator.terms_),
        tuple(float(b) for b in estimator.coef_),
        tuple(float(s) for s in np.sqrt(np.maximum(np.diag(estimator.covariance_), 0.0))),
        hold,
        trusted_range(phi),
        tuple(zip(grid.tolist(), value.tolist(), stderr.tolist(), strict=True)),
        int(getattr(estimator, "n_blocks_", 0)),
        float(np.nan_to_num(getattr(estimator, "dead_time_s_", 0.0))),
        getattr(estimator, "ci95_s_", None),
        _joint_covariance(estimator),
    )


def _joint_covariance(estimator: Any) -> tuple[float, ...]:
    """Return the covariance of τ and the coefficients, uncorrelated where it is not said."""
    joint = getattr(estimator, "parameter_covariance_", None)
    if joint is None:
        stderr_s = float(estimator.time_constant_stderr_s_)
        joint = block_diag([[stderr_s**2]], np.asarray(estimator.covariance_))
    return tuple(np.ravel(joint).tolist()) if np.all(np.isfinite(joint)) else ()


def _one_step(
    estimator: Any, model: FittedLag, rows: FitRows, records: Sequence[CoefficientSeries]
) -> tuple[FloatArray, BoolArray]:
    """Ask the estimator for its own one-step predictor, or take the plain lag's."""
    if hasattr(estimator, "extended_"):
        prediction, known = estimator.extended_.one_step_over(rows, records)
        return prediction, known
    if hasattr(estimator, "one_step"):
        prediction, known = estimator.one_step(rows.X, rows.measured, rows.labels)
        return prediction, known
    prediction = model.one_step_over(rows)
    known = np.ones(rows.measured.size, dtype=np.bool_)
    known[[run.start for run in rows.runs]] = False
    return prediction, known


def _until_s(rows: FitRows, records: Sequence[CoefficientSeries]) -> list[float]:
    """Return the time up to which each record is fitted where the rest is held out."""
    train, time_s = rows.train, rows.time_s
    return [
        float(time_s[train & (rows.record == i)].max(initial=-np.inf)) for i in range(len(records))
    ]


def _trained(
    spec: EstimatorSpec,
    rows: FitRows,
    scored: FitRows,
    records: Sequence[CoefficientSeries],
    hold: Hold,
) -> FloatArray | None:
    """Return the free run over the scored rows of a fit to the training rows; None without both."""
    if any(each.train.all() or not each.train.any() for each in (rows, scored)):
        return None
    train = rows.part(rows.train)
    estimator = spec.fitted(train, records, _until_s(rows, records))
    extended = getattr(estimator, "extended_", None)
    model: LagModel = extended or fitted_value(estimator, spec.name, train, hold)
    # Where the one segment is cut in two, the held-out part has a measured start of its own.
    return model.free_run_over(scored, records, 2 * scored.labels + ~scored.train)


def _checks(
    estimator: Any, errors: FloatArray, rows: FitRows, valid_phi: tuple[float, float]
) -> tuple[CheckRow, ...]:
    """Check each estimator on the rows that it scores."""
    if isinstance(estimator, WholeRunFit):
        return estimator.checks(valid_phi)
    if isinstance(estimator, LagRegressor):
        return residual_checks(estimator, rows.X, rows.measured, rows.labels, stated_phi=valid_phi)
    visited = coverage(rows.phi, rows.runs, valid_phi)
    if not errors.any():
        # A method without a prediction one step ahead.
        return (visited,)
    # The plain lag's prediction from a noisy row before it is never white: no noise model, no test
    # of one.
    return input_correlation(errors, rows.phi, rows.runs), visited


def _state(estimator: Any) -> tuple[str, str]:
    """Return code and advice of how a fit ended; an estimator without a state ended well."""
    state = getattr(estimator, "fit_state_", None)
    if state is None:
        return "converged", ""
    code = str(getattr(state, "code", state))
    return ("converged" if code == "ok" else code), str(getattr(state, "advice", ""))


def _in_order(
    results: tuple[EstimatorResult, ...], quotable: tuple[str, ...]
) -> tuple[EstimatorResult, ...]:
    """Set the estimator whose τ is to be quoted first, then order by trust; add the differences."""

    def distrust(result: EstimatorResult) -> tuple[int, bool, bool, bool, int]:
        # No error of a free run: a low one is no evidence of a right τ. A whole run that withholds
        # its τ says more than a fit to low-passed rows that is known to have failed.
        failed = not result.converged or bool(result.failed)
        return (
            quotable.index(result.name) if result.name in quotable else len(quotable),
            result.whole_run is None and failed,
            not result.converged,
            not result.model.measured,
            len(result.failed),
        )

    errors, ordered = {}, []
    for result in results:
        left_out = ~result.rows.train & (result.held_out is not None)
        errors[result.name] = (result.rows.measured - result.trained)[left_out]
    for result in sorted(results, key=distrust):
        own, kind = errors[result.name], result.rows.kind
        labels = result.rows.labels[~result.rows.train]
        runs = runs_of(labels, labels.size) if own.size else []
        alike = [errors[r.name] for r in results if r.rows.kind == kind and errors[r.name].size]
        difference, paired_error, p_value = compared(own, min(alike, key=rms, default=own), runs)
        set_beside = replace(
            result,
            held_out_stderr=block_rms(block_errors(own, runs))[1],
            difference=difference,
            paired_error=paired_error,
            p_value=p_value,
            trust=_trust(result),
        )
        ordered.append(set_beside)
    return tuple(ordered)


def _trust(result: EstimatorResult) -> str:
    """Say in words what in this line should not be relied on."""
    words = []
    if result.second_reading is not None:
        low_s, high_s = result.second_reading.ci95_s
        words.append(
            f"the rows in stall alone read {1e3 * result.second_reading.value_s:.3g} ms "
            f"({1e3 * low_s:.3g} to {1e3 * high_s:.3g}): the interval spans both"
        )
    if not result.converged:
        words.append(result.advice.rstrip("."))
    if result.held_out is None:
        words.append("no held-out rows: the rms is of the fit itself")
    elif result.held_out.r2 < 0.0:
        words.append("worse than a constant on held-out cycles")
    if result.failed:
        words.append("failed: " + ", ".join(result.failed))
    return "; ".join(words) or "nothing speaks against it"
