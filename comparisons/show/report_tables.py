"""The report's tables of comparisons and ledgers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from classic_ml.checks import CheckRow
from classic_ml.records import LedgerEntry, ledger_grid
from comparisons.page.blocks import Cell, Head, Table
from comparisons.results import (
    COLUMNS,
    RECONSTRUCTION_COLUMNS,
    Comparison,
    Reconstruction,
    estimator_label,
    reconstruction_grids,
)
from comparisons.show.plots_fit import NAMES
from surge_core.rounding import significant

# Columns of a ledger that hold sentences.
LEDGER_PROSE = ("did", "parameters", "left out", "flags")


def summary_table(fit: Comparison) -> Table:
    """Return the comparison table, from the same fields as that of the terminal.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    order = "the recommended first" if fit.recommended else "none is recommended"
    caption = f"Estimators of the {NAMES[fit.rows.target]}, {order}"
    table = Table.of(fit.grid(), caption=caption, meanings=COLUMNS, prose=("trust",), zero="least")
    return _with_names(table, ((row.label, row.estimator) for row in fit.table))


def checks_table(fit: Comparison) -> Table:
    """Return the residual checks of all estimators, a row for each and a column for each check.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side, in the order of their table.
    """
    results = [fit.result(row.estimator) for row in fit.table]
    meanings = {c.check: c.meaning for result in results for c in result.checks}
    rows = []
    for result in results:
        by_name = {check.check: check for check in result.checks}
        cells = [_check_cell(by_name.get(name)) for name in meanings]
        rows.append((Cell(result.label, result.name), *cells))
    heads = (
        Head("estimator"),
        *(Head(name.replace("_", " "), meaning) for name, meaning in meanings.items()),
    )
    caption = f"Checks of the errors, {NAMES[fit.rows.target]}; below each, statistic and limit"
    return Table(caption, heads, tuple(rows))


def _check_cell(check: CheckRow | None) -> str | Cell:
    if check is None:
        return "not made"
    limit = f"{check.operator} {significant(check.threshold, 3)}"
    small = f"{significant(check.statistic, 3)} ({limit})"
    return Cell("passed" if check.passed else "failed", small)


def validation_tables(runs: Sequence[Reconstruction]) -> tuple[Table, ...]:
    """Return the scores of models that were fitted elsewhere, a table for each record.

    Parameters
    ----------
    runs : sequence of Reconstruction
        Models and the records they were run on.
    """
    tables, meanings = [], RECONSTRUCTION_COLUMNS
    for grid in reconstruction_grids(runs):
        caption = f"{grid.title}; nothing refitted"
        table = Table.of(grid, caption=caption, meanings=meanings, zero="least")
        own = [run.model.estimator for run in runs if run.title == grid.title]
        tables.append(_with_names(table, ((estimator_label(name), name) for name in own)))
    return tuple(tables)


def ledger_tables(ledgers: Mapping[str, Sequence[LedgerEntry]]) -> tuple[Table, ...]:
    """Return the ledger of each record: every step, what it did, and what it dropped.

    Parameters
    ----------
    ledgers : mapping of str to sequence of LedgerEntry
        By the record they belong to.
    """
    return tuple(
        Table.of(ledger_grid(history)[0], caption=source, prose=LEDGER_PROSE)
        if history
        else Table(f"{source}: no ledger came with this record", (), ())
        for source, history in ledgers.items()
    )


def _with_names(table: Table, named: Iterable[tuple[str, str]]) -> Table:
    """Print below the label of each row's estimator the name that the command line knows it by."""
    rows = tuple(
        tuple(Cell(label, name) if cell == label != name else cell for cell in cells)
        for cells, (label, name) in zip(table.rows, named, strict=True)
    )
    return replace(table, rows=rows)
