"""Which column of a file feeds which channel of test.toml, and how it becomes SI."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches

from classic_ml.description import PressureChannel, TemperatureChannel, TestDescription
from classic_ml.io.table import TIME_COLUMN, StoredTable
from classic_ml.units import COUNT, Conversion, conversion_to_si, kind_of_unit, same_unit
from surge_core.errors import InputError

__all__ = ["CLOCK_NAMES", "Feed", "check_columns", "feeds", "nearest_name"]

# What a clock is called, in small letters.
CLOCK_NAMES = (TIME_COLUMN, "time", "t", "time (s)", "time [s]", "timestamp", "elapsed time")
# Of a step: channels that start further apart were not sampled together.
SAME_START = 0.01


@dataclass(frozen=True)
class Feed:
    """A column of the file that feeds the clock or a channel.

    Parameters
    ----------
    name : str
        ``"time_s"`` or the channel.
    column : str
        Column of the file; empty for a clock that is made from the rate.
    unit : str
        Its unit there.
    record_unit : str
        Unit after the conversion: ``"count"``, ``"Pa"``, ``"K"`` or ``"s"``.
    conversion : Conversion
        From the one to the other.
    channel : PressureChannel or TemperatureChannel, optional
        The channel; None for the clock.
    """

    name: str
    column: str
    unit: str
    record_unit: str
    conversion: Conversion
    channel: PressureChannel | TemperatureChannel | None = None

    @property
    def title(self) -> str:
        """What to call it in an error."""
        if self.channel is None:
            return f"column {self.column}"
        renamed = f" (column '{self.column}')" if self.column != self.name else ""
        return f"channel {self.name}{renamed}"


def feeds(stored: StoredTable, test: TestDescription) -> tuple[Feed, ...]:
    """Return which column feeds the clock and each channel, whether the file has it or not.

    Parameters
    ----------
    stored : StoredTable
        The file as it is.
    test : TestDescription
        The description.

    Returns
    -------
    tuple of Feed
        The clock, the pressures, the temperatures.

    Raises
    ------
    InputError
        When ``[file] time_unit`` is no unit of time.
    """
    columns = [_clock(stored, test)]
    for channel in test.channels:
        where = f"{test.source}: channels.{channel.name}"
        reference_Pa = channel.reference_Pa if isinstance(channel, PressureChannel) else None
        kind = COUNT if channel.record_unit == COUNT else channel.kind
        conversion = conversion_to_si(channel.unit, kind, where, reference_Pa)
        unit, record_unit = channel.unit, channel.record_unit
        columns.append(
            Feed(channel.name, channel.file_column, unit, record_unit, conversion, channel)
        )
    return tuple(columns)


def _clock(stored: StoredTable, test: TestDescription) -> Feed:
    layout = test.file
    if layout.clock == "from rate":
        return Feed(TIME_COLUMN, "", "s", "s", Conversion())
    stated = stored.unit(layout.time) if layout.units == "check" else ""
    unit = layout.time_unit or (stated if kind_of_unit(stated) == "time" else "s")
    conversion = conversion_to_si(unit, "time", f"{test.source}: file.time_unit")
    return Feed(TIME_COLUMN, layout.time, unit, "s", conversion)


def check_columns(stored: StoredTable, test: TestDescription, columns: tuple[Feed, ...]) -> None:
    """Refuse a table whose columns are not those that a test describes.

    Parameters
    ----------
    stored : StoredTable
        The table as it is.
    test : TestDescription
        The description.
    columns : tuple of Feed
        What it asks for, of :func:`feeds`.

    Raises
    ------
    InputError
        When columns are missing or not described, have another unit than test.toml says, or were
        not sampled together.
    """
    needed = [feed for feed in columns if feed.column]
    fed = {feed.column for feed in needed}
    missing = [feed for feed in needed if feed.column not in stored.names]
    extra = [name for name in stored.names if name not in fed]
    if missing:
        raise _missing(stored, test, missing, extra)
    if extra and test.file.other_columns == "refuse":
        raise InputError(
            f"{stored.source}: column {extra[0]}",
            expected=f'a table [channels."{extra[0]}"] in {test.source}',
            found="none" + (f" (nor for {', '.join(extra[1:])[:200]})" if extra[1:] else ""),
            remedy="describe the channel, leave the column out, or write "
            'other_columns = "ignore" in [file]',
        )
    if test.file.units == "check":
        for feed in needed:
            _check_unit(stored, test, feed)
    sampled = [(name, stored.sampled[name]) for name in stored.sampled if name in fed]
    for name, (start_s, step_s) in sampled[1:]:
        other, (first_s, usual_s) = sampled[0]
        if abs(step_s / usual_s - 1.0) > 1e-9 or abs(start_s - first_s) > SAME_START * usual_s:
            raise InputError(
                f"{stored.source}: channels {other} and {name}",
                expected="one start and one wf_increment for all channels that are read",
                found=f"steps of {usual_s:g} and {step_s:g} s, starts at {first_s:g} and "
                f"{start_s:g} s",
                remedy="resample them to one clock, or correct the properties that are wrong",
            )


def nearest_name(name: str, names: Iterable[str]) -> str:
    """Return the name most like another, whatever stands between their letters and digits.

    Parameters
    ----------
    name : str
        The name that is not there.
    names : iterable of str
        Those that are.

    Returns
    -------
    str
        Empty where none is like it.
    """
    folded = {"".join(filter(str.isalnum, other.lower())): other for other in names}
    near = get_close_matches("".join(filter(str.isalnum, name.lower())), folded, 1)
    return folded[near[0]] if near else ""


def _missing(
    stored: StoredTable, test: TestDescription, missing: list[Feed], spare: list[str]
) -> InputError:
    """Return the refusal of a table that lacks columns, with what the file has instead."""
    first = missing[0]
    others = f" (nor {', '.join(feed.column for feed in missing[1:])[:200]})" if missing[1:] else ""
    found = f"no such column{others} among {', '.join(stored.names)[:120]}"
    for name, why in stored.left_aside.items():
        if name.split("/")[-1] == first.column:
            found = f"'{name}': {why}"
    near = nearest_name(first.column, spare)
    if first.channel is None:
        remedy = 'name it in [file], time = "...", or write clock = "from rate"'
        expected = f"a table with a header and a column {first.column}"
    else:
        remedy = "a dead probe is left out with its mate, in both files"
        expected = f"it in the table, as {test.source} describes it"
    if near:
        where = "time" if first.channel is None else "column"
        remedy = f"is '{near}' meant? then write {where} = \"{near}\""
    return InputError(
        f"{stored.source}: {first.title}", expected=expected, found=found, remedy=remedy
    )


def _check_unit(stored: StoredTable, test: TestDescription, feed: Feed) -> None:
    """Refuse a unit of test.toml that is not the one the file states."""
    stated = stored.unit(feed.column)
    if not same_unit(stated, feed.unit, getattr(feed.channel, "reference_Pa", None)):
        raise InputError(
            f"{stored.source}: {feed.title}",
            expected=f'the unit "{feed.unit}", as {test.source} says',
            found=f'"{stated}", as the file says',
            remedy="correct the one that is wrong; where the file is, write "
            'units = "from test.toml" in [file]',
        )
