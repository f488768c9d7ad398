"""Tables of comparisons and reconstructions: one list of fields each, for every renderer."""

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
    "LEAST",
    "RECONSTRUCTION_FIELDS",
    "TableField",
    "comparison_cells",
    "comparison_table",
    "recommended",
    "reconstruction_cells",
    "reconstruction_table",
    "rows_to_show",
]

WIDTH = 110
GAP = "  "
ONE_SIDED_95 = 1.645
# What stands in place of a difference to itself.
LEAST = "least"
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
    return LEAST if row.rank == 1 else round_to_error(row.difference, row.paired_error)


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


FIELDS: tuple[TableField, ...] = (
    TableField(
        "estimator",
        "how τ and the characteristic were estimated",
        lambda row, _: row.label,
        numeric=False,
    ),
    TableField("τ [ms]", "time constant ± standard error", _tau),
    TableField(
        "95 % [ms]",
        "95 % interval of τ: on log τ where τ is well above zero, symmetric and cut at zero where "
        "it is less so, an upper bound where it is not distinguished from zero",
        _interval,
    ),
    TableField(
        "held-out rms",
        "root mean square of measurement minus free run on the rows held out",
        _held_out,
    ),
    TableField(
        "Δ to least", "difference of that rms to the least ± paired jackknife error", _difference
    ),
    TableField(
        "trust",
        "what in this line should not be relied on",
        lambda row, _: row.trust,
        numeric=False,
    ),
)

RECONSTRUCTION_FIELDS: tuple[TableField, ...] = (
    TableField("record", "what the model was run on", lambda run: run.record.source, numeric=False),
    TableField(
        "model",
        "the estimator that found it",
        lambda run: estimator_label(run.model.estimator),
        numeric=False,
    ),
    TableField("of", "the coefficient", lambda run: SYMBOLS[run.model.target], numeric=False),
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


def recommended(comparison: Comparison) -> str | None:
    """Return the estimator whose τ is to be quoted, None where there is none.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    return next(iter(comparison.quotable), None)


def rows_to_show(comparison: Comparison) -> list[ComparisonRow]:
    """Return the rows of a comparison, the recommended one first, then by held-out error.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    first = recommended(comparison)
    return sorted(comparison.table, key=lambda row: row.estimator != first)


def comparison_cells(comparison: Comparison) -> list[list[str]]:
    """Return the text of every cell, one list a row, the recommended estimator first.

    Parameters
    ----------
    comparison : Comparison
        Estimators side by side.
    """
    return [
        [field.text(row, comparison.result(row.estimator)) for field in FIELDS]
        for row in rows_to_show(comparison)
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
    head, rule, *starts = _aligned(FIELDS[:-1], [row[:-1] for row in cells])
    lines = [head, rule]
    # What to trust is prose of any length: it goes below the row it belongs to, behind the name
    # that the command line knows the estimator by.
    for start, row in zip(starts, rows_to_show(comparison), strict=True):
        quoted = " (recommended: its τ is the one to quote)"
        chosen = quoted if row.estimator == recommended(comparison) else ""
        lines += [start, *_wrapped(f"{row.estimator}{chosen}: {row.trust}", "   ")]
    general = (
        ranking_caution(comparison),
        tau_caution(
            (record.history for record in comparison.records),
            target=comparison.rows.target,
            from_whole_runs=comparison.quotable,
        ),
    )
    cautions = [*filter(None, general), *grouped_cautions(comparison.cautions)]
    if cautions:
        lines.append("")
    for caution in cautions:
        lines += _wrapped(f"caution: {caution}", "", "         ")
    return "\n".join(lines)


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
