"""The report: one HTML file that holds everything and asks the network for nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.checks import CheckRow
from classic_ml.records import LedgerEntry, counted, ledger_grid
from classic_ml.reduction import Reduction
from comparisons.analysis import Analysis
from comparisons.harness.answer import answer_of
from comparisons.harness.tau_trial import trial_of
from comparisons.missing_effect.report import diagnosis_parts
from comparisons.page.blocks import Block, Bullets, Part, Summary, Words
from comparisons.results import (
    SYMBOLS,
    Answer,
    Caution,
    Comparison,
    FittedLag,
    Reconstruction,
    Truth,
    reconstruction_grids,
    texts_of,
)
from comparisons.results.names import NAMES, named
from comparisons.show import plots_curve, plots_record
from comparisons.show.inspection import inspect_text
from comparisons.show.structure_output import structure_parts
from comparisons.show.table import work_table
from surge_core.display import Grid
from surge_core.rounding import significant

# Of many records fitted together the first few are drawn; the tables hold all.
RECORDS_DRAWN = 4
# Which τ to quote stands above all.
SAID_ELSEWHERE = ("quote_tau", "tau_biased")


@dataclass(frozen=True)
class ReportSection:
    """What one section of a report is about: a record, or several that are fitted together.

    Parameters
    ----------
    title : str
        Its heading.
    comparison : Comparison, optional
        Estimators of the pressure coefficient ψ' side by side.
    work : Comparison, optional
        The same of the work coefficient ψ.
    reduction : Reduction, optional
        How the record was reduced from raw counts; without it the pictures show φ and ψ' alone.
    truth : Truth, optional
        Of a simulated record, for ψ'.
    validation : tuple of Reconstruction
        Models fitted elsewhere, run over other records.
    extra : tuple of Part
        Further parts: evidence of other steps.
    quality : tuple of Block
        Further words on the data.
    answer : Answer, optional
        The first screen; made from the comparison without it.
    """

    title: str
    comparison: Comparison | None = None
    work: Comparison | None = None
    reduction: Reduction | None = None
    truth: Truth | None = None
    validation: tuple[Reconstruction, ...] = ()
    extra: tuple[Part, ...] = ()
    quality: tuple[Block, ...] = ()
    answer: Answer | None = None

    @property
    def fits(self) -> tuple[Comparison, ...]:
        """Its comparisons."""
        return tuple(fit for fit in (self.comparison, self.work) if fit is not None)

    @property
    def ledgers(self) -> dict[str, tuple[LedgerEntry, ...]]:
        """The ledger of each record, by its source."""
        found: dict[str, tuple[LedgerEntry, ...]] = {}
        if self.reduction is not None:
            found[self.reduction.series.source] = self.reduction.record.history
        records = [record for fit in self.fits for record in fit.records]
        for record in (*records, *(run.record for run in self.validation)):
            found.setdefault(record.source, record.history)
        return found


def report_pages(sections: Sequence[ReportSection]) -> list[tuple[str, tuple[Part, ...]]]:
    """Return the sections of a report as headings with the parts that hold anything, in order."""
    return [(section.title, _parts(section)) for section in sections]


def _parts(section: ReportSection) -> tuple[Part, ...]:
    fits, truth, answer = section.fits, section.truth, section.answer
    if answer is None and section.comparison is not None:
        answer = answer_of(section.comparison)
    evidence = (
        *_tau_words(fits),
        *map(_summary_table, fits),
        *([truth_list(fits[0], truth)] if truth is not None and section.comparison else []),
        *(
            plots_curve.characteristics(fit, truth if fit is section.comparison else None)
            for fit in fits
        ),
        *_reconstructions(section),
        *_trial(section),
        *map(plots_record.errors_in_time, fits),
    )
    equations = [
        Words(f"{result.label}:\n    {result.equation}", "code")
        for fit in fits
        for result in fit.results
        if result.equation
    ]
    quality = (*_cautions(section), *section.quality, *_record_pictures(section))
    ledgers = (
        replace(ledger_grid(history)[0], title=source)
        if history
        else Grid(f"{source}: no ledger came with this record", (), ())
        for source, history in section.ledgers.items()
    )
    parts = (
        Part("Reconstruction validation", _validation(section.validation)),
        Part("Evidence", evidence),
        *section.extra,
        Part("Checks", tuple(map(_checks_table, fits))),
        Part("Data quality", quality),
        Part("Ledger", tuple(ledgers)),
        Part("Settings", (*map(_summary_list, fits), *equations)),
    )
    shown = [part for part in parts if part.blocks]
    if answer is not None:
        return (_answer_part(answer, section.truth), *(replace(p, folded=True) for p in shown))
    # Without an answer the first part stands open in its place.
    return (*shown[:1], *(replace(part, folded=True) for part in shown[1:]))


def truth_list(fit: Comparison, truth: Truth) -> Bullets:
    """Say how far each estimator is from the truth that a simulated record was made with."""
    items = []
    for result in fit.results:
        model = result.model
        low, high = max(model.valid_phi[0], truth.phi[0]), min(model.valid_phi[1], truth.phi[-1])
        phi, value, _ = np.asarray(model.table).T
        known = (phi >= low) & (phi <= high)
        off = np.abs(value[known] - np.interp(phi[known], truth.phi, truth.quasi_steady))
        curve = f"; curve off by at most {significant(float(off.max()), 2)}" if off.size else ""
        items.append(f"{result.label}: {_tau_off(model, truth)}{curve}.")
    return Bullets(
        tuple(items),
        "plain",
        f"Found against true ({truth.label}, τ = {1e3 * truth.time_constant_s:g} ms); curves over "
        "the φ that each estimator scored",
    )


def _tau_off(model: FittedLag, truth: Truth) -> str:
    off_ms = 1e3 * (model.time_constant_s - truth.time_constant_s)
    stderr_ms = 1e3 * model.time_constant_stderr_s
    if not math.isfinite(off_ms):
        return "no τ"
    words = f"τ off by {off_ms:+.1f} ms"
    if math.isfinite(stderr_ms) and stderr_ms > 0.0:
        words += f" ({abs(off_ms) / stderr_ms:.1f} of its standard errors)"
    return words


def _answer_part(answer: Answer, truth: Truth | None) -> Part:
    """Return the first screen of a section."""
    items = list(answer.lines)
    if truth is not None:
        items.insert(1, ("true τ of the simulated rig", f"{1e3 * truth.time_constant_s:g} ms"))
    picture = None
    if answer.curve is not None:
        picture = plots_curve.curve_picture(answer.curve, answer.estimator, truth)
    return Part("", (Summary(answer.test, tuple(items), picture),))


def _tau_words(fits: Sequence[Comparison]) -> list[Words]:
    """Say what τ can be trusted for, where a ledger shows a low-pass before the flow equation."""
    said = [c.text for fit in fits for c in fit.cautions if c.code in SAID_ELSEWHERE]
    return [Words(text[0].upper() + text[1:], "caution") for text in said[:1]]


def _summary_table(fit: Comparison) -> Grid:
    """Return the comparison table, from the same fields as that of the terminal."""
    order = "the recommended first" if fit.recommended else "none is recommended"
    caption = f"Estimators of the {NAMES[fit.rows.target]}, {order}"
    return replace(fit.grid(), title=caption)


def _reconstructions(section: ReportSection) -> tuple[Block, ...]:
    blocks: list[Block] = []
    for fit in section.fits:
        drawn = [i for i in range(len(fit.records)) if np.any(fit.rows.record == i)]
        kinds = dict.fromkeys(result.rows.kind for result in fit.results)
        pairs = [(kind, i) for i in drawn[:RECORDS_DRAWN] for kind in kinds]
        blocks += [plots_record.reconstruction(fit, i, kind) for kind, i in pairs]
    return (*blocks, *_left_out(section))


def _left_out(section: ReportSection) -> list[Words]:
    n = len(section.fits[0].records) if section.fits else 0
    if n <= RECORDS_DRAWN:
        return []
    return [Words(f"The first {RECORDS_DRAWN} of {n} records are drawn; all were fitted.")]


def _trial(section: ReportSection) -> tuple[Block, ...]:
    fit, truth = section.comparison, section.truth
    if fit is None or fit.rows.target != "psi_p":
        return ()
    true_s = None if truth is None else truth.time_constant_s
    return (plots_curve.tau_trial(trial_of(fit), true_s),)


def _validation(runs: Sequence[Reconstruction]) -> tuple[Block, ...]:
    """Return scores and pictures of models that were fitted elsewhere, a table for each record."""
    blocks: list[Block] = []
    for grid in reconstruction_grids(runs):
        blocks.append(replace(grid, title=f"{grid.title}; nothing refitted"))
    groups: dict[tuple[str, str], list[Reconstruction]] = {}
    for run in runs:
        groups.setdefault((run.title, run.rows.kind), []).append(run)
    return (*blocks, *map(plots_record.validation, groups.values()))


def _checks_table(fit: Comparison) -> Grid:
    """Return the residual checks, a row for each estimator and a column for each check."""
    meanings = {c.check.replace("_", " "): c.meaning for r in fit.results for c in r.checks}
    rows = []
    for result in fit.results:
        by_name = {check.check.replace("_", " "): check for check in result.checks}
        cells = [_check_cell(by_name.get(name)) for name in meanings]
        rows.append((named(result.label, result.name), *cells))
    caption = f"Checks of the errors, {NAMES[fit.rows.target]}; below each, statistic and limit"
    words = frozenset(range(1 + len(meanings)))
    return Grid(caption, ("estimator", *meanings), tuple(rows), words, (), meanings)


def _check_cell(check: CheckRow | None) -> str:
    if check is None:
        return "not made"
    limit = f"{check.operator} {significant(check.threshold, 3)}"
    word = "passed" if check.passed else "failed"
    return f"{word}\n{significant(check.statistic, 3)} ({limit})"


def _cautions(section: ReportSection) -> tuple[Bullets, ...]:
    """List the cautions of the comparisons, or those of the ledger where nothing was fitted."""
    found: list[str] = []
    for fit in section.fits:
        # The ledger's hold for both coefficients and are said once; a fit's own say which it is.
        sources = tuple(f"{record.source}: " for record in fit.records)
        for caution in texts_of(each for each in fit.cautions if each.code not in SAID_ELSEWHERE):
            own = "" if caution.startswith(sources) else f"{SYMBOLS[fit.rows.target]}: "
            found.append(f"{own}{caution}")
    if not section.fits and section.reduction is not None:
        found += texts_of(
            Caution("ledger", source, entry.step, {"finding": flag})
            for source, history in section.ledgers.items()
            for entry in history
            for flag in entry.flags
        )
    if not found:
        return ()
    return (Bullets(tuple(dict.fromkeys(found)), "caution", "Cautions"),)


def _record_pictures(section: ReportSection) -> tuple[Block, ...]:
    """Return the path of the record, and its cycles in time where more than φ and ψ' is known."""
    reduction = section.reduction
    if reduction is not None:
        return plots_record.operating_points(reduction), plots_record.surge_cycles(reduction)
    pictures = tuple(
        plots_record.loops(series, fit.rows.target)
        for fit in section.fits
        for series in fit.records[:RECORDS_DRAWN]
    )
    return (*pictures, *_left_out(section))


