"""The report's sentences: what came out, what it can be trusted for, what to beware of."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from classic_ml.records import LedgerEntry
from comparisons.harness.cautions import tau_caution, unknown_work
from comparisons.page.blocks import Bullets, Words
from comparisons.results import SYMBOLS, Caution, Comparison, Truth, texts_of
from comparisons.show.report.agreement import dwelling, dwelling_words
from surge_core.rounding import round_to_error, significant

if TYPE_CHECKING:
    from comparisons.show.report.report import ReportSection

__all__ = [
    "cautions_list",
    "coefficient_name",
    "ranking_words",
    "summary_list",
    "tau_words",
    "truth_list",
    "unknown_work_list",
]


def coefficient_name(fit: Comparison) -> str:
    """Return what people call the coefficient of a comparison."""
    if fit.rows.target == "psi_p":
        return "pressure coefficient ψ'"
    return "work coefficient ψ"


def tau_words(section: ReportSection, fits: tuple[Comparison, ...]) -> tuple[Words, ...]:
    """Say what τ can be trusted for, where the ledger shows a low-pass before the flow equation.

    Parameters
    ----------
    section : ReportSection
        The section.
    fits : tuple of Comparison
        Its comparisons.
    """
    fitted = any(fit.rows.target == "psi_p" for fit in fits)
    target = "psi_p" if fitted else "psi"
    whole = tuple(dict.fromkeys(name for fit in fits for name in fit.quotable))
    caution = tau_caution(_histories(section, fits), target=target, quotable=whole)
    if caution is None:
        return ()
    return (Words(caution.text[0].upper() + caution.text[1:], "caution"),)


def cautions_list(section: ReportSection, fits: tuple[Comparison, ...]) -> tuple[Bullets, ...]:
    """List the cautions of the comparisons, or those of the ledger where nothing was fitted.

    Parameters
    ----------
    section : ReportSection
        The section.
    fits : tuple of Comparison
        Its comparisons.
    """
    found: list[str] = []
    for fit in fits:
        # The ledger's hold for both coefficients and are said once; a fit's own say which it is.
        sources = tuple(f"{record.source}: " for record in fit.records)
        symbol = coefficient_name(fit).rsplit(" ", 1)[-1]
        # Which τ to quote stands above all, what the ranking is worth below the table.
        elsewhere = ("quote_tau", "tau_biased", "held_out_is_prediction")
        for caution in texts_of(c for c in fit.cautions if c.code not in elsewhere):
            said = caution if caution.startswith(sources) else f"{symbol}: {caution}"
            found += [] if said in found else [said]
    if not fits and section.reduction is not None:
        source = section.reduction.series.source
        found += texts_of(
            Caution("ledger", source, entry.step, {"finding": flag})
            for entry in section.reduction.record.history
            for flag in entry.flags
        )
    if not found:
        return ()
    return (Bullets(tuple(found), "caution", "Cautions"),)


def summary_list(fit: Comparison) -> Bullets:
    """Say in words what came out of a comparison.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    rows = fit.rows
    held_out = int(np.count_nonzero(~rows.train))
    items = [
        f"{rows.phi.size} rows in {_count(rows.n_segments, 'segment')} of "
        f"{_count(len(fit.records), 'record')} at {1.0 / rows.sample_period_s:g} Hz were fitted; "
        f"the last {held_out} rows were held out for the score.",
        _best_words(fit),
        "What the model lacks repeats in every cycle, so that a flexible curve learns it and is "
        f"rewarded on held-out cycles too: {_ranking_meaning(fit)}.",
        _tau_range_words(fit),
        f"The record's {dwelling(fit)}. {dwelling_words(fit)}",
        _checks_words(fit),
    ]
    return Bullets(tuple(items), "plain", coefficient_name(fit).capitalize())


def truth_list(fit: Comparison, truth: Truth) -> Bullets:
    """Say how far each estimator is from the truth that a simulated record was made with.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    truth : Truth
        The truth.
    """
    items = []
    low, high = max(fit.valid_phi[0], truth.phi[0]), min(fit.valid_phi[1], truth.phi[-1])
    for row in fit.table:
        model = fit.result(row.estimator).model
        phi, value, _ = np.asarray(model.table).T
        known = (phi >= low) & (phi <= high)
        off = np.abs(value[known] - np.interp(phi[known], truth.phi, truth.quasi_steady))
        curve = f"curve off by at most {significant(float(off.max()), 2)}" if off.size else ""
        items.append(f"{row.label}: {_tau_off(row.time_constant_s, model, truth)}; {curve}.")
    return Bullets(
        tuple(items),
        "plain",
        f"Found against true ({truth.label}, τ = {1e3 * truth.time_constant_s:g} ms); curves where "
        f"φ dwells and the truth is known, from {low:.3f} to {high:.3f}",
    )


