"""Which column of a file feeds which channel of test.toml, and how it becomes SI."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from classic_ml.description import PressureChannel, TemperatureChannel, TestDescription
from classic_ml.io.parquet import INDEX
from classic_ml.io.table import TIME_COLUMN, RawFile
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

__all__ = ["FeedColumn", "check_columns", "check_units", "feeds", "nearest_names", "sampled_apart"]

# A start is stated to a microsecond; a skew of a hundredth of a step shows in no result.
SAME_START = 0.01
# Of one step that was computed twice.
SAME_STEP = 1e-9


@dataclass(frozen=True)
class FeedColumn:
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
    columns = [_clock(stored, test)]
    channels: list[PressureChannel | TemperatureChannel] = [*test.pressures, *test.temperatures]
    for channel in channels:
        where = f"{test.source}: channels.{channel.name}"
        if not isinstance(channel, PressureChannel):
            conversion = temperature_conversion(channel.unit, where)
        elif channel.unit == COUNT:
            conversion = Conversion()
        else:
            conversion = pressure_conversion(channel.unit, where, channel.reference_Pa)
        columns.append(
            FeedColumn(
                channel.name, channel.file_column, channel.unit, channel.record_unit, conversion
            )
        )
    return tuple(columns)


def _clock(stored: RawFile, test: TestDescription) -> FeedColumn:
    layout = test.file
    if layout.clock == "from rate":
        return FeedColumn(TIME_COLUMN, "", "s", "s", Conversion())
    stated = stored.units.get(layout.time, "")
    unit, where = "s", f"{stored.source}: column {layout.time}"
    if layout.time_unit is not None:
        unit, where = layout.time_unit, f"{test.source}: file.time_unit"
    elif states_a_unit(stated) and layout.units == "check":
        unit = stated
    return FeedColumn(TIME_COLUMN, layout.time, unit, "s", time_conversion(unit, where))


def check_columns(stored: RawFile, test: TestDescription, columns: tuple[FeedColumn, ...]) -> None:
    """Refuse a table that lacks described columns, or has one that is not described.

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
        Naming the columns.
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
        raise InputError(
            f"{stored.source}: channel {extra[0]}",
            expected=f"a table [channels.{_toml_key(extra[0])}] in {test.source}",
            found="none" + (f" (nor for {', '.join(extra[1:])[:200]})" if extra[1:] else ""),
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
    """Return the refusal of a table that lacks columns, with what the file has instead."""
    first = missing[0]
    why = next(
        (
            why
            for name, why in stored.unusable.items()
            if name == first.column or name.endswith(f"/{first.column}")
        ),
        "",
    )
    near = nearest_names(first.column, spare)
    if first.name == TIME_COLUMN:
        return InputError(
            stored.source,
            expected=f"a table with a header and a column {first.column}",
            found=why or "the columns " + ", ".join(stored.names)[:120],
            remedy=f'write time = "{near[0]}" in [file] of {test.source}'
            if near
            else f'name the clock in [file] of {test.source}: time = "...", or clock = "from rate"',
        )
    others = f" (nor {', '.join(c.column for c in missing[1:])[:200]})" if missing[1:] else ""
    remedy = "a dead probe is left out with its mate, in both files"
    if near:
        remedy = f"is '{near[0]}' meant? then write column = \"{near[0]}\""
    return InputError(
        f"{stored.source}: {first.title}",
        expected=f"it in the table, as {test.source} describes it",
        found=why or f"no such column{others}",
        remedy="resample it to the clock of the others" if why else remedy,
    )


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
        kind = kinds[column.record_unit]
        if states_a_unit(stated) and not same_unit(
            stated, column.unit, kind, references.get(column.name)
        ):
            raise InputError(
                f"{stored.source}: {column.title}",
                expected=f'the unit "{column.unit}", as {test.source} says',
                found=f'"{stated}", as the file says',
                remedy="correct the one that is wrong; where the file is, write "
                'units = "from test.toml" in [file]',
            )


def sampled_apart(stored: RawFile, names: Collection[str]) -> InputError | None:
    """Return what is wrong where the file says that columns were not sampled together.

    Parameters
    ----------
    stored : RawFile
        The file.
    names : collection of str
        Columns that are read.
    """
    stated = [(name, stored.sampled[name]) for name in stored.sampled if name in names]
    for name, sampling in stated[1:]:
        other, first = stated[0]
        later_s = sampling.start_s - first.start_s
        found = ""
        if abs(sampling.step_s / first.step_s - 1.0) > SAME_STEP:
            found = f"steps by {sampling.step_s:g} s where the first steps by {first.step_s:g} s"
        elif abs(later_s) > SAME_START * first.step_s:
            found = f"starts {abs(later_s):g} s {'later' if later_s > 0.0 else 'earlier'}"
        if found:
            return InputError(
                f"{stored.source}: channels {other} and {name}",
                expected="one start and one wf_increment for all channels that are read",
                found=f"that the second {found}",
                remedy="resample them to one clock, or correct the properties that are wrong",
            )
    return None
