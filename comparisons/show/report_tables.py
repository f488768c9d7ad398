"""The report's tables of comparisons and ledgers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from classic_ml.records import LedgerEntry, ledger_grid
from comparisons.page.blocks import Cell, Head, Table
from comparisons.results import (
    COLUMNS,
    RECONSTRUCTION_COLUMNS,
    Comparison,
    Reconstruction,
    estimator_label,
    reconstruction_grid,
)
from comparisons.show.plots_fit import NAMES
from surge_core.rounding import significant

__all__ = [
    "checks_table",
    "ledger_tables",
    "summary_table",
    "validation_table",
]

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
    """Return the residual checks of all estimators.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    checks = [(result.label, check) for result in fit.results for check in result.checks]
    rows = tuple(
        (
            label,
            check.check.replace("_", " "),
            significant(check.statistic, 3),
            f"{check.operator} {significant(check.threshold, 3)}",
            "passed" if check.passed else "failed",
            check.meaning,
        )
        for label, check in checks
    )
    heads = (
        Head("estimator"),
        Head("check"),
        Head("statistic", "what was computed", numeric=True),
        Head("threshold", "where the statistic should lie", numeric=True),
        Head("outcome"),
        Head("meaning", prose=True),
    )
    marks = tuple("" if check.passed else "failed" for _, check in checks)
    return Table(f"Residual checks, {NAMES[fit.rows.target]}", heads, rows, marks)


def validation_table(runs: Sequence[Reconstruction]) -> Table:
    """Return the scores of models that were fitted elsewhere.

    Parameters
    ----------
    runs : sequence of Reconstruction
        Models and the records they were run on.
    """
    caption = "Validation: models fitted elsewhere, nothing refitted"
    table = Table.of(reconstruction_grid(runs), caption=caption, meanings=RECONSTRUCTION_COLUMNS)
    names = (run.model.estimator for run in runs)
    return _with_names(table, ((estimator_label(name), name) for name in names))


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
