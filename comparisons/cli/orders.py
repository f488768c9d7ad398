"""The command `sindy-surge orders`: noise model, C, input lag and degree, side by side."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from comparisons.cli.shared import (
    Commands,
    add_series,
    add_targets,
    check_files,
    read_records,
    whole,
    write_all,
)
from surge_core.files import to_strict_json
from surge_core.progress import shown_over

if TYPE_CHECKING:
    from classic_ml.orders import OrderTable

__all__ = ["ORDERS_SCHEMA", "add_parser", "orders_document", "orders_text", "run"]

ORDERS_SCHEMA = "sindy-surge/orders/1"
ROWS_SHOWN = 12


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "orders",
        help="choose noise model, order of C, input lag and degree",
        description="Fit every combination of noise model (arx, armax, output error), order of C, "
        "whole-sample lag of φ and degree of the characteristic to the rows of a series, and rank "
        "them by BIC and by the later cycles.",
    )
    add_series(parser)
    for option, metavar, highest, default in (
        ("--degrees", "N", 12, [1, 2, 3]),
        ("--lags", "K", 10_000, [0, 1, 2]),
    ):
        parser.add_argument(
            option,
            type=whole(0, highest),
            nargs="+",
            default=default,
            metavar=metavar,
            help=f"(default: {' '.join(map(str, default))})",
        )
    add_targets(parser, "json")
    parser.set_defaults(run=run)


def orders_text(table: OrderTable) -> str:
    """Return the best rows as text, the recommended one marked.

    Parameters
    ----------
    table : OrderTable
        From :func:`classic_ml.orders.select_order`.
    """
    from surge_core.rounding import round_to_error

    lines = [f"{'model':28s}{'BIC':>9s}{'AICc':>9s}{'held-out':>10s}{'τ [ms]':>14s}  white  state"]
    for row in table.rows[:ROWS_SHOWN]:
        tau = round_to_error(1e3 * row.time_constant_s, 1e3 * row.time_constant_stderr_s)
        mark = "*" if row == table.recommended else " "
        lines.append(
            f"{mark}{row.name:27s}{row.bic:9.1f}{row.aicc:9.1f}{row.held_out_rms:10.4g}{tau:>14s}"
            f"  {'yes' if row.white else 'no':5s}  {row.state}"
        )
    if len(table.rows) > ROWS_SHOWN:
        lines.append(f"and {len(table.rows) - ROWS_SHOWN} more (--json holds all)")
    lines.append(f"recommended: {table.recommended.name}: {table.reason}")
    if len(table.ties) > 1:
        lines.append("no worse within an error: " + "; ".join(row.name for row in table.ties[1:]))
    return "\n".join(lines)


def orders_document(table: OrderTable, sources: list[str]) -> dict[str, Any]:
    """Return the table as plain JSON types.

    Parameters
    ----------
    table : OrderTable
        The table.
    sources : list of str
        The records.
    """
    return {
        "schema": ORDERS_SCHEMA,
        "records": sources,
        "recommended": asdict(table.recommended),
        "reason": table.reason,
        "ties": [asdict(row) for row in table.ties],
        "rows": [asdict(row) for row in table.rows],
    }


def run(arguments: argparse.Namespace) -> None:
    """Fit every combination and rank them.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.
    """
    from classic_ml.orders import select_order
    from comparisons.harness.rows import stack_rows

    check_files(arguments.series, json=arguments.json)
    rows = stack_rows(read_records(arguments.series))
    table = select_order(
        rows.X,
        rows.measured,
        rows.labels,
        sample_period_s=rows.sample_period_s,
        input_lags=tuple(arguments.lags),
        degrees=tuple(arguments.degrees),
        progress=lambda candidates: shown_over(candidates, unit="model", words="fitting"),
    )
    sources = [str(path) for path in arguments.series]
    written = write_all(
        [("numbers", arguments.json, lambda: to_strict_json(orders_document(table, sources)))]
    )
    for line in (orders_text(table), *written):
        print(line)
