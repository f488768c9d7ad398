"""The estimators of a study: those of the comparison, and others that follow scikit-learn."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Sequence
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.results import FitRows
from comparisons.study.sources import Made
from comparisons.study.spec import Method
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["check_methods", "scores_of"]

CURVE_POINTS = 50
NAN = float("nan")


def check_methods(methods: Sequence[Method]) -> None:
    """Refuse, before anything is computed, a class that cannot be had or made.

    Parameters
    ----------
    methods : sequence of Method
        Estimators of a study.

    Raises
    ------
    InputError
        Naming the method.
    """
    for method in methods:
        if method.import_path:
            made = _made(method, 1e-3)
            if not (hasattr(made, "fit") and hasattr(made, "predict")):
                expected = "a class with fit and predict, as scikit-learn has them"
                raise InputError(f"method {method.name}", expected=expected, found=repr(made))


def scores_of(
    method: Method,
    records: Sequence[CoefficientSeries],
    made: Made,
    fit: dict[str, Any],
) -> dict[str, Any]:
    """Fit one method to the records of a cell and return its scores.

    Parameters
    ----------
    method : Method
        The estimator.
    records : sequence of CoefficientSeries
        What it is fitted to.
    made : Made
        With the truth, where it is known.
    fit : dict
        Degree and hold.

    Returns
    -------
    dict
        ``state``, ``reason``, scores by name, and what else is known.
    """
    if method.import_path:
        probe = _made(method, records[0].sample_period_s)
        if not _may_be_lag(probe):
            return _regressor_scores(method, records, made)
        # A class has a hold of its own, by which it is simulated.
        fit = {**fit, "hold": getattr(probe, "hold", fit["hold"])}
    return _lag_scores(method, records, made, fit)


def _made(method: Method, sample_period_s: float) -> Any:
    """Make an estimator of another class; the sample period is passed where it takes one."""
    module, _, name = method.import_path.partition(":")
    try:
        factory = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise InputError(
            f"method {method.name}",
            expected=f"a class at {method.import_path}",
            found=str(error),
            remedy="install its package where the workers run, or put its folder into PYTHONPATH",
        ) from error
    parameters = dict(method.parameters)
    try:
        if "sample_period_s" in inspect.signature(factory).parameters:
            parameters.setdefault("sample_period_s", sample_period_s)
        return factory(**parameters)
    except Exception as error:
        raise InputError(
            f"method {method.name}: parameters",
            expected=f"what {method.import_path} takes",
            found=f"{type(error).__name__}: {error}",
        ) from error


def _may_be_lag(estimator: Any) -> bool:
    """Return whether a class promises the contract of the lag estimators."""
    return callable(getattr(estimator, "characteristic", None))


def _lag_scores(
    method: Method, records: Sequence[CoefficientSeries], made: Made, fit: dict[str, Any]
) -> dict[str, Any]:
    from comparisons.harness.compare import compare_records
    from comparisons.harness.estimators import EstimatorSpec, default_estimators

    if not method.import_path:
        specs = {spec.name: spec for spec in default_estimators(**fit)}
        spec = specs[method.name]
    else:

        def made_and_fitted(rows: FitRows, _: Sequence[CoefficientSeries]) -> Any:
            made = _made(method, rows.sample_period_s)
            return _fitted(made, rows.X, rows.measured, rows.labels)

        spec = EstimatorSpec(
            method.name,
            method.name,
            made_and_fitted,
        )
    comparison = compare_records(records, estimators=[spec], **fit)
    result = comparison.results[0]
    model = result.model
    out: dict[str, Any] = {
        "state": "ok" if result.state == "converged" else result.state,
        "reason": "" if result.state == "converged" else result.advice,
        "tau_ms": 1e3 * model.time_constant_s,
        "tau_stderr_ms": 1e3 * model.time_constant_stderr_s,
        "free_run_rms": result.free_run.rms,
        "free_run_percent": result.free_run.fit_percent,
        "one_step_rms": result.one_step.rms,
        "held_out_rms": NAN if result.held_out is None else result.held_out.rms,
        "held_out_percent": NAN if result.held_out is None else result.held_out.fit_percent,
        "n_terms": float(len(model.terms)),
    }
    if np.isfinite(made.tau_s):
        low, high = model.ci95_s
        out["tau_error_ms"] = 1e3 * (model.time_constant_s - made.tau_s)
        # What a fit says is not to be used states no interval either.
        if result.state == "converged" and np.isfinite(low) and np.isfinite(high):
            out["tau_covered"] = float(low <= made.tau_s <= high)
    if made.beta:
        out["curve_rms_error"] = _curve_error(model.quasi_steady, made, comparison.valid_phi)
    return out


def _curve_error(curve: Any, made: Made, valid_phi: tuple[float, float]) -> float:
    """Return the rms difference of a characteristic to the truth over the trusted flows."""
    phi = np.linspace(*valid_phi, CURVE_POINTS)
    truth = np.polynomial.polynomial.polyval(phi, np.asarray(made.beta))
    return float(np.sqrt(np.mean((np.asarray(curve(phi)) - truth) ** 2)))


def _regressor_scores(
    method: Method, records: Sequence[CoefficientSeries], made: Made
) -> dict[str, Any]:
    """Score any regressor by what it predicts: it has no characteristic, and perhaps no τ."""
    from comparisons.harness.fit_quality import score_fit
    from comparisons.harness.rows import stack_rows

    rows = stack_rows(records, "psi_p")
    estimator = _fitted(_made(method, rows.sample_period_s), rows.X, rows.measured, rows.labels)
    free = score_fit(rows.measured, _predicted(estimator, rows.X, rows.labels))
    out: dict[str, Any] = {
        "state": "ok",
        "reason": "",
        "free_run_rms": free.rms,
        "free_run_percent": free.fit_percent,
    }
    if rows.train.any() and not rows.train.all():
        train, test = rows.part(rows.train), rows.part(~rows.train)
        trained = _fitted(
            _made(method, rows.sample_period_s), train.X, train.measured, train.labels
        )
        labels = 2 * rows.labels + ~rows.train
        held = score_fit(test.measured, _predicted(trained, rows.X, labels)[~rows.train])
        out |= {"held_out_rms": held.rms, "held_out_percent": held.fit_percent}
    tau_s = float(getattr(estimator, "time_constant_s_", NAN))
    if np.isfinite(tau_s):
        out["tau_ms"] = 1e3 * tau_s
        if np.isfinite(made.tau_s):
            out["tau_error_ms"] = 1e3 * (tau_s - made.tau_s)
    return out


def _fitted(estimator: Any, X: FloatArray, y: FloatArray, labels: Any) -> Any:
    """Fit a foreign class to copies: what it scales in place is scored as measured."""
    if "segments" in inspect.signature(estimator.fit).parameters:
        fitted = estimator.fit(X.copy(), y.copy(), segments=labels.copy())
    else:
        fitted = estimator.fit(X.copy(), y.copy())
    if fitted is None:
        raise InputError("fit", expected="the estimator itself returned", found="None")
    return fitted


def _predicted(estimator: Any, X: FloatArray, labels: Any) -> FloatArray:
    if "segments" in inspect.signature(estimator.predict).parameters:
        found = estimator.predict(X.copy(), segments=labels.copy())
    else:
        found = estimator.predict(X.copy())
    values = np.asarray(found, dtype=np.float64).reshape(-1)
    if not np.all(np.isfinite(values)):
        raise InputError("predict", expected="finite values", found="NaN or infinite ones")
    if values.size != X.shape[0]:
        raise InputError("predict", expected=f"{X.shape[0]} values", found=f"{values.size}")
    return values
