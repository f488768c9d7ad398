"""The command `sindy-surge reduce`: raw counts to φ, ψ' and ψ."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from classic_ml.io import read_raw
from classic_ml.io.series import write_series
from classic_ml.records import ledger_lines
from classic_ml.reduction import STEPS, Reduction, reduce_record
from classic_ml.reduction_settings import ReductionSettings
from comparisons.cli.commands_records import REPORT_ROWS
from comparisons.cli.options import REDUCTION
from comparisons.cli.output import page, write_asked
from comparisons.show.report import ReportSection, report_pages
from surge_core.errors import InputError
from surge_core.progress import shown_count

# What only a filter has.
FILTER = ("cutoff_hz", "filter_order")


def run(given: argparse.Namespace) -> Iterable[str]:
    """Reduce a raw record to its series."""
    with options_named():
        settings = reduction_settings(given)
        reduction = _reduced(given.raw, given.test, settings, _part(given))
    write_series(reduction.series, given.out)
    written = write_asked(given, report=lambda: _page(reduction))
    return *ledger_lines(reduction.record.history), f"series: {given.out}", *written


def _part(given: argparse.Namespace) -> tuple[float, float] | None:
    """Return the part of the file that is to be read; None for all of it."""
    if given.from_s is None and given.to_s is None:
        return None
    from_s = -math.inf if given.from_s is None else given.from_s
    to_s = math.inf if given.to_s is None else given.to_s
    if not from_s < to_s:
        raise InputError("--to-s", expected=f"a time after {from_s:g} s", found=f"{to_s:g}")
    return from_s, to_s


def _reduced(
    raw: Path, test: Path, settings: ReductionSettings, window: tuple[float, float] | None
) -> Reduction:
    """Read a raw record, or a window of it in seconds of its clock, and reduce it."""
    with shown_count("reading", unit="row") as read:
        *records, description = read_raw(raw, test, window=window, progress=read)
    with shown_count("reducing", unit="step", total=STEPS) as done:
        # Popped, so that the readings go as soon as they are calibrated.
        return reduce_record(records.pop(), description, settings, keep_probes=False, progress=done)


def _page(reduction: Reduction) -> str:
    drawn, part = _excerpt(reduction)
    name = reduction.test.name
    section = ReportSection(title=f"{name}{part}", reduction=drawn)
    return page(f"Reduction of {name}", report_pages([section]))


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


def reduction_settings(given: argparse.Namespace) -> ReductionSettings:
    """Take over what was given; the rest keeps the defaults of the reduction.

    An error names the field of the settings: :func:`options_named` makes the option of it.
    """
    fields = {each.name: getattr(given, each.name) for each in REDUCTION}
    for each in REDUCTION:
        stated = fields[each.name]
        if given.phase == "none" and each.name in FILTER and stated is not None:
            raise InputError(
                each.flags[0],
                expected="none beside --phase none, which filters nothing",
                found=f"{stated:g}",
            )
    if given.window_s is not None:
        fields["window_s"] = tuple(given.window_s)
    return ReductionSettings(**{name: value for name, value in fields.items() if value is not None})


@contextmanager
def options_named() -> Iterator[None]:
    """Name the option in an error: a user of the command line does not know the field behind it."""
    try:
        yield
    except InputError as error:
        # A key of test.toml that has the name of a setting is no option.
        table, _, field = error.where.rpartition(": ")[2].rpartition(".")
        options = {each.name: each.flags[0] for each in REDUCTION}
        if field not in options or table not in ("", "ReductionSettings"):
            raise
        raise InputError(
            options[field], expected=error.expected, found=error.found, remedy=error.remedy
        ) from None
