"""Readers: one module a file format, all of them giving the same Record."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from classic_ml.clock import CLOCK_TOLERANCE, uniform_period_s
from classic_ml.readers.raw_files import open_raw
from classic_ml.readers.raw_table import MINIMUM_ROWS, TIME_COLUMN, Columns, RawFile
from classic_ml.readers.test_description import TestDescription
from classic_ml.readers.test_toml import read_test_description
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["TestDescription", "possible_ranges", "read_raw", "read_test_description"]

# Rows that are read and checked at once.
CHUNK_ROWS = 65_536
# A crystal clock keeps 1e-4; a record at another rate is off by far more.
RATE_TOLERANCE = 1e-3
# Beyond these no gas of a compressor is, nor a thermocouple that measures it.
POSSIBLE_K = (50.0, 3000.0)


def read_raw(
    raw_path: str | os.PathLike[str],
    test: str | os.PathLike[str] | TestDescription,
    *,
    progress: Callable[[int], object] | None = None,
) -> tuple[Record, TestDescription]:
    """Read a raw record and the description of its test, and check one against the other.

    Parameters
    ----------
    raw_path : str or path
        Table of ``time_s`` and one column a channel, as test.toml describes it.
    test : str or path or TestDescription
        Its test.toml, read or not.
    progress : callable, optional
        Called with the rows of each chunk when they have been read.

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
    if not isinstance(test, TestDescription):
        test = read_test_description(test)
    stored = open_raw(raw_path, test)
    chunks: list[Columns] = []
    n_rows = 0
    possible = possible_ranges(test, stored.names)
    for values in stored.columns(CHUNK_ROWS):
        _check_readings(values, n_rows, stored, test, possible)
        chunks.append(tuple(np.asarray(column, dtype=np.float64) for column in values))
        n_rows += values[0].size
        if progress is not None:
            progress(values[0].size)
    if n_rows < MINIMUM_ROWS:
        raise InputError(stored.source, expected=f"at least {MINIMUM_ROWS} rows", found=f"{n_rows}")
    whole = [np.concatenate(parts) for parts in zip(*chunks, strict=True)]
    return _record(dict(zip(stored.names, whole, strict=True)), stored, test), test


def _record(columns: dict[str, FloatArray], stored: RawFile, test: TestDescription) -> Record:
    time_s = columns.pop(TIME_COLUMN)
    rate_hz = _check_clock(time_s, stored.source, test)
    entry = LedgerEntry(
        "read",
        f"{time_s.size} rows of {len(test.channel_names)} channels, "
        f"{time_s[0]:.3f} to {time_s[-1]:.3f} s at {rate_hz:g} Hz"
        + (f"; the clock is {stored.clock}" if stored.clock else ""),
        {"raw": stored.source, "test": test.source, "rows": int(time_s.size)},
    )
    channels = [Channel.adopt(c.name, columns.pop(c.name), c.record_unit) for c in test.pressures]
    channels += [Channel.adopt(c.name, columns.pop(c.name), "K") for c in test.temperatures]
    by_name = {channel.name: channel for channel in channels}
    return Record(by_name, rate_hz, float(time_s[0]), stored.source, (entry,))


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
            remedy=_other_clock(period_s * rate_hz, rate_hz),
        )
    return rate_hz


def _other_clock(periods: float, rate_hz: float) -> str:
    """Return how to mend a clock that runs so many sample periods from row to row."""
    for factor, unit in ((1e3, "ms"), (1e6, "us"), (1e9, "ns")):
        if abs(periods / factor - 1.0) < RATE_TOLERANCE:
            return f'is it in {unit}? then write time_unit = "{unit}" in [file]'
    return f"if the clock is right, write sample_rate_hz = {rate_hz / periods:g}"


def possible_ranges(test: TestDescription, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the least and the greatest reading that each column of a record can have.

    Parameters
    ----------
    test : TestDescription
        The test.
    names : tuple of str
        Columns: channels of the test, or others, of which anything finite is possible.

    Returns
    -------
    ndarray of shape (n_columns,)
        The least: 0 for counts, the first number above 0 for Pa, K for temperatures, minus
        infinity for others.
    ndarray of shape (n_columns,)
        The greatest: the top code of the converter, K, infinity.
    """
    lowest, highest = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    pascals = np.isin(names, [c.name for c in test.pressures if c.record_unit == "Pa"])
    # Absolute ones: what a gauge or a differential reading is taken against is in them.
    lowest[pascals] = np.nextafter(0.0, 1.0)
    codes = np.isin(names, [c.name for c in test.pressures if c.record_unit == "count"])
    if codes.any():
        lowest[codes], highest[codes] = 0.0, test.adc.top_code
    couples = np.isin(names, [c.name for c in test.temperatures])
    lowest[couples], highest[couples] = POSSIBLE_K
    return lowest, highest


def _check_readings(
    columns: Columns,
    n_before: int,
    stored: RawFile,
    test: TestDescription,
    possible: tuple[FloatArray, FloatArray],
) -> None:
    """Refuse codes that the converter does not have, and what no gas or thermocouple has."""
    impossible = [
        (int(np.argmax((values < low) | (values > high))), number)
        for number, (values, low, high) in enumerate(zip(columns, *possible, strict=True))
        if values.size and not (low <= values.min() and values.max() <= high)
    ]
    if not impossible:
        return
    row, number = min(impossible)
    expected, unit, remedy = _what_is_possible(stored.names[number], test)
    raise InputError(
        f"{stored.source}: channel {stored.names[number]}",
        expected=expected,
        found=f"{columns[number][row]:g}{unit} in row {n_before + row + 1}",
        remedy=remedy,
    )


def _what_is_possible(name: str, test: TestDescription) -> tuple[str, str, str]:
    """Return what is expected of a channel, the unit of what was found, and what to look at."""
    remedy = "check the unit of the column"
    probe = next((probe for probe in test.pressures if probe.name == name), None)
    if probe is None:
        low_K, high_K = POSSIBLE_K
        return f"absolute temperatures in K, {low_K:g} to {high_K:g}", "", remedy
    if probe.record_unit != "Pa":
        codes = f"counts of a {test.adc.bits}-bit converter (0 to {test.adc.top_code})"
        return codes, "", remedy
    against = f"and reference_Pa in [channels.{name}] of {test.source}, "
    against += "which is added to it" if probe.reference_Pa else "which a gauge reading needs"
    remedy += f" {against}; leave out a probe that drops out, with its mate"
    return "absolute pressures above 0 Pa", " Pa", remedy
