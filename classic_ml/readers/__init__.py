"""Readers: one module a file format, all of them giving the same Record."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from classic_ml.columns import workspace as places
from classic_ml.columns.clock import CLOCK_TOLERANCE, uniform_period_s
from classic_ml.columns.workspace import IN_MEMORY, GrowingColumns, Workspace
from classic_ml.errors import InputError
from classic_ml.readers.raw_files import open_raw
from classic_ml.readers.raw_table import MINIMUM_ROWS, TIME_COLUMN, RawFile
from classic_ml.readers.test_description import TestDescription
from classic_ml.readers.test_toml import read_test_description
from classic_ml.records import Channel, FloatArray, LedgerEntry, Record

__all__ = ["TestDescription", "read_raw", "read_test_description"]

# More than this is the whole of any file, and some libraries count in 32 bits.
MOST_ROWS = 2**31 - 1
# A crystal clock keeps 1e-4; a record at another rate is off by far more.
RATE_TOLERANCE = 1e-3
# Beyond these no gas of a compressor is, nor a thermocouple that measures it.
POSSIBLE_K = (50.0, 3000.0)


def read_raw(
    raw_path: str | os.PathLike[str],
    test_path: str | os.PathLike[str],
    *,
    chunk_rows: int | None = None,
    workspace: Workspace = IN_MEMORY,
    progress: Callable[[int], object] | None = None,
) -> tuple[Record, TestDescription]:
    """Read a raw record and the description of its test, and check one against the other.

    Parameters
    ----------
    raw_path : str or path
        Table of ``time_s`` and one column a channel, as test.toml describes it.
    test_path : str or path
        Its test.toml.
    chunk_rows : int, optional
        Rows that are read at once; no number depends on it.
    workspace : Workspace
        Where the columns of the record lie, and those of its reduction.
    progress : callable, optional
        Told the rows of each chunk when they have been read.

    Returns
    -------
    Record
        The channels as they were recorded: ``"count"`` or ``"Pa"`` for pressures, ``"K"`` for
        temperatures.
    TestDescription
        The description of the test.

    Raises
    ------
    InputError
        Naming the file, the channel and the row at fault.
    """
    if chunk_rows is not None and chunk_rows < 1:
        raise InputError("chunk_rows", expected="at least 1 row", found=f"{chunk_rows}")
    test = read_test_description(test_path)
    stored = open_raw(raw_path, test)
    # Room is taken for no more rows than the file can hold, whatever it claims.
    claimed = stored.n_rows if (stored.n_rows or 0) <= os.path.getsize(raw_path) else None
    columns = GrowingColumns(workspace, len(stored.names), claimed, readings=True)
    possible = _possible(stored, test)
    for values in stored.chunks(min(chunk_rows or places.BLOCK_ROWS, MOST_ROWS)):
        _check_readings(values, columns.n_rows, stored, test, possible)
        columns.append(values)
        if progress is not None:
            progress(len(values))
    if columns.n_rows < MINIMUM_ROWS:
        raise InputError(
            stored.source, expected=f"at least {MINIMUM_ROWS} rows", found=f"{columns.n_rows}"
        )
    by_name = dict(zip(stored.names, columns.finished(), strict=True))
    return _record(by_name, stored, test, workspace), test


def _record(
    columns: dict[str, FloatArray], stored: RawFile, test: TestDescription, workspace: Workspace
) -> Record:
    time_s = columns.pop(TIME_COLUMN)
    rate_hz = _check_clock(time_s, stored.source, test, workspace)
    entry = LedgerEntry(
        "read",
        f"{time_s.size} rows of {len(test.channel_names)} channels, "
        f"{time_s[0]:.3f} to {time_s[-1]:.3f} s at {rate_hz:g} Hz"
        + (f"; the clock is {stored.clock}" if stored.clock else ""),
        {"raw": stored.source, "test": test.source, "rows": int(time_s.size)},
    )
    channels = [Channel(c.name, columns.pop(c.name), c.record_unit) for c in test.pressures]
    channels += [Channel(c.name, columns.pop(c.name), "K") for c in test.temperatures]
    by_name = {channel.name: channel for channel in channels}
    return Record(by_name, rate_hz, float(time_s[0]), stored.source, (entry,), workspace)


def _check_clock(
    time_s: FloatArray, source: str, test: TestDescription, workspace: Workspace
) -> float:
    period_s = uniform_period_s(time_s, f"{source}: column {TIME_COLUMN}", workspace=workspace)
    rate_hz = test.sample_rate_hz
    # The ends of a printed clock are each rounded by up to half a digit, worth half of what
    # a step may be off at the coarsest clock that is let through.
    slack = RATE_TOLERANCE + CLOCK_TOLERANCE / (time_s.size - 1)
    if abs(period_s * rate_hz - 1.0) > slack:
        raise InputError(
            f"{source}: column {TIME_COLUMN}",
            expected=f"{rate_hz:g} samples a second, as {test.source} [test] sample_rate_hz says",
            found=f"{1.0 / period_s:g}",
            remedy=_other_clock(period_s * rate_hz),
        )
    return rate_hz


def _other_clock(periods: float) -> str:
    """Return what a clock may be that runs so many sample periods from row to row."""
    for factor, unit in ((1e3, "ms"), (1e6, "us"), (1e9, "ns")):
        if abs(periods / factor - 1.0) < RATE_TOLERANCE:
            return f'is it in {unit}? then write time_unit = "{unit}" in [file]'
    return ""


def _possible(stored: RawFile, test: TestDescription) -> tuple[FloatArray, FloatArray]:
    """Return the least and the greatest reading that each column can have."""
    names = np.array(stored.names)
    lowest, highest = np.full(names.size, -np.inf), np.full(names.size, np.inf)
    codes = np.isin(names, [c.name for c in test.pressures if c.record_unit == "count"])
    if codes.any():
        lowest[codes], highest[codes] = 0.0, test.adc.top_code
    couples = np.isin(names, [c.name for c in test.temperatures])
    lowest[couples], highest[couples] = POSSIBLE_K
    return lowest, highest


def _check_readings(
    values: FloatArray,
    n_before: int,
    stored: RawFile,
    test: TestDescription,
    possible: tuple[FloatArray, FloatArray],
) -> None:
    """Refuse codes that the converter does not have, and temperatures that nothing has."""
    lowest, highest = possible
    if not values.size or (
        np.all(values.min(axis=0) >= lowest) and np.all(values.max(axis=0) <= highest)
    ):
        return
    row, column = np.argwhere((values < lowest) | (values > highest))[0]
    low_K, high_K = POSSIBLE_K
    expected = f"absolute temperatures in K, {low_K:g} to {high_K:g}"
    if lowest[column] == 0.0:
        expected = f"counts of a {test.adc.bits}-bit converter (0 to {test.adc.top_code})"
    raise InputError(
        f"{stored.source}: channel {stored.names[column]}",
        expected=expected,
        found=f"{values[row, column]:g} in row {n_before + row + 1}",
        remedy="check the unit of the column",
    )
