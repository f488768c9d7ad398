"""A diagnosis as JSON, in the schema that other programs rely on."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.missing_effect.where_rows import PANELS
from comparisons.missing_effect.words import verdict_words

if TYPE_CHECKING:
    from comparisons.missing_effect.results import CandidateRow, Diagnosis
    from comparisons.missing_effect.runs import CheckRun

DIAGNOSE_SCHEMA = "sindy-surge/diagnose/1"
# Below this an error is given in thousandths of a unit that carries no prefix and no power itself.
LEAST_PLAIN = 0.1
PLAIN_UNIT = re.compile(r"(V|m|A|N|Pa|K|rad|s|W|J|T|C|F|H)([/· ].*)?")
GAP = ("before_rms", "after_rms", "floor_rms", "shrink")

Errors = dict[str, dict[str, Any]]


def diagnosis_document(
    d: Diagnosis, *, limits: Any = None, separation: Any = None, base: dict[str, Any] | None = None
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
    wheres, own = d.wheres, d.own_document()
    document: dict[str, Any] = {
        "schema": DIAGNOSE_SCHEMA,
        "verdict": d.verdict,
        "words": verdict_words(d),
        "candidates": [_candidate(row) for row in d.candidates],
        "parameters": [asdict(row) for row in d.parameters],
        "test_rmse": rmse_of([run for run in d.runs if run.held_out]),
        "training_rmse": rmse_of([run for run in d.runs if not run.held_out]),
        "unavailable": dict(d.unavailable),
        "cannot_be_told": [asdict(row) for row in d.untold],
        "not_there": [asdict(row) for row in d.absent],
        "remarks": list(d.remarks),
        **own,
        "missing": [
            {**asdict(item), **more} for item, more in zip(d.missing, own["missing"], strict=True)
        ],
        "gap": {**{name: getattr(d.gap, name) for name in GAP}, **own.get("gap", {})},
        "where": wheres[0].to_json() if wheres else {name: [] for name in PANELS},
    }
    if d.of_series:
        document["limits"] = None if limits is None else limits.to_json()
        document["separation"] = None if separation is None else separation.to_json()
        document["base"] = {**own["base"], **(base or {})}
    return {key: _plain(value) for key, value in document.items()}


def rmse_of(runs: Sequence[CheckRun]) -> Errors:
    """Return the rms errors of runs before and after: ``{split: {"before", "after", "unit"}}``.

    A split is a record's name, with ``"{output}_"`` before it where the model has several outputs.
    Errors are in the output's unit, or in thousandths of it where that reads better.
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
    """Return the errors of several diagnoses; a split that two of them have is separated."""
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


def _plain(value: Any) -> Any:
    """Return mappings, sequences and numpy's numbers as JSON has them."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
