"""A raw record of any format as a Record: channels named as in test.toml, in SI, checked."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.clock import CLOCK_TOLERANCE, uniform_period_s
from classic_ml.description import PressureChannel, TestDescription
from classic_ml.io.description_file import read_test_description
from classic_ml.io.formats import open_stored
from classic_ml.io.mapping import (
    FeedColumn,
    check_columns,
    check_units,
    feeds,
    sampled_apart,
)
from classic_ml.io.table import MINIMUM_ROWS, TIME_COLUMN, RawFile
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.units import COUNT, Conversion, kind_of_unit, states_a_unit, time_conversion
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["CLOCK_NAMES", "MOST_VALUES", "near_stall_means", "possible_ranges", "read_raw"]

# Readings that are held at once: 1.6 GB, an hour of 20 channels at 2.8 kHz. A reduction takes a
# few times as much.
MOST_VALUES = 200_000_000
# A crystal clock keeps 1e-4; a record at another rate is off by far more.
RATE_TOLERANCE = 1e-3
# Beyond these no gas of a compressor is, nor a thermocouple that measures it.
POSSIBLE_K = (50.0, 3000.0)
# What a clock is called, in small letters.
CLOCK_NAMES = (
    *(TIME_COLUMN, "time", "t", "time (s)", "time [s]", "timestamp", "times"),
    "elapsed time",
)

Window = tuple[float, float]


@dataclass(frozen=True)
class _Readings:
    """The columns of a part of a file, and the rows of the file before it."""

    by_column: dict[str, NDArray[np.generic]]
    time_s: FloatArray
    rows_before: int


class _TooLongError(Exception):
    """The record has more readings than are held at once."""


def read_raw(
    raw_path: str | os.PathLike[str],
    test: str | os.PathLike[str] | TestDescription,
    *,
    window: Window | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[Record, TestDescription]:
    """Read a raw record and the description of its test, and check one against the other.

    Parameters
    ----------
    raw_path : str or path
        Table of ``time_s`` and one column a channel, as test.toml describes it.
    test : str or path or TestDescription
        Its test.toml, read or not.
    window : tuple of float, optional
        From when to when the file is read, in s on its clock; the near-stall reading before it is
        read too, with all between, unless ``[near_stall_shifts]`` stands for it. Without it the
        whole file is read, or ``[window]`` of a file too long for that.
    progress : callable, optional
        Takes the rows of each block when they have been read.

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
        Naming the file, the channel and the row at fault, or that the file is too long to be read
        whole.
    """
    if not isinstance(test, TestDescription):
        test = read_test_description(test)
    if window is not None and not window[0] < window[1]:
        raise InputError(
            "window", expected="its start before its end", found=f"{window[0]:g} to {window[1]:g} s"
        )
    stored, columns = _opened(raw_path, test)
    try:
        read = _read(stored, test, columns, window, progress)
    except _TooLongError:
        if window is not None or test.window_s is None:
            raise _too_long(stored, test) from None
        try:
            window = test.window_s
            read = _read(stored, test, columns, window, progress)
        except _TooLongError:
            raise _too_long(stored, test) from None
    if read.time_s.size < MINIMUM_ROWS:
        raise InputError(
            stored.source,
            expected=f"at least {MINIMUM_ROWS} rows"
            + (f" from {window[0]:g} to {window[1]:g} s" if window else ""),
            found=f"{read.time_s.size}",
        )
    return _record(stored, test, columns, read, window), test


def near_stall_means(raw_path: str | os.PathLike[str], test: TestDescription) -> dict[str, float]:
    """Return the mean of each channel over the near-stall interval.

    Parameters
    ----------
    raw_path : str or path
        The record.
    test : TestDescription
        Its description.

    Returns
    -------
    dict of str to float
        Counts, Pa or K by channel; empty where the record has no such rows.

    Raises
    ------
    InputError
        When file and description do not go together.
    """
    stored, columns = _opened(raw_path, test)
    state = test.near_stall
    read = _read(stored, test, columns, (state.from_s, state.to_s), None)
    return {
        column.name: float(
            np.mean(column.conversion.to_si(read.by_column[column.column].astype(np.float64)))
        )
        for column in columns[1:]
        if read.time_s.size
    }


def _opened(
    raw_path: str | os.PathLike[str], test: TestDescription
) -> tuple[RawFile, tuple[FeedColumn, ...]]:
    """Open a file, and check that its columns are those that the test describes."""
    stored = open_stored(raw_path, test.file)
    columns = feeds(stored, test)
    check_columns(stored, test, columns)
    check_units(stored, test, columns)
    apart = sampled_apart(stored, [column.column for column in columns])
    if apart is not None:
        raise apart
    return stored, columns


def _read(
    stored: RawFile,
    test: TestDescription,
    columns: tuple[FeedColumn, ...],
    window: Window | None,
    progress: Callable[[int], object] | None,
) -> _Readings:
    """Read the rows of a window, or all."""
    watched = _passed_over(stored, {column.column for column in columns}, test)
    names = tuple(dict.fromkeys((*(c.column for c in columns if c.column), *watched)))
    low_s, high_s = _span(test, window)
    kept: list[tuple[NDArray[np.generic], ...]] = []
    clocks: list[FloatArray] = []
    first_s: float | None = None
    rows, rows_before, n_kept = 0, 0, 0
    for block in stored.blocks(names):
        n_rows = block[0].size
        if columns[0].column:
            clock = columns[0].conversion.to_si(np.asarray(block[0], dtype=np.float64))
            first_s = float(clock[0]) if first_s is None and n_rows else first_s
            if test.file.start_s is not None and first_s is not None:
                clock = clock + (test.file.start_s - first_s)
        else:
            made_s = np.arange(rows, rows + n_rows) / test.sample_rate_hz
            clock = (test.file.start_s or 0.0) + made_s
        rows += n_rows
        if progress is not None:
            progress(n_rows)
        inside = np.flatnonzero((clock >= low_s) & (clock <= high_s)) if window else np.arange(1)
        if window and not inside.size:
            rows_before = rows_before if kept else rows
            if kept or (n_rows and clock[-1] > high_s):
                break
            continue
        part = slice(inside[0], inside[-1] + 1) if window else slice(None)
        rows_before += int(inside[0]) if not kept else 0
        kept.append(tuple(column[part] for column in block))
        clocks.append(clock[part])
        n_kept += clocks[-1].size
        if n_kept * len(names) > MOST_VALUES:
            raise _TooLongError
    joined: dict[str, NDArray[np.generic]] = {}
    for number, name in enumerate(names):
        joined[name] = np.concatenate([block[number] for block in kept]) if kept else np.empty(0)
    time_s = np.concatenate(clocks) if clocks else np.empty(0)
    for name in watched:
        _check_passed_over(stored, test, name, np.asarray(joined[name], dtype=np.float64))
    return _Readings(joined, time_s, rows_before)


def _span(test: TestDescription, window: Window | None) -> Window:
    """Return from when to when is read, in s: the near-stall reading with it, where it is asked."""
    if window is None:
        return -np.inf, np.inf
    half_s = 0.5 / test.sample_rate_hz
    near = () if test.near_stall_shifts else (test.near_stall.from_s, test.near_stall.to_s)
    return min((window[0], *near[:1])) - half_s, max((window[1], *near[1:])) + half_s


def _too_long(stored: RawFile, test: TestDescription) -> InputError:
    channels = len(test.channel_names) + 1
    return InputError(
        stored.source,
        expected=f"at most {MOST_VALUES // channels} rows of {channels} columns at once",
        found="more",
        remedy=f"`sindy-surge inspect` finds where it surges: name that as [window] in "
        f"{test.source} or with --from-s and --to-s, and where the near-stall reading is far "
        "before it, its [near_stall_shifts]",
    )


def _record(
    stored: RawFile,
    test: TestDescription,
    columns: tuple[FeedColumn, ...],
    read: _Readings,
    window: Window | None,
) -> Record:
    clock, *fed = columns
    time_s = _finite(stored, clock, read.time_s, read.rows_before)
    part = ""
    if window is not None:
        if window[1] < time_s[0] or window[0] > time_s[-1]:
            raise InputError(
                stored.source,
                expected=f"rows from {window[0]:g} to {window[1]:g} s of its clock, as was asked",
                found=f"only rows from {time_s[0]:.3f} to {time_s[-1]:.3f} s",
            )
        part = ", a part of the file"
        if time_s[0] < window[0] - 1.0 / test.sample_rate_hz:
            part += f" (from {window[0]:g} s on was asked; the near-stall reading is before it)"
    rate_hz = _check_clock(time_s, stored.source, test)
    lowest, highest = possible_ranges(test, tuple(column.name for column in fed))
    channels: dict[str, Channel] = {}
    for column, low, high in zip(fed, lowest, highest, strict=True):
        values = column.conversion.to_si(
            np.asarray(read.by_column.pop(column.column), dtype=np.float64)
        )
        # What is no number is in no range.
        if not (low <= values.min() and values.max() <= high and np.isfinite(values.max())):
            _finite(stored, column, values, read.rows_before)
            _check_possible(stored, test, column, values, (low, high), read.rows_before)
        channels[column.name] = Channel.adopt(column.name, values, column.record_unit)
    made = f"from the sample rate, {rate_hz:g} Hz" if not clock.column else stored.clock
    entry = LedgerEntry(
        "read",
        f"{time_s.size} rows of {len(test.channel_names)} channels, "
        f"{time_s[0]:.3f} to {time_s[-1]:.3f} s at {rate_hz:g} Hz"
        + part
        + (f"; the clock is {made}" if made else ""),
        {"raw": stored.source, "test": test.source, "rows": int(time_s.size)},
    )
    return Record(channels, rate_hz, float(time_s[0]), stored.source, (entry,))


def _finite(
    stored: RawFile, column: FeedColumn, values: FloatArray, rows_before: int
) -> FloatArray:
    finite = np.isfinite(values)
    if not finite.all():
        row = int(np.argmin(finite))
        raise InputError(
            f"{stored.source}: {column.title}",
            expected="a finite number in every row",
            found=f"'{values[row]}' in row {rows_before + row + 1}",
            remedy="cut the record there or repair the channel",
        )
    return values


def _check_clock(time_s: FloatArray, source: str, test: TestDescription) -> float:
    period_s = uniform_period_s(time_s, f"{source}: column {TIME_COLUMN}")
    rate_hz = test.sample_rate_hz
    # The ends of a printed clock are each rounded by up to half a digit, worth half of what
    # a step may be off at the coarsest clock that is let through.
    slack = RATE_TOLERANCE + CLOCK_TOLERANCE / (time_s.size - 1)
    if abs(period_s * rate_hz - 1.0) > slack:
        periods = period_s * rate_hz
        remedy = f"if the clock is right, write sample_rate_hz = {rate_hz / periods:g}"
        for factor, unit in ((1e3, "ms"), (1e6, "us"), (1e9, "ns")):
            if abs(periods / factor - 1.0) < RATE_TOLERANCE:
                remedy = f'is it in {unit}? then write time_unit = "{unit}" in [file]'
        raise InputError(
            f"{source}: column {TIME_COLUMN}",
            expected=f"{rate_hz:g} samples a second, as {test.source} [test] sample_rate_hz says",
            found=f"{1.0 / period_s:g}",
            remedy=remedy,
        )
    return rate_hz


def _passed_over(stored: RawFile, fed: set[str], test: TestDescription) -> tuple[str, ...]:
    """Return the clock that the file has where the time is made from the rate instead."""
    if test.file.clock != "from rate":
        return ()
    spare = {name.strip().lower(): name for name in stored.names if name not in fed}
    known = [*(n for n in stored.stamps if n not in fed), *(spare.get(n) for n in CLOCK_NAMES)]
    return tuple(name for name in known if name is not None)[:1]


def _check_passed_over(
    stored: RawFile, test: TestDescription, name: str, values: FloatArray
) -> None:
    """Refuse a file whose own clock is even and contradicts the one that is made."""
    stated = stored.units.get(name, "")
    timed = states_a_unit(stated) and kind_of_unit(stated) == "time"
    steps = np.diff((time_conversion(stated, name) if timed else Conversion()).to_si(values))
    usual = float(np.median(steps)) if steps.size else np.nan
    even = np.abs(steps - usual) <= 0.1 * usual
    # A column that only is called like a clock has no even steps; one that steps by 1 counts rows.
    if not usual > 0.0 or np.mean(even) < 0.99 or usual == 1.0:
        return
    gap = float(steps.max())
    ratio = float(np.mean(steps[even])) * test.sample_rate_hz
    # A clock without a unit may be in ms, us or ns.
    units = (1.0,) if timed else (1.0, 1e3, 1e6, 1e9)
    agreed = any(abs(ratio / unit - 1.0) <= RATE_TOLERANCE for unit in units)
    if agreed and gap <= 1.5 * usual:
        return
    raise InputError(
        f"{stored.source}: column {name}",
        expected=f"uniform steps at {test.sample_rate_hz:g} samples a second, as {test.source} "
        "[test] sample_rate_hz says",
        found=f"a step of {gap:.4g} where others have {usual:.4g}"
        if agreed
        else f"{test.sample_rate_hz / ratio:g} samples a second",
        remedy="correct the one that is wrong; if it is this clock, take its column out of the "
        "file",
    )


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
    ranges = {
        # Absolute ones: what a gauge or a differential reading is taken against is in them.
        probe.name: (0.0, test.adc.top_code)
        if probe.record_unit == COUNT
        else (np.nextafter(0.0, 1.0), np.inf)
        for probe in test.pressures
    } | {couple.name: POSSIBLE_K for couple in test.temperatures}
    lowest, highest = np.array([ranges.get(name, (-np.inf, np.inf)) for name in names]).T
    return lowest, highest


def _check_possible(
    stored: RawFile,
    test: TestDescription,
    column: FeedColumn,
    values: FloatArray,
    possible: tuple[float, float],
    rows_before: int,
) -> None:
    """Refuse codes that the converter does not have, and what no gas or thermocouple has."""
    off = (values < possible[0]) | (values > possible[1])
    if not off.any():
        return
    row = int(np.argmax(off))
    probe = next((p for p in test.pressures if p.name == column.name), None)
    expected, remedy = _what_is_possible(probe, test)
    raise InputError(
        f"{stored.source}: channel {column.name}",
        expected=expected,
        found=f"{values[row]:g}{' Pa' if column.record_unit == 'Pa' else ''} in row "
        f"{rows_before + row + 1}",
        remedy=remedy,
    )


def _what_is_possible(probe: PressureChannel | None, test: TestDescription) -> tuple[str, str]:
    """Return what is expected of a channel, and what to look at."""
    remedy = "check the unit of the column"
    if probe is None:
        low_K, high_K = POSSIBLE_K
        return f"absolute temperatures in K, {low_K:g} to {high_K:g}", remedy
    if probe.record_unit == COUNT:
        return f"counts of a {test.adc.bits}-bit converter (0 to {test.adc.top_code})", remedy
    against = "which is added to it" if probe.reference_Pa else "which a gauge reading needs"
    remedy += f" and reference_Pa in [channels.{probe.name}] of {test.source}, {against}; "
    return (
        "absolute pressures above 0 Pa",
        remedy + "leave out a probe that drops out, with its mate",
    )
