"""The estimators of a study: those of the comparison, and anybody's own classes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.harness.methods import OwnMethod
from comparisons.study.sources import Made
from comparisons.study.spec import Method

CURVE_POINTS = 50
NAN = float("nan")


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
    own = OwnMethod(method.import_path, method.name, method.parameters)
    if method.import_path:
        naming = own.naming()
        if naming is not None:
            names = tuple(naming(records))
            wrong = [name for name in names if name not in made.effects]
            counts = {"firm_names": float(len(names)), "false_names": float(len(wrong))}
            return {"state": "ok", "reason": ", ".join(names), **counts}

    from comparisons.harness.compare import compare_records
    from comparisons.harness.estimators import default_estimators

    if method.import_path:
        spec = own.spec()
    else:
        spec = {each.name: each for each in default_estimators(**fit)}[method.name]
    comparison = compare_records(records, estimators=[spec], **fit)
    result = comparison.results[0]
    model = result.model
    out: dict[str, Any] = {
        "state": "ok" if result.state == "converged" else result.state,
        "reason": "" if result.state == "converged" else result.advice,
        "scored": result.rows.kind,
        "tau_ms": 1e3 * model.time_constant_s,
        "tau_stderr_ms": 1e3 * model.time_constant_stderr_s,
        "free_run_rms": result.free_run.rms,
        "free_run_percent": result.free_run.fit_percent,
        "one_step_rms": result.one_step.rms,
        "held_out_rms": NAN if result.held_out is None else result.held_out.rms,
        "held_out_percent": NAN if result.held_out is None else result.held_out.fit_percent,
        "n_terms": float(len(model.terms)) if model.terms else NAN,
    }
    if np.isfinite(made.tau_s) and result.has_tau:
        low, high = model.ci95_s
        out["tau_error_ms"] = 1e3 * (model.time_constant_s - made.tau_s)
        # What a fit says is not to be used states no interval either.
        stated = result.state in ("converged", "two_readings")
        if stated and np.isfinite(low) and np.isfinite(high):
            out["tau_covered"] = float(low <= made.tau_s <= high)
    # Where this method scored φ, as far as the truth is known there.
    low, high = np.clip(model.valid_phi, *made.known_phi)
    if low < high and made.curve is not None and result.has_curve and result.states_curve:
        phi = np.linspace(low, high, CURVE_POINTS)
        error = model.quasi_steady(phi) - made.curve(phi)
        out["curve_rms_error"] = float(np.sqrt(np.mean(error**2)))
    return out