def ranking_words(fit: Comparison) -> Words:
    """Say below the table what its order means.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    said = _ranking_meaning(fit)
    return Words(f"{said[0].upper()}{said[1:]}.", "quiet")


def unknown_work_list(section: ReportSection, fits: tuple[Comparison, ...]) -> tuple[Bullets, ...]:
    """Say why ψ is not known, where the ledger shows that it could not be found.

    Parameters
    ----------
    section : ReportSection
        The section.
    fits : tuple of Comparison
        Its comparisons.
    """
    if section.work is not None:
        return ()
    reasons = dict.fromkeys(
        f"{reason.text}."
        for history in _histories(section, fits)
        if (reason := unknown_work(history))
    )
    return (Bullets(tuple(reasons), "plain", "Work coefficient ψ"),) if reasons else ()


def _ranking_meaning(fit: Comparison) -> str:
    return Caution("held_out_is_prediction", numbers={"symbol": SYMBOLS[fit.rows.target]}).text


def _tau_off(tau_s: float, model: object, truth: Truth) -> str:
    stderr_s = float(getattr(model, "time_constant_stderr_s", math.nan))
    off_ms = 1e3 * (tau_s - truth.time_constant_s)
    if not math.isfinite(off_ms):
        return "no τ"
    words = f"τ off by {off_ms:+.1f} ms"
    if math.isfinite(stderr_s) and stderr_s > 0.0:
        words += f" ({abs(off_ms) / (1e3 * stderr_s):.1f} of its standard errors)"
    return words


def _best_words(fit: Comparison) -> str:
    known = [row for row in fit.table if math.isfinite(row.held_out_rms)]
    best = min(known, key=lambda row: row.held_out_rms, default=fit.table[0])
    score = fit.result(best.estimator).held_out
    if score is None:
        return "There were too few rows to hold any out: none is scored."
    words = (
        f"Least held-out error: {best.label}, rms {significant(score.rms, 3)}, "
        f"{score.fit_percent:.0f} % of the signal's spread explained (fit)."
    )
    level = [
        row.label
        for row in fit.table
        if row is not best
        and math.isfinite(row.difference)
        and abs(row.difference) < 2.0 * row.paired_error
    ]
    if level:
        words += f" Within twice the paired error of it: {', '.join(level)}."
    elif len(fit.table) > 1:
        words += " All others are worse by more than twice the paired error."
    return words


def _tau_range_words(fit: Comparison) -> str:
    best = next((row for row in fit.table if row.estimator in fit.quotable), fit.table[0])
    tau = round_to_error(1e3 * best.time_constant_s, 1e3 * best.time_constant_stderr_s)
    all_ms = [1e3 * row.time_constant_s for row in fit.table if math.isfinite(row.time_constant_s)]
    words = f"Its time constant: τ = {tau} ms (standard error)."
    if best.estimator in fit.quotable:
        words = (
            f"The time constant by {best.label}, from one free run through the unfiltered signals: "
            f"τ = {tau} ms (standard error)."
        )
    if not best.time_constant_stderr_s < best.time_constant_s:
        words += " It is not separated from zero."
    if len(all_ms) > 1:
        words += (
            f" All estimators: {significant(min(all_ms), 3)} to {significant(max(all_ms), 3)} ms."
        )
    return words


def _checks_words(fit: Comparison) -> str:
    failed: dict[str, list[str]] = {}
    for result in fit.results:
        for check in result.checks:
            if not check.passed:
                failed.setdefault(check.check, []).append(result.label)
    if not failed:
        return "All residual checks passed."
    each = [
        f"{check} for " + ("all" if len(labels) == len(fit.results) else ", ".join(labels))
        for check, labels in failed.items()
    ]
    return "Residual checks that failed: " + "; ".join(each) + "."


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def _histories(
    section: ReportSection, fits: tuple[Comparison, ...]
) -> list[tuple[LedgerEntry, ...]]:
    histories = [record.history for fit in fits for record in fit.records]
    if section.reduction is not None:
        histories.append(section.reduction.record.history)
    return histories
