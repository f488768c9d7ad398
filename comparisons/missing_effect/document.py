"""A diagnosis as JSON, in the schema that other programs rely on."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.missing_effect.lag_curves import contributions, steady_curves
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.quantities import model_equation
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.telling import wheres_of
from comparisons.missing_effect.where_rows import PANELS
from comparisons.missing_effect.words import verdict_words

if TYPE_CHECKING:
    from comparisons.missing_effect.fit import Fit
    from comparisons.missing_effect.results import CandidateRow, Diagnosis, MissingEffect
    from comparisons.missing_effect.runs import CheckRun

DIAGNOSE_SCHEMA = "sindy-surge/diagnose/1"
# Below this an error is given in thousandths of a unit that carries no prefix and no power itself.
LEAST_PLAIN = 0.1
PLAIN_UNIT = re.compile(r"(V|m|A|N|Pa|K|rad|s|W|J|T|C|F|H)([/· ].*)?")
GAP = ("before_rms", "after_rms", "floor_rms", "shrink")
NOISE = ("sigma", "innovation", "ar", "heavy_share", "coloured", "heavy_tailed")
LEFTOVER = ("gain", "degrees", "p_value", "structured")

Errors = dict[str, dict[str, Any]]


def diagnosis_document(
    d: Diagnosis,
    *,
    limits: Any = None,
    separation: Any = None,
    base: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Return all that is known as plain JSON types.

    Parameters
    ----------
    d : Diagnosis
        Of a lag or of a user's model.
    limits, separation : object, optional
        With ``to_json()``: what would have been named, and what would tell an alias set apart.
    base : dict, optional
        Where the base terms of a lag come from.

    Returns
    -------
    dict
        Numbers that are not finite are NaN here; `to_strict_json` writes them as null.
    """
    wheres = wheres_of(d)
    common: dict[str, Any] = {
        "schema": DIAGNOSE_SCHEMA,
        "verdict": d.verdict,
        "words": verdict_words(d, limited=limits is not None, separated=separation is not None),
        "missing": [_missing(item, d.doubts_of(item)) for item in d.missing],
        "gap": {name: getattr(d.gap, name) for name in GAP},
        "where": wheres[0].to_json() if wheres else {name: [] for name in PANELS},
        "candidates": [_candidate(row) for row in d.candidates],
        "parameters": [asdict(row) for row in d.parameters],
        "test_rmse": rmse_of([run for run in d.runs if run.held_out]),
        "training_rmse": rmse_of([run for run in d.runs if not run.held_out]),
        "unavailable": dict(d.unavailable),
        "cannot_be_told": [asdict(row) for row in d.untold],
        "not_there": [asdict(row) for row in d.absent],
        "remarks": list(d.remarks),
    }
    if isinstance(d, LagDiagnosis):
        own = {
            "limits": None if limits is None else limits.to_json(),
            "separation": None if separation is None else separation.to_json(),
            "base": {"terms": list(d.before.structure.terms), **(base or {})},
        }
        of_kind = {**_of_lag(d, common["missing"]), **own}
    else:
        assert isinstance(d, SystemDiagnosis)
        of_kind = _of_system(d, common["missing"], common["gap"])
    return {key: _plain(value) for key, value in {**common, **of_kind}.items()}


def rmse_of(runs: Sequence[CheckRun]) -> Errors:
    """Return the rms errors of runs, before and after.

    Parameters
    ----------
    runs : sequence of CheckRun
        The runs.

    Returns
    -------
    dict of dict
        ``{split: {"before", "after", "unit"}}``; a split is a record's name, with
        ``"{output}_"`` before it where the model has several outputs. In the output's unit, or in
        thousandths of it where that reads better.
    """
    out: Errors = {}
    for run in runs:
        for j, (name, unit) in enumerate(run.outputs.items()):
            split = run.name if len(run.outputs) == 1 else f"{name}_{run.name}"
            before, after = float(run.before_rms[j]), float(run.after_rms[j])
            small = max(before, after) < LEAST_PLAIN and PLAIN_UNIT.fullmatch(unit)
            factor, shown = (1e3, f"m{unit}") if small else (1.0, unit)
            out[_free_name(split, out)] = {
                "before": factor * before,
                "after": factor * after,
                "unit": shown,
            }
    return out


