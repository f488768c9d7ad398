"""Tables of results: one list of fields each, for the terminal and for the report."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from comparisons.harness.cautions import grouped_cautions, ranking_caution, tau_caution
from comparisons.harness.compare import Comparison, ComparisonRow, EstimatorResult
from comparisons.harness.fit_quality import paired_difference
from comparisons.harness.labels import estimator_label
from comparisons.harness.reconstruction import Reconstruction
from surge_core.rounding import NOT_KNOWN, round_like, round_to_error, significant

__all__ = [
    "FIELDS",
    "RECONSTRUCTION_FIELDS",
    "TableField",
    "comparison_cells",
    "comparison_table",
    "reconstruction_cells",
    "reconstruction_table",
]

WIDTH = 110
GAP = "  "
ONE_SIDED_95 = 1.645
SYMBOLS = {"psi_p": "ψ'", "psi": "ψ"}


@dataclass(frozen=True)
class TableField:
    """One column of a table.

    Parameters
    ----------
    heading : str
        Head of the column.
    meaning : str
        What it says, for a tooltip or a legend.
    text : callable
        Gives the cell: ``text(row, result)`` of a comparison, ``text(run)`` of a reconstruction.
    numeric : bool
        Whether the column holds numbers.
    """

    heading: str
    meaning: str
    text: Callable[..., str]
    numeric: bool = True


def _rank(row: ComparisonRow, _: EstimatorResult) -> str:
    return str(row.rank)


def _label(row: ComparisonRow, _: EstimatorResult) -> str:
    return row.label


def _held_out(row: ComparisonRow, result: EstimatorResult) -> str:
    if not math.isfinite(row.held_out_rms):
        return NOT_KNOWN
    blocks = result.held_out_blocks
    # Against a reference without error the paired difference is the rms itself.
    silent = np.column_stack([np.zeros(blocks.shape[0]), blocks[:, 1]])
    _, error = paired_difference(blocks, silent) if blocks.size else (0.0, math.nan)
    return round_to_error(row.held_out_rms, error)


def _difference(row: ComparisonRow, _: EstimatorResult) -> str:
    if not math.isfinite(row.held_out_rms):
        return NOT_KNOWN
    return "best" if row.rank == 1 else round_to_error(row.difference, row.paired_error)


def _tau(row: ComparisonRow, _: EstimatorResult) -> str:
    return round_to_error(1e3 * row.time_constant_s, 1e3 * row.time_constant_stderr_s)


def _interval(row: ComparisonRow, result: EstimatorResult) -> str:
    low, high = result.model.ci95_s
    if row.time_constant_stderr_s == 0.0:
        return "held"
    if not (math.isfinite(low) and math.isfinite(high)):
        return NOT_KNOWN
    if not row.time_constant_stderr_s < row.time_constant_s:
        # The lower end of so wide an interval says nothing: the bound from above does.
        bound_s = row.time_constant_s + ONE_SIDED_95 * row.time_constant_stderr_s
        return f"< {significant(1e3 * bound_s, 2)}"
    error = 1e3 * row.time_constant_stderr_s
    return f"{round_like(1e3 * low, error)} … {round_like(1e3 * high, error)}"


def _trust(row: ComparisonRow, _: EstimatorResult) -> str:
    return row.trust


FIELDS: tuple[TableField, ...] = (
    TableField("#", "rank by the held-out error", _rank),
    TableField("estimator", "how τ and the characteristic were estimated", _label, False),
    TableField(
        "held-out rms",
        "root mean square of measurement minus free run on the rows held out",
        _held_out,
    ),
    TableField(
        "Δ to best", "difference of that rms to the best ± paired jackknife error", _difference
    ),
    TableField("τ [ms]", "time constant ± standard error", _tau),
    TableField(
        "95 % [ms]",
        "95 % interval of τ: on log τ where τ is well told from zero, symmetric and cut at zero "
        "where it is told less well, an upper bound where it is not told from zero",
        _interval,
    ),
    TableField("trust", "what in this line should not be relied on", _trust, False),
)


RECONSTRUCTION_FIELDS: tuple[TableField, ...] = (
    TableField("record", "what the model was run on", lambda run: run.record.source, False),
    TableField(
        "model",
        "the estimator that found it",
        lambda run: estimator_label(run.model.estimator),
        False,
    ),
    TableField("of", "the coefficient", lambda run: SYMBOLS[run.model.target], False),
    TableField("rms", "of measured minus reconstructed", lambda run: significant(run.score.rms, 3)),
    TableField(
        "fit [%]",
        "100 (1 - error / spread of the measurement)",
        lambda run: f"{run.score.fit_percent:.1f}",
    ),
    TableField("rows", "rows that were scored", lambda run: str(run.score.n_rows)),
    TableField(
        "outside [%]",
        "share of the rows whose φ lies beyond where it dwelt in the fit (5th to 95th percentile)",
        lambda run: f"{100.0 * run.outside:.0f}",
    ),
)


def comparison_cells(comparison: Comparison) -> list[list[str]]:
    """Return the text of every cell, one list a row, best estimator first.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    return [
        [field.text(row, comparison.result(row.estimator)) for field in FIELDS]
        for row in comparison.table
    ]


