"""The report: one HTML file that holds everything and asks the network for nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.harness.answer import answer_of
from comparisons.page.blocks import Block, Part, Words
from comparisons.page.html import render_page
from comparisons.results import Answer, Comparison, Reconstruction, Truth
from comparisons.show import plots_fit, plots_record, plots_residuals, plots_series
from comparisons.show.answer_page import answer_part
from comparisons.show.plots_tau_trial import tau_trial
from comparisons.show.report_tables import (
    checks_table,
    ledger_tables,
    summary_table,
    validation_tables,
)
from comparisons.show.report_words import (
    cautions_list,
    summary_list,
    tau_words,
    truth_list,
)

if TYPE_CHECKING:
    from classic_ml.records import LedgerEntry
    from classic_ml.reduction import Reduction

# Of many records fitted together the first few are drawn; the tables hold all.
RECORDS_DRAWN = 4


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
    def fits(self) -> tuple[tuple[Comparison, Truth | None], ...]:
        """Its comparisons, each with the truth where that is known."""
        pairs = ((self.comparison, self.truth), (self.work, None))
        return tuple((fit, truth) for fit, truth in pairs if fit is not None)

    @property
    def ledgers(self) -> dict[str, tuple[LedgerEntry, ...]]:
        """The ledger of each record, by its source."""
        found: dict[str, tuple[LedgerEntry, ...]] = {}
        if self.reduction is not None:
            found[self.reduction.series.source] = self.reduction.record.history
        records = [record for fit, _ in self.fits for record in fit.records]
        for record in (*records, *(run.record for run in self.validation)):
            found.setdefault(record.source, record.history)
        return found


def render_report(
    sections: Sequence[ReportSection],
    *,
    title: str,
    command: str,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> str:
    """Return a report as one self-contained HTML page.

    Parameters
    ----------
    sections : sequence of ReportSection
        What it is about.
    title : str
        Title of the page.
    command : str
        The command line that made it.
    progress : callable
        Wraps the iteration over the pictures, to show how far the drawing is.

    Returns
    -------
    str
        HTML with its style and its images in it. All text is escaped: names of files and
        channels, and what ledgers say, are data.
    """
    return render_page(
        report_pages(sections),
        title=title,
        command=command,
        progress=progress,
    )


def report_pages(sections: Sequence[ReportSection]) -> list[tuple[str, tuple[Part, ...]]]:
    """Return the sections of a report as headings with their parts.

    Parameters
    ----------
    sections : sequence of ReportSection
        What the report is about.
    """
    return [(section.title, section_parts(section)) for section in sections]


def section_parts(section: ReportSection) -> tuple[Part, ...]:
    """Return the parts of a section that hold anything, in the order of the report.

    Parameters
    ----------
    section : ReportSection
        What it is about.
    """
    fits = [fit for fit, _ in section.fits]
    histories = list(section.ledgers.values())
    reduced = section.ledgers if section.reduction is not None else {}
    answer = section.answer
    if answer is None and section.comparison is not None:
        answer = answer_of(section.comparison)
    tables = [summary_table(fit) for fit in fits]
    truths = [truth_list(fit, truth) for fit, truth in section.fits if truth is not None]
    evidence = (
        *tau_words(fits, histories),
        *tables,
        *truths,
        *(plots_fit.characteristics(fit, truth) for fit, truth in section.fits),
        *_reconstructions(section),
        *_trial(section),
        *map(plots_residuals.errors_in_time, fits),
    )
    quality = (
        *cautions_list(fits, reduced),
        *section.quality,
        *_migration(section),
        *_in_time(section),
    )
    settings = (*map(summary_list, fits), *(block for fit in fits for block in _equations(fit)))
    parts = (
        Part("Reconstruction validation", _validation(section)),
        Part("Evidence", evidence),
        *section.extra,
        Part("Checks", tuple(map(checks_table, fits))),
        Part("Data quality", quality),
        Part("Ledger", ledger_tables(section.ledgers)),
        Part("Settings", settings),
    )
    shown = [part for part in parts if part.blocks]
    if answer is not None:
        return (answer_part(answer, section.truth), *(replace(p, folded=True) for p in shown))
    # Without an answer the first part stands open in its place.
    return (*shown[:1], *(replace(part, folded=True) for part in shown[1:]))


def _migration(section: ReportSection) -> tuple[Block, ...]:
    if section.reduction is not None:
        return (plots_record.operating_points(section.reduction),)
    pictures = tuple(
        plots_series.loops(series, fit.rows.target)
        for fit, _ in section.fits
        for series in fit.records[:RECORDS_DRAWN]
    )
    return (*pictures, *_left_out(section))


def _in_time(section: ReportSection) -> tuple[Block, ...]:
    """Return the surge cycles in time, of which only a reduction knows more than φ and ψ'."""
    if section.reduction is None:
        return ()
    return (plots_record.surge_cycles(section.reduction),)


def _reconstructions(section: ReportSection) -> tuple[Block, ...]:
    blocks: list[Block] = []
    for fit, _ in section.fits:
        drawn = [i for i in range(len(fit.records)) if np.any(fit.rows.record == i)]
        kinds = dict.fromkeys(fit.result(row.estimator).rows.kind for row in fit.table)
        pairs = [(kind, i) for i in drawn[:RECORDS_DRAWN] for kind in kinds]
        blocks += [plots_fit.reconstruction(fit, i, kind) for kind, i in pairs]
    return (*blocks, *_left_out(section))


def _validation(section: ReportSection) -> tuple[Block, ...]:
    groups: dict[tuple[str, str], list[Reconstruction]] = {}
    for run in section.validation:
        groups.setdefault((run.title, run.rows.kind), []).append(run)
    return (*validation_tables(section.validation), *map(plots_fit.validation, groups.values()))


def _trial(section: ReportSection) -> tuple[Block, ...]:
    from comparisons.harness.tau_trial import trial_of

    fit, truth = section.comparison, section.truth
    if fit is None or fit.rows.target != "psi_p":
        return ()
    true_s = None if truth is None else truth.time_constant_s
    return (tau_trial(trial_of(fit), true_s, whole_runs=fit.has_whole_run),)


def _equations(fit: Comparison) -> tuple[Block, ...]:
    """Return the equations, which hold τ and the coefficients with their standard errors."""
    return tuple(
        Words(f"{result.label}:\n    {result.equation}", "code")
        for result in fit.results
        if result.equation
    )


def _records(section: ReportSection) -> tuple[CoefficientSeries, ...]:
    return section.fits[0][0].records if section.fits else ()


def _left_out(section: ReportSection) -> list[Words]:
    n = len(_records(section))
    if n <= RECORDS_DRAWN:
        return []
    return [Words(f"The first {RECORDS_DRAWN} of {n} records are drawn; all were fitted.")]
