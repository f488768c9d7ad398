"""A raw record of any format as a Record: channels named as in test.toml, in SI, checked."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import AnyChannel, CountChannel, PressureChannel, TestDescription
from classic_ml.io.description_file import read_test_description
from classic_ml.io.formats import open_stored
from classic_ml.io.table import NOT_FINITE_REMEDY, StoredTable
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.series import (
    CLOCK_TOLERANCE,
    MINIMUM_ROWS,
    jittering_period_s,
    uniform_period_s,
)
from classic_ml.units import conversion_to_si, kind_of_unit, same_unit
from surge_core.errors import InputError
from surge_core.types import FloatArray

# Readings that are held at once: 1.6 GB, an hour of 20 channels at 2.8 kHz. A reduction takes a
# few times as much.
MOST_VALUES = 200_000_000
# How many columns a sentence names.
LISTED = 12
# A crystal clock keeps 1e-4; a record at another rate is off by far more.
RATE_TOLERANCE = 1e-3
# Spikes and drop-outs, which are marked and left out later; more is another unit.
DROPPED_SHARE = 0.05
# Beyond these no gas of a compressor is, nor a thermocouple that measures it.
POSSIBLE_K = (50.0, 3000.0)

Window = tuple[float, float]
# The columns of a part of a file, its clock in s, and the rows of the file before it.
_Readings = tuple[dict[str, NDArray[np.generic]], FloatArray, int]


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
    with open_stored(raw_path, test.file) as stored:
        _check_columns(stored, test)
        read = _read(stored, test, window, progress)
        if read is None and window is None and test.window_s is not None:
            window = test.window_s
            read = _read(stored, test, window, progress)
    if read is None:
        columns = len(test.channel_names) + 1
        raise InputError(
            stored.source,
            expected=f"at most {MOST_VALUES // columns} rows of {columns} columns at once",
            found="more",
            remedy=f"`sindy-surge inspect` finds where it surges: name that as [window] in "
            f"{test.source} or with --from-s and --to-s, and where the near-stall reading is far "
            "before it, its [near_stall_shifts]",
        )
    return _record(stored, test, read, window), test


def _clock_unit(stored: StoredTable, test: TestDescription) -> str:
    """Return the unit of the clock: that of test.toml, else that of the file, else seconds."""
    stated = stored.units.get(test.file.time, "") if test.file.units == "check" else ""
    return test.file.time_unit or (stated if kind_of_unit(stated) == "time" else "s")


def _title(channel: AnyChannel) -> str:
    renamed = f" (column '{channel.file_column}')" if channel.file_column != channel.name else ""
    return f"channel {channel.name}{renamed}"


def _listed(names: Sequence[str]) -> str:
    few = names[:LISTED]
    return ", ".join(few) + (f" and {len(names) - len(few)} more" if len(names) > len(few) else "")


def _check_columns(stored: StoredTable, test: TestDescription) -> None:
    """Refuse a table whose columns, units or sampling are not those that a test describes."""
    layout = test.file
    titles = {channel.file_column: _title(channel) for channel in test.channels}
    if layout.clock == "column":
        titles = {layout.time: f"column {layout.time}", **titles}
    missing = [column for column in titles if column not in stored.names]
    spare = [name for name in stored.names if name not in {*titles, layout.time}]
    if missing and {"time_s", "phi", "psi_p"} <= set(stored.names):
        raise InputError(
            stored.source,
            expected=f"a raw record with the channels of {test.source}",
            found="a series of φ and ψ'",
            remedy="give the raw record; a series is read by compare, diagnose and structure",
        )
    if missing:
        nor = f" (nor {_listed(missing[1:])})" if missing[1:] else ""
        found = f"no such column{nor}; those that feed nothing: {_listed(spare) or 'none'}"
        aside = {n.split("/")[-1]: f"'{n}': {why}" for n, why in stored.left_aside.items()}
        remedy = 'name what is meant, column = "..."; a dead probe is left out with its mate'
        if titles[missing[0]].startswith("column"):
            remedy = 'name it in [file], time = "...", or write clock = "from rate"'
        if len(missing) == len(titles):
            remedy += "; if lines stand above the header, take these away"
        raise InputError(
            f"{stored.source}: {titles[missing[0]]}",
            expected=f"it in the header of the table, as {test.source} describes it",
            found=aside.get(missing[0], found),
            remedy=remedy,
        )
    if spare and layout.other_columns == "refuse":
        raise InputError(
            f"{stored.source}: column {spare[0]}",
            expected=f'a table [channels."{spare[0]}"] in {test.source}',
            found="none" + (f" (nor for {_listed(spare[1:])})" if spare[1:] else ""),
            remedy="describe the channel, leave the column out, or write "
            'other_columns = "ignore" in [file]',
        )
    if layout.units == "check":
        _check_units(stored, test, titles)


def _check_units(stored: StoredTable, test: TestDescription, titles: dict[str, str]) -> None:
    """Refuse a unit of test.toml that is not the one the file states."""
    units: dict[str, tuple[str, float | None]] = {
        channel.file_column: (channel.unit, getattr(channel, "reference_Pa", None))
        for channel in test.channels
    }
    units.setdefault(test.file.time, (_clock_unit(stored, test), None))
    for column, title in titles.items():
        stated, (unit, reference_Pa) = stored.units.get(column, ""), units[column]
        if not same_unit(stated, unit, reference_Pa):
            raise InputError(
                f"{stored.source}: {title}",
                expected=f'the unit "{unit}", as {test.source} says',
                found=f'"{stated}", as the file says',
                remedy="correct the one that is wrong; where the file is, write "
                'units = "from test.toml" in [file]',
            )


def _read(
    stored: StoredTable,
    test: TestDescription,
    window: Window | None,
    progress: Callable[[int], object] | None,
) -> _Readings | None:
    """Read the rows of a window, or all; None where they are more than are held at once."""
    layout = test.file
    has_clock = layout.clock == "column"
    where = f"{test.source}: file.time_unit"
    clock = conversion_to_si(_clock_unit(stored, test), "time", where)
    fed = tuple(channel.file_column for channel in test.channels)
    # A clock that does not count is read where there is one, to be set beside the rate.
    names = tuple(dict.fromkeys((layout.time, *fed) if layout.time in stored.names else fed))
    low_s, high_s = _span(test, window)
    kept: list[tuple[NDArray[np.generic], ...]] = []
    times: list[FloatArray] = []
    rows = rows_before = 0
    for block in stored.blocks(names):
        n_rows = block[0].size
        time_s = np.arange(rows, rows + n_rows) / test.sample_rate_hz
        if has_clock:
            time_s = clock.to_si(np.asarray(block[0], dtype=np.float64))
        if progress is not None:
            progress(n_rows)
        # What is no number is kept, and refused with the number of its row.
        inside = np.flatnonzero(~((time_s < low_s) | (time_s > high_s)))
        if inside.size:
            part = slice(inside[0], inside[-1] + 1)
            rows_before = rows_before if kept else rows + int(inside[0])
            kept.append(tuple(column[part] for column in block))
            times.append(time_s[part])
        elif kept:
            break
        rows += n_rows
        if sum(map(len, times)) * len(names) > MOST_VALUES:
            return None
    if sum(map(len, times)) < MINIMUM_ROWS:
        raise InputError(
            stored.source,
            expected=f"at least {MINIMUM_ROWS} rows" + (f" {_asked(window)}" if window else ""),
            found=f"{sum(map(len, times))}",
        )
    columns = map(np.concatenate, zip(*kept, strict=True))
    return dict(zip(names, columns, strict=True)), np.concatenate(times), rows_before


def _span(test: TestDescription, window: Window | None) -> Window:
    """Return from when to when is read, in s: the near-stall reading with it, where it is asked."""
    if window is None:
        return -np.inf, np.inf
    half_s = 0.5 / test.sample_rate_hz
    near = () if test.near_stall_shifts else (test.near_stall.from_s, test.near_stall.to_s)
    return min((window[0], *near[:1])) - half_s, max((window[1], *near[1:])) + half_s


def _asked(window: Window) -> str:
    """Return which part of a record was asked for, in words."""
    from_s, to_s = window
    start = "the start" if from_s == -np.inf else f"{from_s:g} s"
    return f"from {start} to the end" if to_s == np.inf else f"from {start} to {to_s:g} s"


def _record(
    stored: StoredTable, test: TestDescription, read: _Readings, window: Window | None
) -> Record:
    columns, time_s, rows_before = read
    part = ""
    _check_readings(stored, test, None, time_s, rows_before)
    if window is not None:
        if window[1] < time_s[0] or window[0] > time_s[-1]:
            raise InputError(
                stored.source,
                expected=f"rows {_asked(window)} of its clock, as was asked",
                found=f"only rows from {time_s[0]:.3f} to {time_s[-1]:.3f} s",
            )
        part = ", a part of the file"
        if time_s[0] < window[0] - 1.0 / test.sample_rate_hz:
            part += f" (from {window[0]:g} s on was asked; the near-stall reading is before it)"
    _check_rate(stored, test, time_s, columns.get(test.file.time))
    channels: dict[str, Channel] = {}
    for channel in test.channels:
        values = np.asarray(columns.pop(channel.file_column), dtype=np.float64)
        values = channel.conversion.to_si(values)
        _check_readings(stored, test, channel, values, rows_before)
        channels[channel.name] = Channel(channel.name, values, channel.record_unit)
    rate_hz = test.sample_rate_hz
    made = "; the clock is made from the sample rate" if test.file.clock == "from rate" else ""
    entry = LedgerEntry(
        "read",
        f"{time_s.size} rows of {len(channels)} channels, {time_s[0]:.3f} to {time_s[-1]:.3f} s "
        f"at {rate_hz:g} Hz{part}{made}",
        {"raw": stored.source, "test": test.source, "rows": int(time_s.size)},
    )
    return Record(channels, rate_hz, float(time_s[0]), stored.source, (entry,))


def _check_rate(
    stored: StoredTable, test: TestDescription, time_s: FloatArray, column: Any | None
) -> None:
    """Refuse a clock that is not uniform, or a file that states another rate than test.toml."""
    where = f"{stored.source}: column {test.file.time}"
    if test.file.clock == "column":
        period_s = uniform_period_s(time_s, where)
    elif column is not None:
        clock = conversion_to_si(_clock_unit(stored, test), "time", where)
        period_s = jittering_period_s(clock.to_si(np.asarray(column, dtype=np.float64)))
    else:
        where, period_s = f"{stored.source}: step of its waveforms", stored.step_s
    ratio = period_s * test.sample_rate_hz
    # The ends of a printed clock are each rounded by up to half a digit, worth half of what
    # a step may be off at the coarsest clock that is let through.
    if not abs(ratio - 1.0) > RATE_TOLERANCE + CLOCK_TOLERANCE / (time_s.size - 1):
        return
    in_ms = abs(ratio / 1e3 - 1.0) < RATE_TOLERANCE
    raise InputError(
        where,
        expected=f"{test.sample_rate_hz:g} samples a second, as {test.source} [test] "
        "sample_rate_hz says",
        found=f"{test.sample_rate_hz / ratio:g}",
        remedy='is it in ms? then write time_unit = "ms" in [file]'
        if in_ms
        else f"if the clock is right, write sample_rate_hz = {test.sample_rate_hz / ratio:g}",
    )


def _check_readings(
    stored: StoredTable,
    test: TestDescription,
    channel: AnyChannel | None,
    values: FloatArray,
    rows_before: int,
) -> None:
    """Refuse what is no number, codes that the converter does not have, and what no gas has.

    Of the last a few rows pass.
    """
    low, high, possible, remedy = -np.inf, np.inf, "", "check the unit of the column"
    if isinstance(channel, CountChannel):
        low, high = 0.0, float(test.adc.top_code)
        possible = f"counts of a {test.adc.bits}-bit converter (0 to {test.adc.top_code})"
    elif isinstance(channel, PressureChannel):
        low, possible = np.nextafter(0.0, 1.0), "absolute pressures above 0 Pa"
        remedy += f", its sign and reference_Pa in [channels.{channel.name}] of {test.source}"
    elif channel is not None:
        low, high = POSSIBLE_K
        possible = f"absolute temperatures in K, {low:g} to {high:g}"
    # What is no number is in no range.
    if low <= values.min() and values.max() <= high and np.isfinite(values.max()):
        return
    finite = np.isfinite(values)
    good = finite if not finite.all() else (low <= values) & (values <= high)
    few = np.count_nonzero(~good) <= DROPPED_SHARE * good.size
    if few and finite.all() and channel is not None and not isinstance(channel, CountChannel):
        return
    row = int(np.argmin(good))
    title = f"column {test.file.time}" if channel is None else _title(channel)
    unit = " Pa" if channel is not None and channel.record_unit == "Pa" else ""
    raise InputError(
        f"{stored.source}: {title}",
        expected=possible if finite.all() else "a finite number in every row",
        found=f"{values[row]:g}{unit} in row {rows_before + row + 1}",
        remedy=remedy if finite.all() else NOT_FINITE_REMEDY,
    )
