"""A diagnosis as JSON, in the schema that other programs rely on."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN
from comparisons.missing_effect.quantities import model_equation
from comparisons.missing_effect.ranked import candidate_rows, effect_of, not_fitted
from comparisons.missing_effect.shown import (
    contributions,
    steady_curves,
    tau_before_stderr_s,
)
from comparisons.missing_effect.where_rows import PANELS
from comparisons.missing_effect.words import doubts_of, label_of, verdict_words

if TYPE_CHECKING:
    from comparisons.missing_effect.diagnosis import Diagnosis, MissingEffect
    from comparisons.missing_effect.fit import Fit
    from comparisons.missing_effect.search import Leftover, Round
    from comparisons.missing_effect.where import Where

__all__ = ["DIAGNOSE_SCHEMA", "diagnosis_document"]

DIAGNOSE_SCHEMA = "sindy-surge/diagnose/1"


def diagnosis_document(
    d: Diagnosis,
    where: Where | None,
    limits: Any = None,
    separation: Any = None,
    *,
    base: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Return all that is known as plain JSON types.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    where : Where or None
        Of the models before and after; None where the records are too short to tell.
    limits, separation : object, optional
        With ``to_json()``: what would have been named, and what would tell an alias set apart.
    base : dict, optional
        Where the base terms come from.

    Returns
    -------
    dict
        Numbers that are not finite are NaN here; `to_strict_json` writes
        them as null.
    """
    where_rows = {name: [] for name in PANELS} if where is None else where.to_json()
    return {
        "schema": DIAGNOSE_SCHEMA,
        "verdict": d.verdict,
        "words": verdict_words(d, limited=limits is not None, separated=separation is not None),
        "missing": [_missing(d, item) for item in d.missing],
        "gap": {
            "before_rms": float(d.gap.before_rms),
            "after_rms": float(d.gap.after_rms),
            "floor_rms": float(d.gap.floor_rms),
            "shrink": float(d.gap.shrink),
        },
        "time_constant_s": {
            "before": float(d.tau_before_s),
            "after": float(d.tau_after_s),
            "by_alias": {name: float(tau_s) for name, tau_s in d.tau_by_alias_s.items()},
            "before_stderr": float(tau_before_stderr_s(d)),
            "after_stderr": float(d.tau_stderr_s),
        },
        "where": where_rows,
        "candidates": _candidates(d),
        "unavailable": dict(d.unavailable),
        "cannot_be_told": [asdict(row) for row in d.untold],
        "not_there": [asdict(row) for row in d.absent],
        "remarks": list(d.remarks),
        "whole_runs": bool(d.whole_runs),
        "noise": {
            "sigma": float(d.noise.sigma),
            "innovation": float(d.noise.innovation),
            "ar": [float(a) for a in d.noise.ar],
            "heavy_share": float(d.noise.heavy_share),
            "coloured": bool(d.noise.coloured),
            "heavy_tailed": bool(d.noise.heavy_tailed),
        },
        "leftover": _leftover(d.leftover),
        "rounds": [_round(step) for step in d.rounds],
        "records": _records(d),
        "base": {"terms": list(d.before.structure.terms), **(base or {})},
        "model": {"before": _model(d, d.before), "after": _model(d, d.after)},
        "limits": None if limits is None else limits.to_json(),
        "separation": None if separation is None else separation.to_json(),
    }


def _missing(d: Diagnosis, item: MissingEffect) -> dict[str, Any]:
    effect = effect_of(d, item.effect)
    contribution = {part.effect: part.rms for part in contributions(d)}
    return {
        "effect": item.effect,
        "label": label_of(effect),
        "place": {"port": effect.port},
        "alias_set": list(item.alias_set),
        "alias_labels": [label_of(effect_of(d, name)) for name in item.alias_set],
        "provisional": bool(item.provisional),
        "doubts": list(doubts_of(d, item)),
        "parameters": [asdict(parameter) for parameter in item.parameters],
        "evidence": {name: float(value) for name, value in item.evidence.items()},
        "port": effect.port,
        "equation": effect.equation,
        "says": effect.says,
        "on_tau": effect.on_tau,
        "confirm": {name: effect_of(d, name).confirm for name in item.alias_set},
        "unnamed": bool(effect.unnamed),
        "contribution_rms": contribution.get(item.effect),
    }


def _candidates(d: Diagnosis) -> list[dict[str, Any]]:
    rows = []
    for row in candidate_rows(d):
        values = asdict(row)
        values["refused_on"] = list(row.refused_on)
        rows.append({**values, "fitted": True})
    # An effect whose score test promised too little stands at the end, without numbers.
    rows += [
        {
            "round": 1,
            "name": name,
            "kind": "name",
            "accepted": False,
            "chosen": False,
            "alias": False,
            "refused_on": ["score test"],
            "fitted": False,
        }
        for name in not_fitted(d)
    ]
    return rows


def _leftover(left: Leftover) -> dict[str, Any]:
    return {
        "gain": float(left.gain),
        "degrees": int(left.degrees),
        "p_value": float(left.p_value),
        "structured": bool(left.structured),
    }


def _round(step: Round) -> dict[str, Any]:
    return {
        "model": list(step.bench.fit.structure.names),
        "added": None if step.winner is None else [effect.name for effect in step.winner.added],
        "leftover": _leftover(step.leftover),
    }


def _records(d: Diagnosis) -> list[dict[str, Any]]:
    data = d.data
    time_s = data.sampled(data["time_s"])
    out = []
    for number, source in enumerate(data.sources):
        rows = data.record == number
        parts = {
            name: int(np.count_nonzero(rows & data.scored(part)))
            for name, part in (("fitted", TRAIN), ("later_time", LATER), ("other_record", OTHER))
        }
        out.append(
            {
                "source": source,
                "from_s": float(time_s[rows].min()),
                "to_s": float(time_s[rows].max()),
                "sample_rate_hz": 1.0 / data.sample_period_s,
                "rows": parts,
            }
        )
    return out


def _model(d: Diagnosis, fit: Fit) -> dict[str, Any]:
    terms = fit.structure.terms
    return {
        "equation": model_equation(fit),
        "time_constant_s": float(fit.tau_s),
        "terms": [
            {"name": name, "coefficient": float(value)}
            for name, value in zip(terms, fit.coefficients, strict=False)
        ],
        "effects": list(fit.structure.names),
        "characteristic": [
            {"label": curve.label, "phi": curve.phi.tolist(), "psi_p": curve.value.tolist()}
            for curve in steady_curves(fit, d.data)
        ],
    }
