"""What `sindy-surge reduce` does beside the reduction: progress, and the part that is drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from classic_ml.readers import TestDescription
    from classic_ml.records import Record
    from classic_ml.reduction import Reduction, ReductionSettings

__all__ = ["excerpt", "read_file", "reduce_file"]

# More points than this only blacken a picture: 100 s at 1 kHz.
REPORT_ROWS = 100_000


def reduce_file(raw: Path, test_path: Path, settings: ReductionSettings) -> Reduction:
    """Reduce a raw record, and show how far it is on a terminal.

    Parameters
    ----------
    raw, test_path : path
        The record and its test.toml.
    settings : ReductionSettings
        The switches.

    Returns
    -------
    Reduction
        Without the readings of the single probes.

    Raises
    ------
    InputError
        When the record cannot be used.
    """
    from classic_ml.reduction import STEPS, reduce_record
    from comparisons.cli.progress import shown_count

    record, test = read_file(raw, test_path)
    with shown_count("reducing", unit="step", total=STEPS) as done:
        return reduce_record(record, test, settings, keep_probes=False, progress=done)


def read_file(raw: Path, test_path: Path) -> tuple[Record, TestDescription]:
    """Read a raw record, and show how far it is on a terminal.

    Parameters
    ----------
    raw, test_path : path
        As :func:`reduce_file` takes them.

    Returns
    -------
    Record
        The record.
    TestDescription
        Its test.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    from classic_ml.readers import read_raw
    from comparisons.cli.progress import shown_count

    with shown_count("reading", unit="row", total=None) as read:
        return read_raw(raw, test_path, progress=read)


def excerpt(reduction: Reduction) -> tuple[Reduction, str]:
    """Return what of a long record is drawn: the beginning of its window, and before.

    Parameters
    ----------
    reduction : Reduction
        A reduced record.

    Returns
    -------
    Reduction
        The same of at most ``REPORT_ROWS`` rows; its ledger and its window are those of the whole.
    str
        Which part of the record it is, empty for the whole.
    """
    record, series = reduction.record, reduction.series
    if record.n_samples <= REPORT_ROWS:
        return reduction, ""
    window = record.rows_between(*reduction.window_s)
    start = min(max(0, window.start - REPORT_ROWS // 4), record.n_samples - REPORT_ROWS)
    rows = slice(start, start + REPORT_ROWS)
    part = record.part(rows)
    columns = {name: values[rows] for name, values in series.columns().items()}
    words = f"{part.start_s:.3f} to {part.time_at_s(REPORT_ROWS - 1):.3f} s of the record"
    return replace(
        reduction,
        record=part,
        series=replace(series, **columns),  # type: ignore[arg-type]
    ), words
