"""A comparison as JSON, in the schema that other programs rely on."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.results import Comparison, EstimatorResult
from surge_core.terms import terms_json

COMPARE_SCHEMA = "sindy-surge/compare/1"


def comparison_document(comparison: Comparison, work: Comparison | None = None) -> dict[str, Any]:
    """Return the document of ``compare --json``.

    Parameters
    ----------
    comparison : Comparison
        Of the pressure coefficient ψ'.
    work : Comparison, optional
        Of the work coefficient ψ, under the key ``work_coefficient``.
    """
    document = {"schema": COMPARE_SCHEMA, **_body(comparison)}
    if work is not None:
        document["work_coefficient"] = _body(work)
    return document


def record_document(record: CoefficientSeries) -> dict[str, Any]:
    """Return what a document says of a record.

    Parameters
    ----------
    record : CoefficientSeries
        A reduced record.
    """
    return {
        "source": record.source,
        "rows": record.n_samples,
        "segments": record.n_segments,
        "sample_rate_hz": record.sample_rate_hz,
        "from_s": float(record.time_s[0]),
        "to_s": float(record.time_s[-1]),
    }


def _body(comparison: Comparison) -> dict[str, Any]:
    return {
        "records": [
            {
                **record_document(record),
                "history": [asdict(entry) for entry in record.history],
            }
            for record in comparison.records
        ],
        "target": comparison.rows.target,
        "rows_fitted": int(comparison.rows.phi.size),
        "segments_fitted": comparison.rows.n_segments,
        "recommended": comparison.recommended,
        "estimators": {result.name: _estimator(result) for result in comparison.results},
        "comparison": [asdict(row) for row in comparison.table],
        "cautions": [caution.text for caution in comparison.cautions],
    }


def _estimator(result: EstimatorResult) -> dict[str, Any]:
    model = result.model
    phi, psi_p, stderr = np.asarray(model.table).T
    known = 1.0 if result.states_curve else np.nan
    fit_state = {"code": result.state, "advice": result.advice}
    return {
        "label": result.label,
        "time_constant_s": {
            "value": model.time_constant_s,
            "stderr": model.time_constant_stderr_s,
            "ci95": list(model.ci95_s),
        }
        if result.has_tau
        else None,
        **_second_reading(result),
        "time_constant_held": model.time_constant_stderr_s == 0.0,
        "terms": terms_json(model.terms, known * np.array(model.coefficients), model.stderr),
        "characteristic": {
            "phi": phi.tolist(),
            model.target: (known * psi_p).tolist(),
            "stderr": stderr.tolist(),
        }
        if result.has_curve
        else None,
        "valid_phi": list(model.valid_phi),
        "hold": model.hold,
        "equation": result.equation,
        "fit_state": fit_state,
        # The key of files written before `fit_state`.
        "state": fit_state,
        "rows": result.rows.kind,
        "fit": {
            "free_run": result.free_run.to_json(),
            "held_out": result.held_out.to_json() if result.held_out else None,
            "one_step": result.one_step.to_json(),
        },
        "checks": [asdict(check) for check in result.checks],
        "seconds": result.seconds,
        "dead_time_s": model.dead_time_s,
        **_effects(result),
    }


def _effects(result: EstimatorResult) -> dict[str, Any]:
    held = {} if result.extended is None else result.extended.to_json()
    return {"effects": held["effects"]} if "effects" in held else {}


def _second_reading(result: EstimatorResult) -> dict[str, Any]:
    other = result.second_reading
    if other is None:
        return {}
    return {"second_reading": {"value": other.value_s, "ci95": list(other.ci95_s)}}
