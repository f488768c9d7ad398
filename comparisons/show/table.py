"""Tables of results for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from comparisons.results import (
    FIELDS,
    RECONSTRUCTION_FIELDS,
    Comparison,
    Reconstruction,
    TableField,
    comparison_cells,
    estimator_label,
    reconstruction_cells,
    texts_of,
)

__all__ = ["comparison_table", "reconstruction_table"]

WIDTH = 110
GAP = "  "


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
    for start, row in zip(starts, comparison.table, strict=True):
        chosen = " (recommended)" if row.estimator == comparison.recommended else ""
        lines += [start, *_wrapped(f"{row.estimator}{chosen}: {row.trust}", "   ")]
    cautions = texts_of(comparison.cautions)
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
