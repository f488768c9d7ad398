"""The answer of a comparison: which τ and which curve to read, and why."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from classic_ml.records import counted, short_names
from classic_ml.whole_record_fit import LARGEST_SHARE
from comparisons.harness.cautions import lacks_ledger, spread_speeds, unknown_work
from comparisons.harness.fit_quality import dwelt_on
from comparisons.results import Answer, Comparison, Curve, EstimatorResult
from surge_core.fit_state import WITHHOLDING
from surge_core.rounding import round_to_error, significant

NOT_LOOKED_FOR = "not looked for here; `sindy-surge diagnose` or `sindy-surge run` does"


class TauReading(NamedTuple):
    """τ as another step reads it, its standard error, and what share of it `classic_ml` has too."""

    name: str
    value_s: float
    stderr_s: float
    shared_share: float = 0.0


# Two readings of one τ differ by no more than so many of their combined standard errors.
APART = 2.0
# Checks whose failure withholds the recommendation of a whole-run fit.
DECISIVE = {
    "phi_coverage": "its φ does not cover the range of its curve evenly",
    "input_correlation": "its errors depend on φ, so that the model or the stall state is wrong",
}


def answer_of(
    comparison: Comparison,
    *,
    test: str = "",
    readings: Sequence[TauReading] = (),
    verdict: str = "",
    missing: str = NOT_LOOKED_FOR,
    work: str = "",
    refused: Sequence[str] = (),
) -> Answer:
    """Say which τ and curve of a comparison to read, and why.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    test : str
        Name of the test; the names of the series files without it.
    readings : sequence of TauReading
        What other steps read.
    verdict, missing : str
        Of a diagnosis, where there is one.
    work : str
        What is known of ψ_QS, where a step found it.
    refused : sequence of str
        What other steps refused.
    """
    chosen, first = comparison.recommended, comparison.first
    model = first.model
    tau = (model.time_constant_s, model.time_constant_stderr_s) if chosen else (math.nan, math.nan)
    shared = first.whole_run.measurement_share_ if first.whole_run is not None else 0.0
    return Answer(
        test=_test_line(comparison, test),
        time_constant_s=tau[0],
        time_constant_stderr_s=tau[1],
        ci95_s=model.ci95_s if chosen else (math.nan, math.nan),
        estimator=chosen or "",
        label=first.label,
        why=_believed(comparison, first) if chosen else _not_believed(comparison),
        others=_others(*tau, shared, readings) if chosen else "",
        curve=_curve(comparison, first) if chosen else None,
        verdict=verdict,
        missing=missing,
        refused=(*_refused(comparison), *refused),
        work=work,
    )


def _test_line(comparison: Comparison, name: str = "") -> str:
    names = name or short_names(record.source for record in comparison.records)
    rows = comparison.rows
    # At its first row, before the surge heats the inlet.
    found = [r.Nc_frac[0] for r in comparison.records if r.Nc_frac is not None]
    speeds = dict.fromkeys(f"{100.0 * speed:.1f} %" for speed in found)
    speed = f" at {' and '.join(speeds)} speed" if speeds else ""
    # A series of φ and ψ' alone does not say where it is in stall.
    of = "in stall" if any(r.phi_unfiltered is not None for r in comparison.records) else "of rows"
    return (
        f"{names}{speed}: {counted(rows.n_segments, 'interval')} {of}, {rows.phi.size} rows at "
        f"{1.0 / rows.sample_period_s:g} Hz"
    )


def _believed(comparison: Comparison, first: EstimatorResult) -> str:
    words = (
        f"{_beforehand(first)}Believe {first.label} ({first.name}): it is one free run through the "
        f"unfiltered signals{_reserved(first)}"
    )
    # What its interval lacks where no twins were measured.
    lacking = "".join(
        f" {text[:1].upper()}{text[1:]}." for text in first.remarks if text.startswith("no twins")
    )
    aside = lacking + "".join(
        f" {other.label[:1].upper()}{other.label[1:]} reads "
        f"{significant(1e3 * other.model.time_constant_s, 3)} ms and is not quoted: it failed "
        f"{', '.join(other.failed)}."
        for other in comparison.results
        if other.whole_run is not None and other.converged and other.failed
        if other.name not in comparison.quotable
    )
    taus = [
        1e3 * result.model.time_constant_s
        for result in comparison.results
        if result.whole_run is None and result.converged
        if math.isfinite(result.model.time_constant_s)
    ]
    if not taus:
        return f"{words}.{aside}"
    low, high = (significant(end, 3) for end in (min(taus), max(taus)))
    spread = low if low == high else f"{low} to {high}"
    return (
        f"{words}. The low-pass before the flow equation biases the fits to low-passed rows, which "
        f"read {spread} ms.{aside}"
    )


def _reserved(first: EstimatorResult) -> str:
    """Say what else the recommended reading must be read with."""
    words, second = "", first.second_reading
    if second is not None:
        words = (
            f". The rows in stall alone read {significant(1e3 * second.value_s, 3)} ms, and the "
            "interval spans both"
        )
    return words


def _beforehand(first: EstimatorResult) -> str:
    """Say first what puts the model itself in doubt."""
    if first.held_out is None or first.held_out.r2 >= 0.0:
        return ""
    return (
        "With reserve: on cycles left out the curve is worse than a constant, and none is stated; "
        "what the model lacks may be in τ, beyond its interval. "
    )


def _not_believed(comparison: Comparison) -> str:
    """Say why no τ of a comparison may be quoted."""
    results = comparison.results
    withheld = [r for r in results if r.name == "classic_ml" and r.state in WITHHOLDING]
    whole = [result for result in results if result.whole_run is not None]
    decisive = [
        f"of {result.label} ({result.name}), {DECISIVE[check]}"
        for result in whole
        for check in result.failed
        if check in DECISIVE
    ]
    if any(result.model.time_constant_stderr_s == 0.0 for result in results):
        why = "it was held, not fitted"
    elif spread_speeds(comparison.records):
        why = "the records have different corrected speeds, and each may have a τ of its own"
    elif withheld:
        open_ = getattr(withheld[0].whole_run, "left_open_", "")
        why = f"{withheld[0].label} was refused, and the others know less"
        why += f"; {open_}" if open_ else ""
    elif not whole and any(map(lacks_ledger, comparison.records)):
        why = (
            "the series lies without the ledger that `sindy-surge reduce` wrote beside it, and its "
            "unfiltered columns cannot be read without; copy both"
        )
    elif not (whole or any(record.history for record in comparison.records)):
        why = (
            "a low-pass before the flow equation biases τ, and no ledger of `sindy-surge reduce` "
            "says whether these signals passed one. "
        )
        sound = any(result.converged and not result.failed for result in results)
        why += "If they did not, τ is that of the fits that " * sound
        why += "nothing speaks against" if sound else "Other checks speak against every fit as well"
    elif not whole:
        why = (
            "the series carries no unfiltered run, which `sindy-surge reduce` writes, and a "
            "low-pass before the flow equation biases τ"
        )
    elif decisive:
        why = decisive[0]
    elif not any(result.model.measured for result in whole):
        why = "it is not two standard errors above zero"
    else:
        why = "the records are no clean whole runs with hub and tip read apart"
    return f"Believe no τ: {why}.{_doubted_probes(comparison)}"


def _doubted_probes(comparison: Comparison) -> str:
    """Say what the reductions noted of probes that do not go with those beside them."""
    entries = [entry for record in comparison.records for entry in record.history]
    noted = [text for entry in entries if entry.step == "choose channels" for text in entry.flags]
    if not noted:
        return ""
    # What stands last is the plainest: the levels of two probes.
    return f" The reduction noted: {noted[-1]}" + "." * (not noted[-1].endswith("?"))


def _others(
    tau_s: float, stderr_s: float, shared_share: float, readings: Sequence[TauReading]
) -> str:
    """Say which other readings of τ agree with the one to quote, and which do not.

    An error that both have moves both alike, and has no part in their difference.
    """
    agree: list[str] = []
    apart: list[str] = []
    vague: list[str] = []
    for name, value_s, error_s, common in readings:
        if math.isfinite(value_s):
            reading = f"{round_to_error(1e3 * value_s, 1e3 * error_s)} ms"
            both = 2.0 * min(common, shared_share) ** 2 * value_s * tau_s
            apart_s = math.sqrt(max(stderr_s**2 + error_s**2 - both, 0.0))
            far = abs(value_s - tau_s) > APART * apart_s
            # Nearly anything agrees with a reading that would not be stated by itself.
            if far:
                apart.append(f"{name} {reading}")
            elif error_s <= LARGEST_SHARE * value_s:
                agree.append(f"{name} {reading}")
            else:
                vague.append(f"{name} ({reading})")
    words = []
    if agree:
        words.append(f"It agrees with {', '.join(agree)}.")
    if apart:
        words.append(
            f"It does not agree with {', '.join(apart)}: do not quote these beside it before the "
            "difference is explained."
        )
    if vague:
        are = "is" if len(vague) == 1 else "are"
        words.append(f"{' and '.join(vague)} {are} too uncertain to compare.")
    return " ".join(words)


def _refused(comparison: Comparison) -> list[str]:
    entries = [entry for record in comparison.records for entry in record.history]
    dropped = [
        f"{drop.what}: {drop.why}"
        for entry in entries
        if entry.step == "choose channels"
        for drop in entry.dropped
        # What is left out of the thermocouples is said of ψ.
        if drop.what.startswith("pair")
    ]
    refused: dict[str, list[str]] = {}
    for result in comparison.results:
        if result.state in WITHHOLDING:
            # What is advised stands with the estimator, further down.
            why = result.advice.partition(". ")[0]
            refused.setdefault(why, []).append(f"{result.label} ({result.name})")
    said = [*dropped, *(f"{' and '.join(who)}: {why}" for why, who in refused.items())]
    works = (unknown_work(record.history) for record in comparison.records)
    return [*said, *dict.fromkeys(work.text for work in works if work is not None)]


def _curve(comparison: Comparison, first: EstimatorResult) -> Curve | None:
    """Return the curve of an estimator where φ was scored; None where it states none."""
    if not first.states_curve or first.state in WITHHOLDING:
        return None
    model, rows = first.model, comparison.rows
    phi, measured, rising = rows.phi, rows.measured, np.gradient(rows.phi) > 0.0
    if first.whole_run is not None:
        inputs = first.whole_run.stacked()
        phi, measured = inputs.scored_phi, inputs.psi_p[inputs.scored]
        rising = (np.gradient(inputs.phi) > 0.0)[inputs.scored]
    low, high = model.valid_phi
    inside = (phi >= low) & (phi <= high)
    grid, value, stderr = np.asarray(model.table).T
    known = (grid >= low) & (grid <= high) & dwelt_on(grid, phi)
    return Curve(
        rows.target,
        model.terms,
        model.coefficients,
        model.stderr,
        model.valid_phi,
        grid[known],
        value[known],
        stderr[known],
        phi[inside],
        measured[inside],
        rising[inside],
    )
