"""The parts of a section, in the order of the report."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from comparisons.page.blocks import Block, Part
from comparisons.results import Comparison
from comparisons.show.report.pictures import (
    characteristic_picture,
    migration_pictures,
    reconstruction_pictures,
    residual_pictures,
    spectra_pictures,
    time_pictures,
    trial_picture,
    validation_picture,
)
from comparisons.show.report.tables import (
    checks_table,
    coefficients_table,
    equation_words,
    ledger_tables,
    settings_tables,
    summary_table,
)
from comparisons.show.report.words import (
    cautions_list,
    ranking_words,
    summary_list,
    tau_words,
    truth_list,
    unknown_work_list,
)

if TYPE_CHECKING:
    from comparisons.show.report.report import ReportSection

__all__ = ["makers_of"]


def makers_of(section: ReportSection) -> tuple[Callable[[], Part], ...]:
    """Return what makes each part of a section, in order; drawing takes some of them a second.

    Parameters
    ----------
    section : ReportSection
        What it is about.
    """
    fits = tuple(fit for fit in (section.comparison, section.work) if fit is not None)
    return (
        lambda: Part("In short", _summary(section, fits)),
        lambda: Part("Operating-point migration", migration_pictures(section)),
        lambda: Part("Surge cycles in time", time_pictures(section)),
        lambda: Part("Spectra before and after the filter", spectra_pictures(section)),
        lambda: Part("Quasi-steady characteristics", _characteristics(section)),
        lambda: Part("Reconstruction against measurement", _reconstructions(section, fits)),
        lambda: Part("Time constant by trial", _trial(section)),
        lambda: Part("Residuals", tuple(b for fit in fits for b in residual_pictures(fit))),
        lambda: Part("Residual checks", tuple(checks_table(fit) for fit in fits)),
        lambda: Part("Equations", _equations(fits)),
        *(partial(_given, part) for part in section.extra),
        lambda: Part("Ledger of the reduction", ledger_tables(section)),
        lambda: Part("Settings", settings_tables(section)),
    )


def _given(part: Part) -> Part:
    return part


def _summary(section: ReportSection, fits: tuple[Comparison, ...]) -> tuple[Block, ...]:
    blocks: list[Block] = []
    for fit, truth in ((section.comparison, section.truth), (section.work, section.work_truth)):
        if fit is not None:
            blocks += [summary_list(fit), summary_table(fit), ranking_words(fit)]
            if truth is not None:
                blocks.append(truth_list(fit, truth))
    blocks += unknown_work_list(section, fits)
    return (*tau_words(section, fits), *cautions_list(section, fits), *blocks)


def _characteristics(section: ReportSection) -> tuple[Block, ...]:
    pairs = ((section.comparison, section.truth), (section.work, section.work_truth))
    return tuple(characteristic_picture(fit, truth) for fit, truth in pairs if fit is not None)


def _reconstructions(section: ReportSection, fits: tuple[Comparison, ...]) -> tuple[Block, ...]:
    blocks = [block for fit in fits for block in reconstruction_pictures(fit)]
    return (*blocks, *validation_picture(section.validation))


def _trial(section: ReportSection) -> tuple[Block, ...]:
    fit = section.comparison
    if fit is None or fit.rows.target != "psi_p":
        return ()
    return trial_picture(fit, section.truth)


def _equations(fits: tuple[Comparison, ...]) -> tuple[Block, ...]:
    blocks: list[Block] = []
    for fit in fits:
        blocks += [*equation_words(fit), coefficients_table(fit)]
    return tuple(blocks)
