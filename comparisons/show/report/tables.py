"""The report's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING

from classic_ml.records import Dropped, LedgerEntry
from comparisons.page.blocks import Cell, Head, Table, Words
from comparisons.results import (
    FIELDS,
    RECONSTRUCTION_FIELDS,
    Comparison,
    EstimatorResult,
    comparison_cells,
    estimator_label,
    reconstruction_cells,
)
from comparisons.show.report.words import coefficient_name
from surge_core.rounding import round_to_error, significant

if TYPE_CHECKING:
    from comparisons.results import Reconstruction
    from comparisons.show.report.report import ReportSection

__all__ = [
    "checks_table",
    "coefficients_table",
    "equation_words",
    "ledger_tables",
    "settings_tables",
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
    heads = tuple(
        Head(f.heading, f.meaning, f.numeric, f is FIELDS[-1], "best" if f.numeric else "")
        for f in FIELDS
    )
    rows = tuple(
        _with_name(cells, row.label, row.estimator)
        for cells, row in zip(comparison_cells(fit), fit.table, strict=True)
    )
    marks = () if fit.recommended is None else ("best",)
    return Table(f"Estimators of the {coefficient_name(fit)}", heads, rows, marks)


def checks_table(fit: Comparison) -> Table:
    """Return the residual checks of all estimators.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    rows, marks = [], []
    for result in fit.results:
        for check in result.checks:
            rows.append(
                (
                    result.label,
                    check.check.replace("_", " "),
                    significant(check.statistic, 3),
                    f"{check.operator} {significant(check.threshold, 3)}",
                    "passed" if check.passed else "failed",
                    check.meaning,
                )
            )
            marks.append("" if check.passed else "failed")
    heads = (
        Head("estimator"),
        Head("check"),
        Head("statistic", "what was computed", True),
        Head("threshold", "where the statistic should lie", True),
        Head("outcome"),
        Head("meaning", prose=True),
    )
    return Table(f"Residual checks, {coefficient_name(fit)}", heads, tuple(rows), tuple(marks))


def validation_table(runs: tuple[Reconstruction, ...]) -> Table:
    """Return the scores of models that were fitted elsewhere.

    Parameters
    ----------
    runs : tuple of Reconstruction
        Models and the records they were run on.
    """
    heads = tuple(Head(f.heading, f.meaning, f.numeric) for f in RECONSTRUCTION_FIELDS)
    rows = tuple(
        _with_name(cells, estimator_label(run.model.estimator), run.model.estimator)
        for cells, run in zip(reconstruction_cells(runs), runs, strict=True)
    )
    return Table("Validation: models fitted elsewhere, nothing refitted", heads, rows)


def equation_words(fit: Comparison) -> tuple[Words, ...]:
    """Return the equation of each estimator.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    return tuple(
        Words(f"{result.label}:\n    {result.equation}", "code")
        for result in fit.results
        if result.equation
    )


def coefficients_table(fit: Comparison) -> Table:
    """Return the terms of each characteristic with their coefficients, side by side.

    Parameters
    ----------
    fit : Comparison
        Estimators side by side.
    """
    terms = dict.fromkeys(term for result in fit.results for term in result.model.terms)
    rows = [("τ [ms]", *(_tau_ms(result) for result in fit.results))]
    rows += [(term, *(_coefficient(result, term) for result in fit.results)) for term in terms]
    hold = fit.results[0].model.hold if fit.results else ""
    words = {"first": "joined by straight lines", "zero": "held from one sample to the next"}
    return Table(
        f"Coefficients of the {coefficient_name(fit)} ± standard error; φ {words.get(hold, '')} "
        f"(hold “{hold}”)",
        (Head("term"), *(Head(result.label, result.name, True) for result in fit.results)),
        tuple(rows),
    )


def ledger_tables(section: ReportSection) -> tuple[Table, ...]:
    """Return the ledger of each record: every step, what it did, and what it dropped.

    Parameters
    ----------
    section : ReportSection
        The section.
    """
    ledgers: dict[str, tuple[LedgerEntry, ...]] = {}
    if section.reduction is not None:
        ledgers[section.reduction.series.source] = section.reduction.record.history
    for fit in (section.comparison, section.work):
        for record in fit.records if fit is not None else ():
            ledgers.setdefault(record.source, record.history)
    for reconstruction in section.validation:
        ledgers.setdefault(reconstruction.record.source, reconstruction.record.history)
    return tuple(_ledger_table(source, history) for source, history in ledgers.items())


def settings_tables(section: ReportSection) -> tuple[Table, ...]:
    """Return the switches that the reduction ran with.

    Parameters
    ----------
    section : ReportSection
        The section.
    """
    if section.reduction is None:
        return ()
    reduction = section.reduction
    from_s, to_s = reduction.window_s
    rows = [("test", reduction.test.name), ("window", f"{from_s:.3f} to {to_s:.3f} s")]
    rows += [(name, _setting(value)) for name, value in asdict(reduction.settings).items()]
    return (Table("Settings of the reduction", (Head("setting"), Head("value")), tuple(rows)),)


def _with_name(cells: list[str], label: str, name: str) -> tuple[str | Cell, ...]:
    """Print below the label of an estimator the name that the command line knows it by."""
    named = label != name
    return tuple(Cell(cell, name) if named and cell == label else cell for cell in cells)


def _tau_ms(result: EstimatorResult) -> str:
    model = result.model
    return round_to_error(1e3 * model.time_constant_s, 1e3 * model.time_constant_stderr_s)


def _coefficient(result: EstimatorResult, term: str) -> str:
    model = result.model
    if term not in model.terms:
        return "—"
    place = model.terms.index(term)
    return round_to_error(model.coefficients[place], model.stderr[place])


def _setting(value: object) -> str:
    return "from the description of the test" if value is None else str(value)


def _ledger_table(source: str, history: tuple[LedgerEntry, ...]) -> Table:
    heads = (
        Head("#", "", True),
        Head("step"),
        Head("did", prose=True),
        Head("parameters", prose=True),
        Head("dropped", prose=True),
        Head("flags", prose=True),
    )
    rows = tuple(
        (
            str(number),
            entry.step,
            entry.did,
            _parameters(entry.parameters),
            "; ".join(map(_dropped, entry.dropped)) or "nothing dropped",
            "; ".join(entry.flags) or "none",
        )
        for number, entry in enumerate(history, start=1)
    )
    empty = "" if history else ": no ledger came with this record"
    return Table(f"{source}{empty}", heads, rows)


def _parameters(parameters: Mapping[str, str | int | float | bool]) -> str:
    return "; ".join(f"{name} = {_value(value)}" for name, value in parameters.items()) or "none"


def _value(value: str | int | float | bool) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _dropped(dropped: Dropped) -> str:
    return f"{dropped.what} ({dropped.count}): {dropped.why}"