def merged_test_rmse(diagnoses: Mapping[str, Diagnosis]) -> Errors:
    """Return the errors of several diagnoses; a split that two of them have is separated.

    Parameters
    ----------
    diagnoses : mapping of str to Diagnosis
        By name.
    """
    merged: Errors = {}
    for name, d in diagnoses.items():
        for split, errors in rmse_of([run for run in d.runs if run.held_out]).items():
            merged[_free_name(f"{name}_{split}" if split in merged else split, merged)] = errors
    return merged


def _free_name(name: str, taken: Mapping[str, Any]) -> str:
    """Return a name, numbered where it is taken."""
    count, free = 1, name
    while free in taken:
        count += 1
        free = f"{name} ({count})"
    return free


def _missing(item: MissingEffect, doubts: tuple[str, ...]) -> dict[str, Any]:
    return {**asdict(item), "doubts": list(doubts)}


def _candidate(row: CandidateRow) -> dict[str, Any]:
    return {
        **asdict(row),
        "effect": row.name,
        "chosen": row.chosen,
        "fitted": row.fitted,
        "unnamed": row.kind == "unnamed_term",
        "train": row.train_gain,
        "held_out": row.later_gain,
        "z": row.held_out_z,
    }


def _of_lag(d: LagDiagnosis, missing: list[dict[str, Any]]) -> dict[str, Any]:
    adds = contributions(d)
    tau = d.parameters[0]
    return {
        "missing": [
            {**item, "port": item["place"]["port"], "contribution_rms": adds.get(item["effect"])}
            for item in missing
        ],
        "time_constant_s": {
            "before": tau.before,
            "after": tau.after,
            "by_alias": dict(d.tau_by_alias_s),
            "before_stderr": tau.before_stderr,
            "after_stderr": tau.after_stderr,
        },
        "whole_runs": d.whole_runs,
        "noise": {name: getattr(d.noise, name) for name in NOISE},
        "leftover": {name: getattr(d.leftover, name) for name in LEFTOVER},
        "rounds": [
            {
                "model": list(step.bench.fit.structure.names),
                "added": None if step.winner is None else [e.name for e in step.winner.added],
                "leftover": {name: getattr(step.leftover, name) for name in LEFTOVER},
            }
            for step in d.rounds
        ],
        "records": _records(d),
        "model": {"before": _model(d, d.before), "after": _model(d, d.after)},
    }


def _records(d: LagDiagnosis) -> list[dict[str, Any]]:
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
                "from_s": time_s[rows].min(),
                "to_s": time_s[rows].max(),
                "sample_rate_hz": 1.0 / data.sample_period_s,
                "rows": parts,
            }
        )
    return out


def _model(d: LagDiagnosis, fit: Fit) -> dict[str, Any]:
    terms = fit.structure.terms
    return {
        "equation": model_equation(fit),
        "time_constant_s": fit.tau_s,
        "terms": [
            {"name": name, "coefficient": value}
            for name, value in zip(terms, fit.coefficients, strict=False)
        ],
        "effects": list(fit.structure.names),
        "characteristic": [
            {"label": curve.label, "phi": curve.phi.tolist(), "psi_p": curve.value.tolist()}
            for curve in steady_curves(fit, d.data)
        ],
    }


def _of_system(
    d: SystemDiagnosis, missing: list[dict[str, Any]], gap: dict[str, Any]
) -> dict[str, Any]:
    return {
        # Of one name; those of the others stand in the report.
        "missing": [{**item, "confirm": item["confirm"].get(item["label"])} for item in missing],
        "gap": {**gap, "unit": d.gap.unit},
        "time_constant_s": {"before": math.nan, "after": math.nan, "by_alias": {}},
        "timing_offsets": [asdict(offset) for offset in d.offsets],
        "input_between_samples": d.after.structure.between if d.model.inputs else None,
        "model": {
            "name": d.model.name,
            "states": d.model.states,
            "inputs": d.model.inputs,
            "outputs": d.model.outputs,
        },
    }


def _plain(value: Any) -> Any:
    """Return mappings, sequences and numpy's numbers as JSON has them."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
