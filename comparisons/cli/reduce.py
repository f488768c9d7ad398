"""What `sindy-surge reduce` does beside the reduction: room on the disk, progress, long records."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from classic_ml.columns.workspace import IN_MEMORY, OnDisk, Workspace
from surge_core.errors import InputError

if TYPE_CHECKING:
    from classic_ml.readers import TestDescription
    from classic_ml.records import Record
    from classic_ml.reduction import Reduction, ReductionSettings

__all__ = ["excerpt", "read_file", "reduce_file"]

# A number takes so many bytes.
NUMBER_BYTES = 8
# In memory a reduction holds, at its widest, so many columns a channel: as matched, filtered,
# marked for faults, and its share of the averages (68 columns were measured for 20 channels).
COLUMNS_A_CHANNEL = 4
# On disk it holds the channels with a byte a row for their faults, and so many columns beside them:
# of 20 channels 445 bytes a row were measured where none is of codes and the lag of the
# thermocouples is undone, 130 as a rule.
COLUMNS_BESIDE = 34
# A row of a series: 12 columns, at most 25 characters each as text.
SERIES_BYTES = 300
# What a reduction takes in memory up to this stays there; beyond it the system clears pages for
# longer than files would take.
IN_MEMORY_BYTES = 256 << 20
# Lines at the head of a table of text from which the number of all is estimated.
HEAD_BYTES = 1 << 16
# More points than this only blacken a picture: 100 s at 1 kHz.
REPORT_ROWS = 100_000


def reduce_file(
    raw: Path,
    test_path: Path,
    settings: ReductionSettings,
    *,
    chunk_rows: int | None,
    out: Path,
    for_report: bool,
) -> Reduction:
    """Reduce a raw record, in memory or chunk by chunk, and show how far it is on a terminal.

    Parameters
    ----------
    raw, test_path : path
        The record and its test.toml.
    settings : ReductionSettings
        The switches.
    chunk_rows : int, optional
        Rows that are read at once, with the columns on disk; without it in memory, unless the
        record is long and there is room on the disk. No number depends on it.
    out : path
        Where the series is to go: the columns lie in its folder, or in ``TMPDIR`` where that is
        set.
    for_report : bool
        Whether more than the series will be looked at.

    Returns
    -------
    Reduction
        Without the readings of the single probes; its record has the averages for a report, else
        the channels of the series alone.

    Raises
    ------
    InputError
        When the record cannot be used, or there is too little room on the disk.
    """
    from classic_ml.reduction import STEPS, reduce_record
    from comparisons.cli.progress import shown_count

    records, test = read_file(raw, test_path, chunk_rows=chunk_rows, out=out)
    with shown_count("reducing", unit="step", total=STEPS) as done:
        # Nobody but the reduction holds the raw record, so that it can let go of it.
        return reduce_record(
            records.pop(),
            test,
            settings,
            keep="averages" if for_report else "series",
            progress=done,
        )


def read_file(
    raw: Path, test_path: Path, *, chunk_rows: int | None, out: Path
) -> tuple[list[Record], TestDescription]:
    """Read a raw record, in memory or chunk by chunk, and show how far it is on a terminal.

    Parameters
    ----------
    raw, test_path : path
        The record and its test.toml.
    chunk_rows : int, optional
        As :func:`reduce_file` takes it.
    out : path
        As there.

    Returns
    -------
    list of Record
        The record alone, to be taken out by whoever works on it.
    TestDescription
        Its test.

    Raises
    ------
    InputError
        When it cannot be read, or there is too little room on the disk for its reduction.
    """
    from classic_ml.readers import read_raw, read_test_description
    from classic_ml.readers.raw_files import open_raw
    from comparisons.cli.progress import shown_count

    test = read_test_description(test_path)
    stored = open_raw(raw, test)
    n_rows = stored.n_rows if stored.n_rows is not None else _rows_of_text(raw)
    workspace: Workspace = IN_MEMORY
    if chunk_rows is not None or _column_bytes(n_rows, test) > IN_MEMORY_BYTES:
        folder = Path(os.environ.get("TMPDIR") or out.resolve().parent)
        short = _lack_of_room(n_rows, test, folder, out.resolve().parent)
        if short is not None and chunk_rows is not None:
            raise short
        workspace = IN_MEMORY if short is not None else OnDisk(folder)
    with shown_count("reading", unit="row", total=n_rows) as read:
        records = [
            read_raw(raw, test, chunk_rows=chunk_rows, workspace=workspace, progress=read)[0]
        ]
    return records, test


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
    from classic_ml.records import Channel

    record, series = reduction.record, reduction.series
    if record.n_samples <= REPORT_ROWS:
        return reduction, ""
    window = record.rows_between(*reduction.window_s)
    start = min(max(0, window.start - REPORT_ROWS // 4), record.n_samples - REPORT_ROWS)
    rows = slice(start, start + REPORT_ROWS)
    channels = {n: Channel(n, c.values[rows], c.unit) for n, c in record.channels.items()}
    part = replace(record, channels=channels, start_s=record.time_at_s(start))
    columns = {name: values[rows] for name, values in series.columns().items()}
    words = f"{part.start_s:.3f} to {part.time_at_s(REPORT_ROWS - 1):.3f} s of the record"
    return replace(
        reduction,
        record=part,
        series=replace(series, **columns),  # type: ignore[arg-type]
    ), words


def _rows_of_text(raw: Path) -> int:
    """Estimate how many rows a table of text has."""
    with raw.open("rb") as file:
        head = file.read(HEAD_BYTES)
    lines = max(head.count(b"\n"), head.count(b"\r"), 1)
    return int(raw.stat().st_size * lines / max(len(head), 1))


def _column_bytes(n_rows: int, test: TestDescription) -> int:
    """Return what the columns of a reduction take in memory at their widest."""
    return n_rows * len(test.channel_names) * COLUMNS_A_CHANNEL * NUMBER_BYTES


def _lack_of_room(n_rows: int, test: TestDescription, work: Path, out: Path) -> InputError | None:
    """Tell, before any work is done, of a disk that would be full before the end."""
    row = len(test.channel_names) * (NUMBER_BYTES + 1) + COLUMNS_BESIDE * NUMBER_BYTES
    wanted = {work: n_rows * row}
    same = work.stat().st_dev == out.stat().st_dev
    place = work if same else out
    wanted[place] = wanted.get(place, 0) + n_rows * SERIES_BYTES
    for folder, size in wanted.items():
        free = shutil.disk_usage(folder).free
        if free < size:
            return InputError(
                str(folder),
                expected=f"room for {size / 1e9:.2g} GB of columns between the steps",
                found=f"{free / 1e9:.2g} GB",
                remedy="free some, or let TMPDIR name a folder on another disk",
            )
    return None
