"""Results as JSON, in the schemas that other programs rely on; steps of `run` under their own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from classic_ml.work.coefficient import WorkCharacteristic
from comparisons.analysis import Analysis
from comparisons.harness.structure_fit import SETTINGS, FoundStructure
from comparisons.harness.work_fit import why_withheld
from comparisons.missing_effect.document import diagnosis_document
from comparisons.results import Comparison, EstimatorResult
from comparisons.show.inspection import inspect_document
from sindy_surge.text import interval95
from surge_core.terms import terms_json
from surge_core.types import FloatArray

COMPARE_SCHEMA = "sindy-surge/compare/1"
RUN_SCHEMA = "sindy-surge/run/1"
WORK_SCHEMA = "sindy-surge/work/1"
STRUCTURE_SCHEMA = "sindy-surge/structure/1"
OF_ROW = "held_out_stderr", "difference", "paired_error", "p_value", "trust"
OF_PATH = "size", "score", "chi2", "time_constant_s", "held_out_rms", "consistent", "chosen"


def comparison_document(comparison: Comparison, work: Comparison | None = None) -> dict[str, Any]:
    """Return the document of ``compare --json``, of ψ' and, where it was fitted, of ψ."""
    document = {"schema": COMPARE_SCHEMA, **_comparison(comparison)}
    if work is not None:
        document["work_coefficient"] = _comparison(work)
    return document


def record_document(record: CoefficientSeries) -> dict[str, Any]:
    """Return what a document says of a record."""
    return {
        "source": record.source,
        "rows": record.n_samples,
        "segments": record.n_segments,
        "sample_rate_hz": record.sample_rate_hz,
        "from_s": float(record.time_s[0]),
        "to_s": float(record.time_s[-1]),
    }


def tau_json(value: float, stderr: float, ci95: Sequence[float] | None = None) -> dict[str, Any]:
    """Return a time constant with its standard error, and its interval where one is stated."""
    tau: dict[str, Any] = {"value": value, "stderr": stderr}
    return tau if ci95 is None else {**tau, "ci95": list(ci95)}


def curve_json(target: str, *columns: Iterable[float]) -> dict[str, list[float]]:
    """Return φ, the coefficient and its standard error."""
    names = "phi", target, "stderr"
    return {name: list(map(float, each)) for name, each in zip(names, columns, strict=True)}


def state_json(code: str, advice: str) -> dict[str, dict[str, str]]:
    """Return how a fit ended, also under the key of files written before `fit_state`."""
    state = {"code": code, "advice": advice}
    return {"fit_state": state, "state": state}


def run_document(found: Analysis) -> dict[str, Any]:
    """Return an analysis as plain JSON types.

    A step that refused has ``{"refused": sentence}`` for its document.
    """
    series, record = found.reduction.series, found.reduction.record
    made = {
        "inspect": inspect_document(found.inspection),
        "reduce": {**record_document(series), "history": [asdict(e) for e in record.history]},
        "compare": comparison_document(found.comparison),
        "structure": found.structure and structure_document(found.structure),
        "diagnose": found.diagnosis and diagnosis_document(found.diagnosis),
        "work": found.work and work_document(found.work, record.source),
    }
    steps = {
        name: {"refused": found.refusals[name]} if document is None else document
        for name, document in made.items()
    }
    return {"schema": RUN_SCHEMA, "answer": found.answer.to_json(), **steps}


def work_document(fit: WorkCharacteristic, source: str) -> dict[str, Any]:
    """Return the fit as plain JSON types."""
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    return {
        "schema": WORK_SCHEMA,
        "record": source,
        "time_constant_s": tau_json(fit.time_constant_s, fit.time_constant_stderr_s),
        "breakpoints": list(fit.breakpoints),
        "terms": terms_json(fit.terms, fit.coef, errors),
        "characteristic": curve_json("psi", *work_curve(fit)),
        "valid_phi": list(fit.valid_phi),
        "rows_scored": fit.n_scored,
        "cycles": fit.n_cycles,
        **state_json(fit.fit_state.code, why_withheld(fit) or fit.fit_state.advice),
        "history": [asdict(fit.entry)],
    }


