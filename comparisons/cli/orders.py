"""The command `sindy-surge orders`: noise model, C, input lag and degree, side by side."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from classic_ml.orders import OrderTable, select_order
from comparisons.cli.output import read_records, write_asked
from comparisons.harness.cautions import tau_caution
from comparisons.harness.rows import stack_rows
from comparisons.results import Caution
from surge_core.display import Grid
from surge_core.progress import shown_over
from surge_core.rounding import round_to_error, significant

ORDERS_SCHEMA = "sindy-surge/orders/1"
HEADS = ("model", "BIC", "AICc", "held-out", "τ [ms]", "white", "state")
ROWS_SHOWN = 12
TIES_NAMED = 4
NO_TAU = (
    "no τ of this table is to be quoted, that of the best row included: the pressures were "
    "low-passed before the flow equation, which biases it. `sindy-surge compare` "
    "states the τ to quote, from one free run through the unfiltered signals."
)


def run(given: argparse.Namespace) -> Iterable[str]:
    """Fit every combination and rank them."""
    records = read_records(given.series)
    rows = stack_rows(records)
    table = select_order(
        rows.X,
        rows.measured,
        rows.labels,
        sample_period_s=rows.sample_period_s,
        input_lags=tuple(given.lags),
        degrees=tuple(given.degrees),
        progress=lambda candidates: shown_over(candidates, unit="model", words="fitting"),
    )
    sources = [str(path) for path in given.series]
    caution = tau_caution([record.history for record in records])
    written = write_asked(given, json=lambda: _document(table, sources, caution))
    return *_lines(table, biased=caution is not None), *written


def _lines(table: OrderTable, *, biased: bool) -> list[str]:
    """Return the best rows as text, the recommended one marked unless its τ is biased."""
    shown = table.rows[:ROWS_SHOWN]
    if table.recommended not in shown:
        shown = (*shown, table.recommended)
    rows = tuple(
        (
            f"{'*' if row == table.recommended and not biased else ' '}{row.name}",
            *(f"{value:.1f}" for value in (row.bic, row.aicc)),
            significant(row.held_out_rms),
            round_to_error(1e3 * row.time_constant_s, 1e3 * row.time_constant_stderr_s),
            "yes" if row.white else "no",
            row.state,
        )
        for row in shown
    )
    lines = Grid("", HEADS, rows, frozenset({0, 5, 6})).lines()
    if len(table.rows) > len(shown):
        lines.append(f"and {len(table.rows) - len(shown)} more (--json holds all)")
    lines.append(
        _best(table) if biased else f"recommended: {table.recommended.name}: {table.reason}"
    )
    if len(table.ties) > 1:
        ties = [row.name for row in table.ties[1:]]
        more = [f"{len(ties) - TIES_NAMED} more"] if len(ties) > TIES_NAMED else []
        lines.append("no worse within an error: " + "; ".join([*ties[:TIES_NAMED], *more]))
    if biased:
        lines += textwrap.wrap(NO_TAU, 100)
    return lines


def _best(table: OrderTable) -> str:
    """Name the row that predicts best where none is recommended."""
    return f"predicts these rows best: {table.recommended.name}: {table.reason}"


def _document(table: OrderTable, sources: list[str], caution: Caution | None) -> dict[str, Any]:
    return {
        "schema": ORDERS_SCHEMA,
        "records": sources,
        # No row whose τ is biased is recommended; the reason names the one that predicts best.
        "recommended": asdict(table.recommended) if caution is None else None,
        "reason": table.reason if caution is None else _best(table),
        "quotable_tau": caution is None,
        "cautions": [caution.text] if caution else [],
        "ties": [asdict(row) for row in table.ties],
        "rows": [asdict(row) for row in table.rows],
    }
