"""The command `sindy-surge orders`: noise model, C, input lag and degree, side by side."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from classic_ml.orders import OrderTable

__all__ = ["ORDERS_SCHEMA", "add_orders_parser", "orders_document", "orders_text"]

ORDERS_SCHEMA = "sindy-surge/orders/1"
ROWS_SHOWN = 12


def add_orders_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the sub-command.

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
    parser.add_argument("series", type=Path, nargs="+", metavar="SERIES", help="series files")
    parser.add_argument(
        "--degrees", type=int, nargs="+", default=[1, 2, 3], metavar="N", help="(default: 1 2 3)"
    )
    parser.add_argument(
        "--lags", type=int, nargs="+", default=[0, 1, 2], metavar="K", help="(default: 0 1 2)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all rows as JSON")
    parser.set_defaults(run=_run)


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


def _run(arguments: argparse.Namespace) -> None:
    from classic_ml.orders import select_order
    from classic_ml.readers.series_files import read_series
    from comparisons.harness.rows import check_once, stack_rows
    from comparisons.show.json_output import to_strict_json
    from surge_core.files import check_apart, check_target, write_whole

    if arguments.json:
        check_target(arguments.json, ())
        check_apart(arguments.series, [arguments.json])
    from comparisons.cli.progress import shown_over

    records = [read_series(path) for path in arguments.series]
    check_once(records)
    rows = stack_rows(records)
    table = select_order(
        rows.X,
        rows.measured,
        rows.labels,
        sample_period_s=rows.sample_period_s,
        input_lags=tuple(arguments.lags),
        degrees=tuple(arguments.degrees),
        progress=lambda candidates: shown_over(candidates, unit="model"),
    )
    print(orders_text(table))
    if arguments.json:
        document = orders_document(table, [str(path) for path in arguments.series])
        write_whole(arguments.json, to_strict_json(document))
        print(f"numbers: {arguments.json}")
