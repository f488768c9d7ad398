"""A raw record of any format, its columns named as test.toml names the channels, in SI."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.readers.passed_over_clock import passed_over_clock
from classic_ml.readers.raw_formats import open_stored
from classic_ml.readers.raw_parquet import INDEX
from classic_ml.readers.raw_table import TIME_COLUMN, Columns, RawFile
from classic_ml.readers.sampled_together import check_rate, check_sampled_together
from classic_ml.readers.test_description import (
    PressureChannel,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.units import (
    COUNT,
    Conversion,
    pressure_conversion,
    same_unit,
    states_a_unit,
    temperature_conversion,
    time_conversion,
)
from surge_core.errors import InputError

__all__ = ["FeedColumn", "check_columns", "check_units", "feeds", "nearest_names", "open_raw"]


@dataclass(frozen=True)
class FeedColumn:
    """A column of the file that feeds the clock or a channel.

    Parameters
    ----------
    name : str
        ``"time_s"`` or the channel.
    column : str
        Column of the file.
    unit : str
        Its unit there.
    record_unit : str
        Unit after the conversion: ``"count"``, ``"Pa"``, ``"K"`` or ``"s"``.
    conversion : Conversion
        From the one to the other.
    """

    name: str
    column: str
    unit: str
    record_unit: str
    conversion: Conversion

    @property
    def title(self) -> str:
        """What to call it in an error."""
        if self.name == TIME_COLUMN:
            return f"column {self.column}"
        renamed = f" (column '{self.column}')" if self.column != self.name else ""
        return f"channel {self.name}{renamed}"


def open_raw(raw_path: str | os.PathLike[str], test: TestDescription) -> RawFile:
    """Open a raw record as the table that test.toml describes.

    Nothing but the layout is read before the first chunk is asked for. Each chunk is checked for
    values that are no finite numbers; the clock and the range of the readings are not checked. A
    clock that is passed over is looked at until the last chunk has been read.

    Parameters
    ----------
    raw_path : str or path
        A file of any format that :func:`classic_ml.readers.raw_formats.open_stored` knows.
    test : TestDescription
        The description: columns, units and layout of the file.

    Returns
    -------
    RawFile
        Columns ``time_s``, then the channels in the order of ``test.channel_names``, with their
        units: s; ``"count"`` or Pa for pressures; K for temperatures. The numbers do not depend
        on the size of the chunks.

    Raises
    ------
    InputError
        Naming the file and the channel: not there, left over, in another unit than the file
        says, or not sampled with the others; while the chunks are read, a value that is no finite
        number, with its row; after the last, a clock of the file that contradicts the one that is
        made.
    """
    stored = open_stored(raw_path, test.file)
    columns = feeds(stored, test)
    check_columns(stored, test, columns)
    check_units(stored, test, columns)
    asked = {column.column for column in columns}
    check_sampled_together(stored, [column.column for column in (*columns[1:], columns[0])])
    names = tuple(column.name for column in columns)
    made = test.file.clock == "from rate"
    passed_over = passed_over_clock(stored, asked, test.sample_rate_hz) if made else None
    if made:
        check_rate(stored, asked, test)
    read = stored.only((*asked, passed_over.name) if passed_over is not None else tuple(asked))

    def converted(rows: int) -> Iterator[Columns]:
        first_row = 0
        shift_s: float | None = None
        watch = replace(passed_over) if passed_over is not None else None
        for found in read.columns(rows):
            by_name = dict(zip(read.names, found, strict=True))
            n_rows = found[0].size
            if watch is not None:
                watch.add(np.asarray(by_name[watch.name], dtype=np.float64))
            clock, *values = (
                _converted(read, column, by_name[column.column], first_row)
                if column.column
                else (test.file.start_s or 0.0)
                + np.arange(first_row, first_row + n_rows, dtype=np.float64) / test.sample_rate_hz
                for column in columns
            )
            if not made and test.file.start_s is not None and n_rows:
                if shift_s is None:
                    shift_s = test.file.start_s - float(clock[0])
                clock = clock + shift_s
            first_row += n_rows
            yield clock, *values
        if watch is not None:
            watch.finish(f"{test.source} [test] sample_rate_hz")

    return RawFile(
        stored.source,
        names,
        converted,
        {column.name: column.record_unit for column in columns},
        stored.n_rows,
        f"from the sample rate, {test.sample_rate_hz:g} Hz" if made else stored.clock,
        stored.unusable,
    )


def feeds(stored: RawFile, test: TestDescription) -> tuple[FeedColumn, ...]:
    """Return which column feeds the clock and each channel, whether the file has it or not.

    Parameters
    ----------
    stored : RawFile
        The file as it is.
    test : TestDescription
        The description.

    Returns
    -------
    tuple of FeedColumn
        The clock, the pressures, the temperatures.

    Raises
    ------
    InputError
        When the file states a unit for the clock that is none of time.
    """
    return (
        _clock(stored, test),
        *(_pressure_feed(channel, test) for channel in test.pressures),
        *(_temperature_feed(channel, test) for channel in test.temperatures),
    )


def _clock(stored: RawFile, test: TestDescription) -> FeedColumn:
    layout = test.file
    if layout.clock == "from rate":
        return FeedColumn(TIME_COLUMN, "", "s", "s", Conversion())
    stated = stored.units.get(layout.time, "")
    unit, where = "s", f"{stored.source}: column {layout.time}"
    if layout.time_unit is not None:
        unit, where = layout.time_unit, f"{test.source}: [file] time_unit"
    elif states_a_unit(stated) and layout.units == "check":
        unit = stated
    return FeedColumn(TIME_COLUMN, layout.time, unit, "s", time_conversion(unit, where))


def _pressure_feed(channel: PressureChannel, test: TestDescription) -> FeedColumn:
    conversion = Conversion()
    if channel.unit != COUNT:
        where = f"{test.source}: [channels.{channel.name}]"
        conversion = pressure_conversion(channel.unit, where, channel.reference_Pa)
    return FeedColumn(
        channel.name, channel.file_column, channel.unit, channel.record_unit, conversion
    )


def _temperature_feed(channel: TemperatureChannel, test: TestDescription) -> FeedColumn:
    where = f"{test.source}: [channels.{channel.name}]"
    conversion = temperature_conversion(channel.unit, where)
    return FeedColumn(channel.name, channel.file_column, channel.unit, "K", conversion)


def check_columns(stored: RawFile, test: TestDescription, columns: tuple[FeedColumn, ...]) -> None:
    """Refuse a table that lacks a described column, or has one that nobody described.

    Parameters
    ----------
    stored : RawFile
        The table as it is.
    test : TestDescription
        The description.
    columns : tuple of FeedColumn
        What it asks for, of :func:`feeds`.

    Raises
    ------
    InputError
        Naming the column.
    """
    needed = [column for column in columns if column.column]
    missing = [column for column in needed if column.column not in stored.names]
    fed = {column.column for column in needed}
    if missing:
        raise _missing(stored, test, missing, [name for name in stored.names if name not in fed])
    if test.file.clock == "from rate":
        # The clock that is replaced is no column left over.
        fed |= {TIME_COLUMN, *stored.stamps}
    extra = [name for name in stored.names if name not in fed and not name.startswith(INDEX)]
    if extra and test.file.other_columns == "refuse":
        name = extra[0]
        raise InputError(
            f"{stored.source}: channel {name}",
            expected=f"a table [channels.{_toml_key(name)}] in {test.source}",
            found="none" + (f" (nor for {len(extra) - 1} more)" if extra[1:] else ""),
            remedy="describe the channel, leave the column out, or write "
            'other_columns = "ignore" in [file]',
        )


def nearest_names(name: str, names: Iterable[str], n: int = 1) -> list[str]:
    """Return the names most like another, whatever stands between their letters and digits.

    Parameters
    ----------
    name : str
        The name that is not there.
    names : iterable of str
        Those that are.
    n : int
        How many to return at most.
    """
    folded: dict[str, str] = {}
    for other in names:
        folded.setdefault(_folded(other), other)
    return [folded[close] for close in get_close_matches(_folded(name), folded, n)]


def _folded(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


def _toml_key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isalnum() else f'"{name}"'


def _missing(
    stored: RawFile, test: TestDescription, missing: list[FeedColumn], spare: list[str]
) -> InputError:
    first = missing[0]
    elsewhere = [n for n in stored.unusable if n.endswith(f"/{first.column}")]
    if first.column not in stored.unusable and elsewhere:
        group = elsewhere[0].removesuffix(f"/{first.column}")
        return InputError(
            f"{stored.source}: {first.title}",
            expected=f"it in the table, as {test.source} describes it",
            found=stored.unusable[elsewhere[0]],
            remedy="resample that group to the clock of the others, or write "
            f'group = "{group}" in [file] for its channels alone',
        )
    why = stored.unusable.get(first.column)
    found = why if why else "no such column"
    near = nearest_names(first.column, spare)
    if first.name == TIME_COLUMN:
        return InputError(
            stored.source,
            expected=f"a table with a header and a column {first.column}",
            found=why or "the columns " + _shortened(stored.names),
            remedy=f'write time = "{near[0]}" in [file] of {test.source}'
            if near
            else f'name the clock in [file] of {test.source}: time = "...", or clock = "from rate"',
        )
    more = f" (nor {len(missing) - 1} more)" if missing[1:] and not why else ""
    return InputError(
        f"{stored.source}: {first.title}",
        expected=f"it in the table, as {test.source} describes it",
        found=found + more,
        remedy=f"is '{near[0]}' meant? then write column = \"{near[0]}\""
        if near and not why
        else "a dead probe is left out with its mate, in both files",
    )


def _shortened(names: tuple[str, ...]) -> str:
    text = ", ".join(names)
    return text if len(text) <= 120 else text[:117] + "..."


def check_units(stored: RawFile, test: TestDescription, columns: tuple[FeedColumn, ...]) -> None:
    """Refuse a unit of test.toml that is not the one the file states.

    Parameters
    ----------
    stored : RawFile
        The file as it is.
    test : TestDescription
        The description; its ``[file] units`` may say that the units of the file are of no account.
    columns : tuple of FeedColumn
        What :func:`feeds` gives for the two.

    Raises
    ------
    InputError
        Naming the channel and both units.
    """
    if test.file.units != "check":
        return
    references: Mapping[str, float | None] = {c.name: c.reference_Pa for c in test.pressures}
    kinds = {"count": "pressure", "Pa": "pressure", "K": "temperature", "s": "time"}
    for column in columns:
        stated = stored.units.get(column.column, "")
        if not states_a_unit(stated):
            continue
        kind = kinds[column.record_unit]
        if not same_unit(stated, column.unit, kind, references.get(column.name)):
            raise InputError(
                f"{stored.source}: {column.title}",
                expected=f'the unit "{column.unit}", as {test.source} says',
                found=f'"{stated}", as the file says',
                remedy="correct the one that is wrong; where the file is, write "
                'units = "from test.toml" in [file]',
            )


def _converted(
    stored: RawFile, column: FeedColumn, readings: NDArray[Any], first_row: int
) -> NDArray[Any]:
    """Return a column in SI; whole numbers that are in it already as they are."""
    if column.conversion == Conversion() and readings.dtype.kind in "iu":
        return readings
    converted = column.conversion.to_si(np.asarray(readings, dtype=np.float64))
    # A reading that is finite may be infinite in SI.
    finite = np.isfinite(converted)
    if not finite.all():
        row = int(np.argmin(finite))
        raise InputError(
            f"{stored.source}: {column.title}",
            expected="a finite number in every row",
            found=f"'{readings[row]}' in row {first_row + row + 1}",
            remedy="cut the record there or repair the channel",
        )
    return converted
