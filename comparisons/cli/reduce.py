"""The command `sindy-surge reduce`: raw counts to φ, ψ' and ψ."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from comparisons.cli.reduction_options import (
    add_read_window,
    add_reduction_options,
    options_named,
    read_window,
    reduction_settings,
)
from comparisons.cli.shared import (
    Commands,
    add_raw,
    check_files,
    command_line,
    drawing,
    write_all,
)
from surge_core.files import check_target
from surge_core.progress import shown_count

if TYPE_CHECKING:
    from classic_ml.reduction import Reduction, ReductionSettings

__all__ = ["add_parser", "print_reduction", "run"]

SERIES_SUFFIXES = (".csv", ".nc", ".nc4", ".netcdf")
# More points than this only blacken a picture: 100 s at 1 kHz.
REPORT_ROWS = 100_000


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "reduce",
        help="raw counts to φ, ψ' and ψ",
        description="Reduce a raw record: counts to pressures, the airflow equations, φ, ψ', ψ "
        "and the intervals to be fitted.",
    )
    add_raw(parser)
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="SERIES", help="series (.csv or .nc)"
    )
    add_read_window(parser)
    add_reduction_options(parser)
    parser.add_argument(
        "--report",
        type=Path,
        metavar="FILE.html",
        help=f"report of the reduction; its pictures show at most {REPORT_ROWS} rows",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Reduce a raw record to a series file.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.
    """
    from classic_ml.io.series import write_series

    check_files([arguments.raw, arguments.test], report=arguments.report, out=arguments.out)
    check_target(arguments.out, SERIES_SUFFIXES)
    with options_named():
        settings, window = reduction_settings(arguments), read_window(arguments)
        reduction = _reduced(arguments.raw, arguments.test, settings, window)
    write_series(reduction.series, arguments.out)
    written = write_all([("report", arguments.report, lambda: _page(reduction))])
    print_reduction(reduction)
    for line in (f"series: {arguments.out}", *written):
        print(line)


def _reduced(
    raw: Path, test: Path, settings: ReductionSettings, window: tuple[float, float] | None
) -> Reduction:
    """Read a raw record, or a window of it in seconds of its clock, and reduce it."""
    from classic_ml.io import read_raw
    from classic_ml.reduction import STEPS, reduce_record

    with shown_count("reading", unit="row") as read:
        *records, description = read_raw(raw, test, window=window, progress=read)
    with shown_count("reducing", unit="step", total=STEPS) as done:
        # Popped, so that the readings go as soon as they are calibrated.
        return reduce_record(records.pop(), description, settings, keep_probes=False, progress=done)


def print_reduction(reduction: Reduction) -> None:
    """Print the ledger of a reduction.

    Parameters
    ----------
    reduction : Reduction
        A reduced record.
    """
    for entry in reduction.record.history:
        print(f"{entry.step}: {entry.did}")
        for dropped in entry.dropped:
            print(f"  left out {dropped.what} ({dropped.count}): {dropped.why}")
        for flag in entry.flags:
            print(f"  note: {flag}")


def _page(reduction: Reduction) -> str:
    from comparisons.show.report import ReportSection, render_report

    drawn, part = _excerpt(reduction)
    name = reduction.test.name
    return render_report(
        [ReportSection(title=f"{name}{part}", reduction=drawn)],
        title=f"Reduction of {name}",
        command=command_line(),
        progress=drawing,
    )


def _excerpt(reduction: Reduction) -> tuple[Reduction, str]:
    """Return what of a long record is drawn, the beginning of its window, and which part it is."""
    record, series = reduction.record, reduction.series
    if record.n_samples <= REPORT_ROWS:
        return reduction, ""
    window = record.rows_between(*reduction.window_s)
    start = min(max(0, window.start - REPORT_ROWS // 4), record.n_samples - REPORT_ROWS)
    rows = slice(start, start + REPORT_ROWS)
    part = record.part(rows)
    columns = {name: values[rows] for name, values in series.columns().items()}
    shown = replace(reduction, record=part, series=replace(series, **columns))  # type: ignore[arg-type]
    return shown, f", {part.start_s:.3f} to {part.time_at_s(REPORT_ROWS - 1):.3f} s of the record"
