"""A diagnosis of a user's model as JSON, in the schema that other programs rely on."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.missing_effect.document import DIAGNOSE_SCHEMA
from comparisons.missing_effect.systems.shown import fate_of
from comparisons.missing_effect.systems.words import system_words

if TYPE_CHECKING:
    from comparisons.missing_effect.systems.results import (
        CheckRun,
        FittedNumber,
        FoundEffect,
        SystemDiagnosis,
    )
    from comparisons.missing_effect.systems.search import Candidate, Round

__all__ = ["merged_test_rmse", "system_document", "test_rmse"]

# Below this an error is given in thousandths of a unit that carries no prefix and no power itself.
LEAST_PLAIN = 0.1
PLAIN_UNIT = re.compile(r"(V|m|A|N|Pa|K|rad|s|W|J|T|C|F|H)([/· ].*)?")
SHARE_UNIT = "1 (share of swing)"
NO_WHERE: Mapping[str, Sequence[Any]] = {"time": (), "frequency": (), "flow": ()}

Errors = dict[str, dict[str, Any]]


def system_document(d: SystemDiagnosis, where: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return all that is known as plain JSON types.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.
    where : mapping, optional
        Where the model and the measurement part: rows of ``time``, ``frequency`` and ``flow``.

    Returns
    -------
    dict
        Numbers that are not finite are NaN here; `to_strict_json` writes
        them as null.
    """
    panels = NO_WHERE if where is None else where
    return {
        "schema": DIAGNOSE_SCHEMA,
        "verdict": d.verdict,
        "words": system_words(d),
        "missing": [_missing(item) for item in d.missing],
        "gap": _gap(d),
        "time_constant_s": {"before": math.nan, "after": math.nan, "by_alias": {}},
        "where": {
            name: list(rows) if isinstance(rows, tuple) else rows for name, rows in panels.items()
        },
        "candidates": [
            _candidate(d, number, step, candidate)
            for number, step in enumerate(d.rounds, start=1)
            for candidate in step.candidates
        ],
        "parameters": [_plain(asdict(row)) for row in d.parameters],
        "timing_offsets": [_number(offset) for offset in d.offsets],
        "input_between_samples": d.after.structure.between if d.model.inputs else None,
        "test_rmse": test_rmse(d),
        "training_rmse": _errors(d, d.training),
        "unavailable": dict(d.unavailable),
        "cannot_be_told": [],
        "remarks": list(d.remarks),
        "model": {
            "name": d.model.name,
            "states": dict(d.model.states),
            "inputs": dict(d.model.inputs),
            "outputs": dict(d.model.outputs),
        },
    }


def test_rmse(d: SystemDiagnosis) -> Errors:
    """Return the rms errors on the check records, before and after.

    Parameters
    ----------
    d : SystemDiagnosis
        The diagnosis.

    Returns
    -------
    dict of dict
        ``{split: {"before", "after", "unit"}}``; a split is a record's name, with
        ``"{output}_"`` before it where the model has several outputs. In the output's unit, or in
        thousandths of it where that reads better.
    """
    return _errors(d, d.checks)


def merged_test_rmse(diagnoses: Mapping[str, SystemDiagnosis]) -> Errors:
    """Return the errors of several diagnoses; a split that two of them have is separated.

    Parameters
    ----------
    diagnoses : mapping of str to SystemDiagnosis
        By name.
    """
    merged: Errors = {}
    for name, d in diagnoses.items():
        for split, errors in test_rmse(d).items():
            merged[_free_name(f"{name}_{split}" if split in merged else split, merged)] = errors
    return merged


def _errors(d: SystemDiagnosis, runs: Sequence[CheckRun]) -> Errors:
    out: Errors = {}
    for run in runs:
        for j, name in enumerate(run.outputs):
            split = (
                run.experiment.name if len(run.outputs) == 1 else f"{name}_{run.experiment.name}"
            )
            before, after = float(run.before_rms[j]), float(run.after_rms[j])
            factor, unit = _readable(d.model.outputs[name], max(before, after))
            out[_free_name(split, out)] = {
                "before": factor * before,
                "after": factor * after,
                "unit": unit,
            }
    return out


