"""From a raw record to the answer: every step of the way, and what they say together."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from classic_ml.inspect import Inspection, inspect_file
from classic_ml.io import read_raw, read_test_description
from classic_ml.records import counted
from classic_ml.reduction import Reduction, reduce_record
from classic_ml.whole_record_fit import N_TWINS
from classic_ml.work.coefficient import WorkCharacteristic
from comparisons.harness.answer import APART, TauReading, answer_of
from comparisons.harness.cautions import unknown_work
from comparisons.harness.compare import compare_records
from comparisons.harness.estimators import default_estimators
from comparisons.harness.structure_fit import FoundStructure, find_structure
from comparisons.harness.work_fit import fit_work, why_withheld, withheld_if_vague
from comparisons.missing_effect import Diagnosis, diagnose
from comparisons.missing_effect.quantities import plain_name
from comparisons.missing_effect.whole_runs import N_TWINS as DIAGNOSIS_TWINS
from comparisons.missing_effect.words import beside_words, verdict_sentence
from comparisons.results import Answer, Comparison
from surge_core.display import Displayed, Sheet
from surge_core.errors import InputError
from surge_core.rounding import round_to_error
from surge_core.threads import one_thread

# Each with the seconds that it lasts on a record of 4000 rows; only their ratios matter.
STEPS = {
    "looking through the file": 0.3,
    "reducing the counts": 1.5,
    "comparing the estimators of ψ'": 5.0,
    "choosing the terms of ψ'_QS": 1.5,
    "looking for what is missing": 10.0,
    "fitting ψ_QS to the power": 3.0,
}
# Effects that the answer names; the evidence lists all.
FEW = 2
Progress = Callable[[Iterable[Any]], Iterable[Any]]


@dataclass(frozen=True)
class Analysis(Displayed):
    """What each step made of a raw record; None for a step that refused.

    Parameters
    ----------
    answer : Answer
        τ, the characteristic, whom to believe, what is missing and what was refused.
    inspection : Inspection
        What is in the file.
    reduction : Reduction
        φ, ψ' and ψ with their ledger.
    comparison : Comparison
        Estimators of ψ' side by side.
    structure : FoundStructure or None
        Terms of ψ'_QS.
    diagnosis : Diagnosis or None
        What the lag model lacks.
    work : WorkCharacteristic or None
        ψ_QS from the power that the blading delivers.
    refusals : dict of str to str
        By step, the sentence with which it refused.
    """

    answer: Answer
    inspection: Inspection
    reduction: Reduction
    comparison: Comparison
    structure: FoundStructure | None
    diagnosis: Diagnosis | None
    work: WorkCharacteristic | None
    refusals: dict[str, str]

    def _sheet(self) -> Sheet:
        return self.answer._sheet()


@one_thread()
def analyse(
    raw: str | os.PathLike[str],
    test: str | os.PathLike[str],
    *,
    twins: bool = True,
    begin: Callable[[str], object] = str,
    progress: Progress = iter,
) -> Analysis:
    """Inspect, reduce, compare, choose terms, diagnose and fit the work of one raw record.

    Each step is that of the command of its name with its defaults.

    Parameters
    ----------
    raw : str or path
        Raw record (CSV, MAT, netCDF, HDF5, TDMS, Parquet).
    test : str or path
        Description of its test (test.toml).
    twins : bool
        Measure twins of the record; without them it is quicker, the interval of τ lacks the
        errors of calibration, and names of missing effects are provisional.
    begin : callable
        Called with the name of each of the ``STEPS`` as it begins.
    progress : callable
        Wraps the iterations inside the steps, to show how far they are.

    Raises
    ------
    InputError
        When the record cannot be reduced or compared. A later step that refuses is listed in the
        answer instead.
    """
    names = iter(STEPS)
    begin(next(names))
    inspection = inspect_file(raw, read_test_description(test).file)
    begin(next(names))
    record, described = read_raw(raw, test)
    reduction = reduce_record(record, described)
    series = [reduction.series]
    begin(next(names))
    estimators = default_estimators(n_twins=N_TWINS if twins else 0, measuring=progress)
    comparison = compare_records(series, estimators=estimators, progress=progress)
    refusals: dict[str, str] = {}

    def tried(step: str, work: Callable[[], Any]) -> Any:
        begin(next(names))
        try:
            return work()
        except InputError as error:
            refusals[step] = str(error)
            return None

    structure = tried("structure", lambda: find_structure(series))
    diagnosis = tried(
        "diagnose",
        lambda: diagnose(series, n_twins=DIAGNOSIS_TWINS if twins else 0, progress=progress),
    )
    work = tried("work", lambda: withheld_if_vague(fit_work(record, described, progress=progress)))
    readings = []
    # On whole runs the structure is the fit of sindy once more.
    again = structure and structure.fitted_to == "whole runs" and comparison.recommended == "sindy"
    if structure and not structure.refused and not again:
        fit = structure.fit
        shared = getattr(fit, "measurement_share_", 0.0)
        tau = fit.time_constant_s_, fit.time_constant_stderr_s_
        readings.append(TauReading("structure", *tau, shared))
    if diagnosis is not None:
        readings.append(TauReading("diagnose", diagnosis.tau_after_s, diagnosis.tau_stderr_s))
    if work is not None:
        readings.append(TauReading("work", work.time_constant_s, work.time_constant_stderr_s))
        if why := why_withheld(work):
            refusals["work"] = f"ψ_QS and its τ are not stated: {why}"
        elif _contradicts(comparison, work):
            # Both have one lag (Eq 6 and 14): with another, what was fitted is no curve.
            refusals["work"] = "ψ_QS is not stated: its τ is not that of ψ'"
    missing = missing_words(diagnosis) if diagnosis else f"not known: {refusals['diagnose']}"
    chosen = comparison.recommended and comparison.first.model.ci95_s
    named = diagnosis is not None and diagnosis.tau_said[1] in missing
    if chosen and diagnosis and named and not chosen[0] <= diagnosis.tau_after_s <= chosen[1]:
        missing += " The τ named here is that of the diagnosis's own fit, not the one to quote."
    answer = answer_of(
        comparison,
        test=described.name,
        readings=readings,
        verdict=diagnosis.verdict if diagnosis else "",
        missing=missing,
        work="" if "work" in refusals else _work_words(work),
        # Why ψ is not known the comparison says, from the ledger.
        refused=[
            f"{step}: {why}"
            for step, why in refusals.items()
            if step != "work" or unknown_work(reduction.record.history) is None
        ],
    )
    return Analysis(answer, inspection, reduction, comparison, structure, diagnosis, work, refusals)


def _contradicts(comparison: Comparison, work: WorkCharacteristic) -> bool:
    """Tell whether the τ of ψ is not the one to quote."""
    model = comparison.first.model
    apart_s = abs(work.time_constant_s - model.time_constant_s)
    error_s = math.hypot(work.time_constant_stderr_s, model.time_constant_stderr_s)
    return bool(comparison.recommended) and apart_s > APART * error_s


def _work_words(work: WorkCharacteristic | None) -> str:
    """Return ψ_QS at the ends of its φ; nothing where it is not stated."""
    if work is None:
        return ""
    ends = zip(work.valid_phi, *work.characteristic(np.array(work.valid_phi)), strict=True)
    at = [f"{round_to_error(value, error)} at φ = {phi:.3f}" for phi, value, error in ends]
    return f"ψ_QS from {' to '.join(at)}; in full in the report"


def missing_words(d: Diagnosis) -> str:
    """Say what is missing, or that nothing is and what would have been seen.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    few_decided = not d.missing and len(d.untold) > len(d.absent)
    words = [
        # "Nothing is missing" is not said where the record decides about few effects.
        f"The record decides about {len(d.absent)} of {len(d.absent) + len(d.untold)} effects."
        if few_decided
        else verdict_sentence(d),
        *beside_words(d),
        *(f"{text[0].upper()}{text[1:].rstrip('.')}." for text in d.remarks),
    ]
    if d.absent and not d.missing:
        seen = " or ".join(plain_name(each.effect) for each in d.absent[:FEW])
        any_of = counted(len(d.absent), "effect")
        words.append(
            f"There is no {seen}."
            if few_decided
            else f"Any of {any_of} would have been seen, such as {seen}."
        )
    # Of a provisional name the doubt is said already.
    open_ = [each for each in d.untold if each.effect not in d.names]
    if open_:
        # What any of them could do with as well stands in the evidence.
        few = ", ".join(
            f"{plain_name(each.effect)} (that needs {each.what_would_tell.partition(';')[0]})"
            for each in open_[:FEW]
        )
        more = len(open_) - FEW
        rest = f" and {counted(more, 'other')}, listed in the evidence" if more > 0 else ""
        words.append(f"This record does not decide on {few}{rest}.")
    return " ".join(words)
