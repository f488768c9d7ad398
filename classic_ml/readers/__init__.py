"""Readers: one module a file format, all of them giving the same Record."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from classic_ml.clock import CLOCK_TOLERANCE, uniform_period_s
from classic_ml.errors import InputError
from classic_ml.readers.raw_csv import read_raw_csv
from classic_ml.readers.raw_table import TIME_COLUMN, ColumnCheck, RawTable
from classic_ml.readers.test_description import TestDescription
from classic_ml.readers.test_toml import read_test_description
from classic_ml.records import Channel, FloatArray, LedgerEntry, Record

__all__ = ["RAW_READERS", "TestDescription", "read_raw", "read_test_description"]

# A further format is one more reader of this signature.
RAW_READERS: dict[str, Callable[[Path, ColumnCheck], RawTable]] = {".csv": read_raw_csv}
# A crystal clock keeps 1e-4; a record at another rate is off by far more.
RATE_TOLERANCE = 1e-3


def read_raw(
    raw_path: str | os.PathLike[str], test_path: str | os.PathLike[str]
) -> tuple[Record, TestDescription]:
    """Read a raw record and the description of its test, and check one against the other.

    Parameters
    ----------
    raw_path : str or path
        Table of ``time_s`` and one column a channel: counts for pressures, K for temperatures.
    test_path : str or path
        Its test.toml.

    Returns
    -------
    Record
        The channels as they were recorded: ``"count"`` for pressures, ``"K"`` for temperatures.
    TestDescription
        The description of the test.

    Raises
    ------
    InputError
        Naming the file, the channel and the row at fault.
    """
    test = read_test_description(test_path)
    file = Path(raw_path)
    if not file.is_file():
        raise InputError(
            str(file),
            expected="a raw record",
            found="a folder" if file.is_dir() else "no such file",
        )
    reader = RAW_READERS.get(file.suffix.lower())
    if reader is None:
        raise InputError(
            str(file),
            expected="a raw record ending in " + " or ".join(RAW_READERS),
            found=f"the suffix '{file.suffix}'",
        )
    return _record(reader(file, partial(_check_names, test)), test), test


def _record(table: RawTable, test: TestDescription) -> Record:
    time_s = table.column(TIME_COLUMN)
    rate_hz = _check_clock(time_s, table.source, test)
    entry = LedgerEntry(
        "read",
        f"{time_s.size} rows of {len(test.channel_names)} channels, "
        f"{time_s[0]:.3f} to {time_s[-1]:.3f} s at {rate_hz:g} Hz",
        {"raw": table.source, "test": test.source, "rows": int(time_s.size)},
    )
    channels = [Channel(c.name, table.column(c.name), "count") for c in test.pressures]
    channels += [Channel(c.name, table.column(c.name), "K") for c in test.temperatures]
    for channel in channels:
        _check_codes(channel, table.source, test)
    return Record({c.name: c for c in channels}, rate_hz, float(time_s[0]), table.source, (entry,))


def _check_names(test: TestDescription, source: str, names: tuple[str, ...]) -> None:
    known, present = set(test.channel_names), set(names) - {TIME_COLUMN}
    missing = [name for name in test.channel_names if name not in present]
    if missing:
        raise InputError(
            f"{source}: channel {missing[0]}",
            expected=f"it in the table, as {test.source} describes it",
            found="no such column" + (f" (nor {len(missing) - 1} more)" if missing[1:] else ""),
            remedy="a dead probe is left out with its mate, in both files",
        )
    extra = [name for name in names if name in present - known]
    if extra:
        raise InputError(
            f"{source}: channel {extra[0]}",
            expected=f"a table [channels.{extra[0]}] in {test.source}",
            found="none" + (f" (nor for {len(extra) - 1} more)" if extra[1:] else ""),
            remedy="describe the channel or leave the column out",
        )


def _check_clock(time_s: FloatArray, source: str, test: TestDescription) -> float:
    period_s = uniform_period_s(time_s, f"{source}: column {TIME_COLUMN}")
    rate_hz = test.sample_rate_hz
    # The ends of a printed clock are each rounded by up to half a digit, worth half of what
    # a step may be off at the coarsest clock that is let through.
    slack = RATE_TOLERANCE + CLOCK_TOLERANCE / (time_s.size - 1)
    if abs(period_s * rate_hz - 1.0) > slack:
        raise InputError(
            f"{source}: column {TIME_COLUMN}",
            expected=f"{rate_hz:g} samples a second, as {test.source} [test] sample_rate_hz says",
            found=f"{1.0 / period_s:g}",
        )
    return rate_hz


def _check_codes(channel: Channel, source: str, test: TestDescription) -> None:
    values = channel.values
    if channel.unit == "count":
        bad = np.flatnonzero((values < 0) | (values > test.adc.top_code))
        expected = f"counts of a {test.adc.bits}-bit converter (0 to {test.adc.top_code})"
    else:
        bad = np.flatnonzero(values <= 0.0)
        expected = "absolute temperatures in K"
    if bad.size:
        raise InputError(
            f"{source}: channel {channel.name}",
            expected=expected,
            found=f"{values[bad[0]]:g} in row {bad[0] + 1}",
            remedy="check the unit of the column",
        )
