"""The report's sentences: what came out, what it can be trusted for, what to beware of."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from classic_ml.records import LedgerEntry, counted
from comparisons.harness.cautions import tau_caution
from comparisons.page.blocks import Bullets, Words
from comparisons.results import SYMBOLS, Caution, Comparison, ComparisonRow, Truth, texts_of
from comparisons.show.plots_fit import NAMES
from surge_core.rounding import significant

# Which τ to quote stands above all.
SAID_ELSEWHERE = ("quote_tau", "tau_biased")

_Histories = Sequence[Sequence[LedgerEntry]]


def tau_words(fits: Sequence[Comparison], histories: _Histories) -> tuple[Words, ...]:
    """Say what τ can be trusted for, where the ledger shows a low-pass before the flow equation.

    Parameters
    ----------
    fits : sequence of Comparison
        What was fitted.
    histories : sequence of ledgers
        Of the records.
    """
    fitted = any(fit.rows.target == "psi_p" for fit in fits)
    whole = tuple(dict.fromkeys(name for fit in fits for name in fit.quotable))
    target = "psi_p" if fitted else "psi"
    caution = tau_caution(histories, target=target, quotable=whole)
    if caution is None:
        return ()
    return (Words(caution.text[0].upper() + caution.text[1:], "caution"),)


def cautions_list(
    fits: Sequence[Comparison], reduced: Mapping[str, Sequence[LedgerEntry]]
) -> tuple[Bullets, ...]:
    """List the cautions of the comparisons, or those of the ledger where nothing was fitted.

    Parameters
    ----------
    fits : sequence of Comparison
        What was fitted.
    reduced : mapping of str to sequence of LedgerEntry
        Ledger of a record that was reduced here.
    """
    found: list[str] = []
    for fit in fits:
        # The ledger's hold for both coefficients and are said once; a fit's own say which it is.
        sources = tuple(f"{record.source}: " for record in fit.records)
        for caution in texts_of(each for each in fit.cautions if each.code not in SAID_ELSEWHERE):
            own = "" if caution.startswith(sources) else f"{SYMBOLS[fit.rows.target]}: "
            found.append(f"{own}{caution}")
    if not fits:
        found += texts_of(
            Caution("ledger", source, entry.step, {"finding": flag})
            for source, history in reduced.items()
            for entry in history
            for flag in entry.flags
        )
    if not found:
        return ()
    return (Bullets(tuple(dict.fromkeys(found)), "caution", "Cautions"),)


def summary_list(fit: Comparison) -> Bullets:
    """Say in words what came out of a comparison.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    rows = fit.rows
    held_out = int(np.count_nonzero(~rows.train))
    low, high = fit.valid_phi
    items = (
        f"{rows.phi.size} rows in {counted(rows.n_segments, 'segment')} of "
        f"{counted(len(fit.records), 'record')} at {1.0 / rows.sample_period_s:g} Hz were fitted; "
        f"the last {held_out} rows were held out for the score.",
        "What the model lacks repeats in every cycle, so that a flexible curve learns it and is "
        "rewarded on held-out cycles too: held-out rms says how well "
        f"{SYMBOLS[rows.target]} is predicted, not how near the characteristic is.",
        f"The record's φ dwells between {low:.3f} and {high:.3f} (5th to 95th percentile). "
        "Outside it the curves are extrapolated.",
    )
    name = NAMES[rows.target]
    return Bullets(items, "plain", name[0].upper() + name[1:])


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
    for row in fit.table:
        model = fit.result(row.estimator).model
        low, high = max(model.valid_phi[0], truth.phi[0]), min(model.valid_phi[1], truth.phi[-1])
        phi, value, _ = np.asarray(model.table).T
        known = (phi >= low) & (phi <= high)
        off = np.abs(value[known] - np.interp(phi[known], truth.phi, truth.quasi_steady))
        curve = f"; curve off by at most {significant(float(off.max()), 2)}" if off.size else ""
        items.append(f"{row.label}: {_tau_off(row, truth)}{curve}.")
    return Bullets(
        tuple(items),
        "plain",
        f"Found against true ({truth.label}, τ = {1e3 * truth.time_constant_s:g} ms); curves over "
        "the φ that each estimator scored",
    )


def _tau_off(row: ComparisonRow, truth: Truth) -> str:
    off_ms = 1e3 * (row.time_constant_s - truth.time_constant_s)
    stderr_ms = 1e3 * row.time_constant_stderr_s
    if not math.isfinite(off_ms):
        return "no τ"
    words = f"τ off by {off_ms:+.1f} ms"
    if math.isfinite(stderr_ms) and stderr_ms > 0.0:
        words += f" ({abs(off_ms) / stderr_ms:.1f} of its standard errors)"
    return words