def reconstruction_cells(runs: Sequence[Reconstruction]) -> list[list[str]]:
    """Return the text of every cell, one list a run.

    Parameters
    ----------
    runs : sequence of Reconstruction
        Models and the records they were run on.
    """
    return [[field.text(run) for field in RECONSTRUCTION_FIELDS] for run in runs]


def comparison_table(comparison: Comparison) -> str:
    """Return the comparison as an aligned table for a terminal, at most 110 columns wide.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.

    Returns
    -------
    str
        The table and below it the cautions that hold for all its lines.
    """
    cells = comparison_cells(comparison)
    lines = _aligned(FIELDS[:-1], [row[:-1] for row in cells])
    # What to trust is prose of any length: it goes below the row it belongs to, behind the name
    # that the command line knows the estimator by.
    body = [
        line
        for start, row, words in zip(lines[2:], comparison.table, cells, strict=True)
        for line in (start, *_wrapped(f"{row.estimator}: {words[-1]}", "   "))
    ]
    target = comparison.rows.target
    general = (
        ranking_caution(comparison),
        tau_caution(
            (record.history for record in comparison.records),
            target=target,
            from_whole_runs=comparison.quotable,
        ),
    )
    known = (*filter(None, general), *grouped_cautions(comparison.cautions))
    cautions = [
        line for caution in known for line in _wrapped(f"caution: {caution}", "", "         ")
    ]
    return "\n".join([*lines[:2], *body, *([""] if cautions else []), *cautions])


def reconstruction_table(runs: Sequence[Reconstruction]) -> str:
    """Return reconstructions of other records as an aligned table for a terminal.

    Parameters
    ----------
    runs : sequence of Reconstruction
        Models and the records they were run on.
    """
    lines = _aligned(RECONSTRUCTION_FIELDS, reconstruction_cells(runs))
    names = dict.fromkeys(run.model.estimator for run in runs)
    called = [
        f"{name} ({estimator_label(name)})" for name in names if estimator_label(name) != name
    ]
    # A column of names would not fit beside a long path.
    legend = _wrapped(f"names of the models: {'; '.join(called)}", "", "   ") if called else []
    return "\n".join([*lines, *([""] if legend else []), *legend])


def _aligned(fields: Sequence[TableField], cells: list[list[str]]) -> list[str]:
    rows = [[field.heading for field in fields], *cells]
    widths = [max(len(row[i]) for row in rows) for i in range(len(fields))]
    lines = [
        GAP.join(
            text.rjust(width) if field.numeric else text.ljust(width)
            for text, width, field in zip(row, widths, fields, strict=True)
        ).rstrip()
        for row in rows
    ]
    rule = "─" * (sum(widths) + len(GAP) * (len(widths) - 1))
    return [lines[0], rule, *lines[1:]]


def _wrapped(prose: str, indent: str, later: str | None = None) -> list[str]:
    return textwrap.wrap(
        prose,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent if later is None else later,
        break_on_hyphens=False,
    )