def work_curve(fit: WorkCharacteristic) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ψ_QS over forward flow as it is written: φ, value and standard error."""
    last = fit.valid_phi[1] if math.isfinite(fit.valid_phi[1]) else 0.0
    phi = np.round(np.arange(0.0, max(last, 0.01) + 0.005, 0.01), 3)
    return (phi, *fit.characteristic(phi))


def structure_document(found: FoundStructure) -> dict[str, Any]:
    """Return the document of ``structure --json``."""
    fit, known, summary = found.fit, found.inclusion, found.summary
    parts = summary.parts
    noise = getattr(fit, "noise_", None)
    tau, error = parts.time_constant_s, parts.time_constant_stderr_s
    return {
        "schema": STRUCTURE_SCHEMA,
        "records": [record_document(record) for record in found.records],
        "target": "psi_p",
        "fitted_to": found.fitted_to,
        "rows_fitted": int(found.phi.size),
        "segments_fitted": found.n_segments,
        "settings": dict(SETTINGS),
        "equation": None if found.refused else found.equation(),
        "time_constant_s": tau_json(tau, error, interval95(tau, error)),
        # Null where none was looked for.
        "dead_time_s": {
            "value": getattr(fit, "dead_time_s_", None),
            "stderr": getattr(fit, "dead_time_stderr_s_", None),
        },
        "terms": [
            {**term, "inclusion_probability": known.get(term["name"])}
            for term in terms_json(parts.terms, parts.coef, parts.stderr)
        ],
        "candidates": list(fit.candidate_terms_),
        "inclusion_probability": known,
        "rivals": [list(terms) for terms in getattr(fit, "rivals_", ())],
        "path": [
            {"terms": list(row.terms), **{key: getattr(row, key) for key in OF_PATH}}
            for row in fit.path_
        ],
        "noise": None
        if noise is None
        else {"psi_p": float(noise[0]), "phi": float(np.ravel(noise[1])[0])},
        "phi_range": [float(found.phi.min()), float(found.phi.max())] if found.phi.size else None,
        **state_json(*found.state),
        "cautions": list(summary.cautions),
    }


def _comparison(comparison: Comparison) -> dict[str, Any]:
    return {
        "records": [
            {**record_document(record), "history": [asdict(entry) for entry in record.history]}
            for record in comparison.records
        ],
        "target": comparison.rows.target,
        "rows_fitted": int(comparison.rows.phi.size),
        "segments_fitted": comparison.rows.n_segments,
        "recommended": comparison.recommended,
        "estimators": {result.name: _estimator(result) for result in comparison.results},
        "comparison": [
            {
                "estimator": result.name,
                "label": result.label,
                "rank": rank,
                "held_out_rms": result.held_out.rms if result.held_out else math.nan,
                "time_constant_s": result.model.time_constant_s,
                "time_constant_stderr_s": result.model.time_constant_stderr_s,
                "rows": result.rows.kind,
                **{name: getattr(result, name) for name in OF_ROW},
            }
            for rank, result in enumerate(comparison.results, start=1)
        ],
        "cautions": [caution.text for caution in comparison.cautions],
    }


def _estimator(result: EstimatorResult) -> dict[str, Any]:
    model, other = result.model, result.second_reading
    phi, value, stderr = np.asarray(model.table).T
    known = 1.0 if result.states_curve else np.nan
    tau = tau_json(model.time_constant_s, model.time_constant_stderr_s, model.ci95_s)
    second = other and {"value": other.value_s, "ci95": list(other.ci95_s)}
    extended = {} if result.extended is None else result.extended.to_json()
    return {
        "label": result.label,
        "time_constant_s": tau if result.has_tau else None,
        **({"second_reading": second} if second else {}),
        "time_constant_held": model.time_constant_stderr_s == 0.0,
        "terms": terms_json(model.terms, known * np.array(model.coefficients), model.stderr),
        "characteristic": curve_json(model.target, phi, known * value, stderr)
        if result.has_curve
        else None,
        "valid_phi": list(model.valid_phi),
        "hold": model.hold,
        "equation": result.equation,
        **state_json(result.state, result.advice),
        "rows": result.rows.kind,
        "fit": {
            "free_run": result.free_run.to_json(),
            "held_out": result.held_out.to_json() if result.held_out else None,
            "one_step": result.one_step.to_json(),
        },
        "checks": [asdict(check) for check in result.checks],
        "seconds": result.seconds,
        "dead_time_s": model.dead_time_s,
        **{key: extended[key] for key in ("effects",) if key in extended},
    }
