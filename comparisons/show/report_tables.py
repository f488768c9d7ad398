"""The report's tables of comparisons and ledgers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from classic_ml.records import Dropped, LedgerEntry
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


def summary_table(fit: Comparison) -> Table:
    """Return the comparison table, from the same fields as that of the terminal.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    first = fit.recommended
    grid = fit.grid()
    numeric = [i not in grid.words for i in range(len(grid.header))]
    heads = tuple(
        Head(text, COLUMNS[text], number, text == "trust", "least" if number else "")
        for text, number in zip(grid.header, numeric, strict=True)
    )
    rows = tuple(
        _with_name(cells, row.label, row.estimator)
        for cells, row in zip(grid.rows, fit.table, strict=True)
    )
    order = "the recommended first" if first else "none is recommended"
    marks = ("best",) if first else ()
    return Table(f"Estimators of the {NAMES[fit.rows.target]}, {order}", heads, rows, marks)


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
    grid = reconstruction_grid(runs)
    heads = tuple(
        Head(text, RECONSTRUCTION_COLUMNS[text], i not in grid.words)
        for i, text in enumerate(grid.header)
    )
    rows = tuple(
        _with_name(cells, estimator_label(run.model.estimator), run.model.estimator)
        for cells, run in zip(grid.rows, runs, strict=True)
    )
    return Table("Validation: models fitted elsewhere, nothing refitted", heads, rows)


def ledger_tables(ledgers: Mapping[str, Sequence[LedgerEntry]]) -> tuple[Table, ...]:
    """Return the ledger of each record: every step, what it did, and what it dropped.

    Parameters
    ----------
    ledgers : mapping of str to sequence of LedgerEntry
        By the record they belong to.
    """
    prose = ("did", "parameters", "dropped", "flags")
    heads = (Head("#", numeric=True), Head("step"), *(Head(text, prose=True) for text in prose))
    tables = []
    for source, history in ledgers.items():
        rows = tuple(
            (
                str(number),
                entry.step,
                entry.did,
                "; ".join(f"{name} = {_value(v)}" for name, v in entry.parameters.items())
                or "none",
                "; ".join(map(_dropped, entry.dropped)) or "nothing dropped",
                "; ".join(entry.flags) or "none",
            )
            for number, entry in enumerate(history, start=1)
        )
        empty = "" if history else ": no ledger came with this record"
        tables.append(Table(f"{source}{empty}", heads, rows))
    return tuple(tables)


def _with_name(cells: Sequence[str], label: str, name: str) -> tuple[str | Cell, ...]:
    """Print below the label of an estimator the name that the command line knows it by."""
    named = label != name
    return tuple(Cell(cell, name) if named and cell == label else cell for cell in cells)


def _value(value: str | int | float | bool) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _dropped(dropped: Dropped) -> str:
    return f"{dropped.what} ({dropped.count}): {dropped.why}"
