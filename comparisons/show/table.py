"""Tables of results for a terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace

from classic_ml.work.coefficient import WorkCharacteristic
from comparisons.harness.work_fit import is_vague, why_withheld
from comparisons.results import (
    Comparison,
    Reconstruction,
    reconstruction_grids,
    texts_of,
)
from comparisons.show.json_output import work_curve
from surge_core.display import Grid
from surge_core.rounding import bracketed, round_to_error

WIDTH = 110


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
    grid = comparison.grid()
    shown = replace(grid, header=grid.header[:-1], rows=tuple(row[:-1] for row in grid.rows))
    head, rule, *starts = _ruled(shown)
    lines = [head, rule]
    # What to trust is prose of any length: it goes below the row it belongs to, behind the name
    # that the command line knows the estimator by.
    for start, result in zip(starts, comparison.results, strict=True):
        chosen = " (recommended)" if result.name == comparison.recommended else ""
        lines += [start, *_wrapped(f"{result.name}{chosen}: {result.trust}", "   ")]
    cautions = texts_of(comparison.cautions)
    if cautions:
        lines.append("")
    for caution in cautions:
        lines += _wrapped(f"caution: {caution}", "", "         ")
    return "\n".join(lines)


def reconstruction_table(runs: Sequence[Reconstruction]) -> str:
    """Return reconstructions of other records as aligned tables for a terminal.

    Parameters
    ----------
    runs : sequence of Reconstruction
        Models and the records they were run on.
    """
    lines = [
        line for grid in reconstruction_grids(runs) for line in (grid.title, *_ruled(grid), "")
    ]
    names = {run.model.estimator: run.label for run in runs}
    called = [f"{name} ({label})" for name, label in names.items() if label != name]
    legend = _wrapped(f"names of the models: {'; '.join(called)}", "", "   ") if called else []
    return "\n".join([*lines[: None if legend else -1], *legend])


def work_table(fit: WorkCharacteristic) -> str:
    """Return the fit as text."""
    low, high = fit.valid_phi
    if not math.isfinite(fit.time_constant_s):
        return (
            f"ψ_QS is not stated, nor τ ({fit.n_cycles} cycles, {fit.n_scored} rows): "
            f"{why_withheld(fit)}\n{fit.entry.did}"
        )
    lines = [
        f"work characteristic ψ_QS from {fit.n_scored} rows in {fit.n_cycles} cycles, φ "
        f"{low:.3f} to {high:.3f}, pieces meeting at φ "
        + " and ".join(f"{point:.3g}" for point in fit.breakpoints),
        "τ = "
        + bracketed(1e3 * fit.time_constant_s, 1e3 * fit.time_constant_stderr_s)
        + f" ms; {fit.fit_state.advice}",
        "    φ    ψ_QS",
    ]
    inside = [(p, v, s) for p, v, s in zip(*work_curve(fit), strict=True) if low <= p <= high]
    lines += [f"{p:.3f}   {round_to_error(v, s)}" for p, v, s in inside]
    lines.append(fit.entry.did)
    if is_vague(fit):
        lines.append("τ or the curve is known to no better than 12 %: `run` does not state it")
    return "\n".join(lines)


def _ruled(grid: Grid) -> list[str]:
    """Return the lines of a table with a rule below its head."""
    head, *rows = grid.lines()
    return [head, "─" * max(map(len, (head, *rows))), *rows]


def _wrapped(prose: str, indent: str, later: str | None = None) -> list[str]:
    return textwrap.wrap(
        prose,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent if later is None else later,
        break_on_hyphens=False,
    )
