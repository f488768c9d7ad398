"""A comparison as JSON, in the schema that other programs rely on (DESIGN section 5)."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any

from comparisons.results import Comparison, EstimatorResult

__all__ = ["COMPARE_SCHEMA", "comparison_document", "to_strict_json"]

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


def to_strict_json(document: dict[str, Any]) -> str:
    """Return JSON in which a number that is not finite is null: JSON has no NaN."""
    return json.dumps(_finite(document), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _body(comparison: Comparison) -> dict[str, Any]:
    return {
        "records": [
            {
                "source": record.source,
                "rows": record.n_samples,
                "segments": record.n_segments,
                "sample_rate_hz": record.sample_rate_hz,
                "from_s": float(record.time_s[0]),
                "to_s": float(record.time_s[-1]),
                "history": [asdict(entry) for entry in record.history],
            }
            for record in comparison.records
        ],
        "target": comparison.rows.target,
        "rows_fitted": int(comparison.rows.phi.size),
        "segments_fitted": comparison.rows.n_segments,
        "estimators": {result.name: _estimator(result) for result in comparison.results},
        "recommended": comparison.recommended,
        "comparison": [asdict(row) for row in comparison.table],
        "cautions": [caution.text for caution in comparison.cautions],
    }


def _estimator(result: EstimatorResult) -> dict[str, Any]:
    model = result.model
    table = list(zip(*model.table, strict=True))
    return {
        "label": result.label,
        "time_constant_s": {
            "value": model.time_constant_s,
            "stderr": model.time_constant_stderr_s,
            "ci95": list(model.ci95_s),
        },
        "time_constant_held": model.time_constant_stderr_s == 0.0,
        "terms": [
            {"name": name, "coefficient": coefficient, "stderr": stderr}
            for name, coefficient, stderr in zip(
                model.terms, model.coefficients, model.stderr, strict=True
            )
        ],
        "characteristic": {
            "phi": list(table[0]),
            "psi_p" if model.target == "psi_p" else "psi": list(table[1]),
            "stderr": list(table[2]),
        },
        "valid_phi": list(model.valid_phi),
        "hold": model.hold,
        "equation": result.equation,
        "fit_state": {"code": result.state, "advice": result.advice},
        "fit": {
            "free_run": result.free_run.to_json(),
            "held_out": result.held_out.to_json() if result.held_out else None,
            "one_step": result.one_step.to_json(),
        },
        "checks": [asdict(check) for check in result.checks],
        "seconds": result.seconds,
        "dead_time_s": model.dead_time_s,
        **({"structure": result.structure.to_json()} if result.structure else {}),
        **({"effects": result.extended.to_json()["effects"]} if result.extended else {}),
    }


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