def _free_name(name: str, taken: Mapping[str, Any]) -> str:
    """Return a name, numbered where it is taken."""
    count, free = 1, name
    while free in taken:
        count += 1
        free = f"{name} ({count})"
    return free


def _readable(unit: str, largest: float) -> tuple[float, str]:
    """Return the factor and the unit in which an error is reported: plain or thousandths."""
    if largest < LEAST_PLAIN and PLAIN_UNIT.fullmatch(unit):
        return 1e3, f"m{unit}"
    return 1.0, unit


def _gap(d: SystemDiagnosis) -> dict[str, Any]:
    """Return the errors of all outputs as one number, on check records where there are any."""
    runs = d.checks or d.training
    measured = [run.measured[run.settle :] for run in runs]
    single = len(d.model.outputs) == 1
    swing = np.ones(1) if single else np.nanstd(np.concatenate(measured), axis=0)
    before, after = (
        _joined([m - s for m, s in zip(measured, simulated, strict=True)], swing)
        for simulated in (
            [run.before[run.settle :] for run in runs],
            [run.after[run.settle :] for run in runs],
        )
    )
    floor = np.asarray(d.floor, dtype=np.float64)
    floor_rms = float(np.sqrt(np.mean((floor / swing) ** 2))) if floor.size else math.nan
    unit = next(iter(d.model.outputs.values())) if single else SHARE_UNIT
    return {
        "before_rms": before,
        "after_rms": after,
        "floor_rms": floor_rms,
        "shrink": _shrink(before, after, floor_rms),
        "unit": unit,
    }


def _joined(errors: Sequence[np.ndarray], swing: np.ndarray) -> float:
    """Return the root mean square over all rows of all outputs, each over its swing."""
    shares = np.concatenate(errors) / swing
    kept = shares[np.isfinite(shares)]
    return float(np.sqrt(np.mean(kept**2))) if kept.size else math.nan


def _shrink(before: float, after: float, floor: float) -> float:
    """Return the share of the gap that is closed, (before² − after²)/(before² − floor²)."""
    if not all(map(math.isfinite, (before, after, floor))):
        return math.nan
    gap, won = before**2 - floor**2, before**2 - after**2
    if gap <= 0.0 or won <= 0.0:
        return 0.0
    # The floor comes from the fitted records: the check records may be quieter, and no more than
    # the whole gap can be closed.
    return min(won / gap, 1.0)


def _missing(item: FoundEffect) -> dict[str, Any]:
    return {
        "effect": item.effect,
        "alias_set": list(item.alias_set),
        "provisional": bool(item.provisional),
        "doubts": list(item.doubts),
        "parameters": [_number(number) for number in item.numbers],
        "evidence": {name: float(value) for name, value in item.evidence.items()},
        "place": dict(item.place),
        "label": item.label,
        "alias_labels": list(item.alias_labels),
        "equation": item.equation,
        "says": item.says,
        "confirm": item.confirm,
        "unnamed": bool(item.unnamed),
    }


def _number(number: FittedNumber) -> dict[str, Any]:
    return _plain(asdict(number))


def _candidate(d: SystemDiagnosis, number: int, step: Round, c: Candidate) -> dict[str, Any]:
    e = c.evidence
    return {
        "round": number,
        "effect": c.placed.name,
        "label": c.placed.label(d.model),
        "place": c.placed.where(d.model),
        "promised": float(c.probe.gain),
        "score": math.nan if e is None else float(e.score),
        "train": math.nan if e is None else float(e.train),
        "held_out": math.nan if e is None else float(e.later),
        "z": math.nan if e is None else float(e.z),
        "accepted": bool(c.accepted),
        "unnamed": bool(c.placed.effect.unnamed),
        "fitted": c.fit is not None,
        "fate": fate_of(d, step, c),
    }


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    """Return numpy's numbers as Python's."""
    return {k: v.item() if isinstance(v, np.generic) else v for k, v in row.items()}