def _summary_list(fit: Comparison) -> Bullets:
    """Say in words what was compared, and how it is to be read."""
    rows = fit.first.rows
    held_out = int(np.count_nonzero(~rows.train))
    low, high = fit.first.model.valid_phi
    label = fit.first.label
    items = (
        f"{rows.phi.size} rows in {counted(rows.n_segments, 'segment')} of "
        f"{counted(len(fit.records), 'record')} at {1.0 / rows.sample_period_s:g} Hz were fitted "
        f"by {label}; the last {held_out} rows were held out for the score.",
        "What the model lacks repeats in every cycle, so that a flexible curve learns it and is "
        "rewarded on held-out cycles too: held-out rms says how well "
        f"{SYMBOLS[rows.target]} is predicted, not how near the characteristic is.",
        f"Its φ dwells between {low:.3f} and {high:.3f} (5th to 95th percentile). "
        "Each curve is drawn where the φ of its own rows dwells.",
    )
    name = NAMES[rows.target]
    return Bullets(items, "plain", name[0].upper() + name[1:])


def run_section(found: Analysis) -> ReportSection:
    """Return an analysis as a section of a report."""
    parts: list[Part] = []
    if found.diagnosis is not None:
        parts += diagnosis_parts(found.diagnosis)
    evidence = [Part.together("Evidence: what is missing", parts)]
    if found.structure is not None:
        terms = structure_parts(found.structure)
        evidence.append(Part.together("Evidence: terms of ψ'_QS", terms))
    if found.work is not None:
        words = Words(work_table(found.work), "code")
        evidence.append(Part("Evidence: ψ_QS from the power", (words,)))
    return ReportSection(
        found.answer.test,
        found.comparison,
        reduction=found.reduction,
        extra=tuple(part for part in evidence if part.blocks),
        quality=(Words(inspect_text(found.inspection, None), "code"),),
        answer=found.answer,
    )
