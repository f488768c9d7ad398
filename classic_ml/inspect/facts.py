"""What is in a file of channels: clock, ranges, saturation, and where the machine surges.

And what it is to a test.toml: mapping, ranges in SI, the reduction.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from classic_ml.calibration import total_reading
from classic_ml.description import AnyChannel, FileLayout, TestDescription
from classic_ml.faults.plateaus import range_ends
from classic_ml.io.formats import open_stored
from classic_ml.io.raw import MOST_VALUES, read_raw
from classic_ml.io.table import StoredTable
from classic_ml.records import LedgerEntry
from classic_ml.reduction import reduce_record
from classic_ml.series import jittering_period_s
from classic_ml.units import conversion_to_si, kind_of_unit
from surge_core.errors import InputError
from surge_core.types import FloatArray


@dataclass(frozen=True)
class ChannelMatch:
    """A channel of test.toml, and the column that feeds it.

    Parameters
    ----------
    channel : str
        Its name in test.toml.
    column : str
        Column of the file.
    unit : str
        Unit as test.toml says.
    si_unit : str
        ``"Pa"`` or ``"K"``.
    minimum, maximum : float
        Range of the readings in that unit; NaN where the file has no such column.
    """

    channel: str
    column: str
    unit: str
    si_unit: str
    minimum: float
    maximum: float


@dataclass(frozen=True)
class TestMatch:
    """What a file is to a test.toml.

    Parameters
    ----------
    test : str
        The name of the test.
    channels : tuple of ChannelMatch
        The channels.
    left_over : tuple of str
        Columns that feed nothing.
    refusal : str
        The sentence that the reduction would refuse the record with; the ledger is empty then.
    history : tuple of LedgerEntry
        The ledger of its reduction.
    """

    # Not a test: it describes one.
    __test__ = False

    test: str
    channels: tuple[ChannelMatch, ...]
    left_over: tuple[str, ...]
    refusal: str
    history: tuple[LedgerEntry, ...]


def match_test(
    raw_path: str | os.PathLike[str], test: TestDescription, inspection: Inspection
) -> TestMatch:
    """Set a file beside the description of its test, and reduce it with the usual settings.

    Parameters
    ----------
    raw_path : str or path
        The file.
    test : TestDescription
        The description.
    inspection : Inspection
        What :func:`classic_ml.inspect.inspect_file` found in it with ``test.file``: of a record
        too long to be read whole, the part where the machine surges is reduced.

    Returns
    -------
    TestMatch
        Whatever does not fit is a finding in it, not an error.
    """
    refusal, history = "", tuple[LedgerEntry, ...]()
    too_long = inspection.rows * (len(test.channel_names) + 1) > MOST_VALUES
    window = inspection.surges_s if too_long and test.window_s is None else None
    try:
        record, _ = read_raw(raw_path, test, window=window)
        history = reduce_record(record, test, keep_probes=False).record.history
    except InputError as error:
        refusal = str(error)
    fed = {test.file.time, *(channel.file_column for channel in test.channels)}
    left_over = tuple(c.name for c in inspection.channels if c.name not in fed)
    matches = tuple(_match(channel, test, inspection) for channel in test.channels)
    return TestMatch(test.name, matches, left_over, refusal, history)


def _match(channel: AnyChannel, test: TestDescription, inspection: Inspection) -> ChannelMatch:
    facts = inspection.channel(channel.file_column)
    low = high = np.nan
    if facts is not None:
        # Every conversion is a straight line.
        ends = channel.conversion.to_si(np.array([facts.minimum, facts.maximum]))
        low, high = sorted(total_reading(channel, test, ends).tolist())
    si_unit = channel.si_unit
    return ChannelMatch(channel.name, channel.file_column, channel.unit, si_unit, low, high)


# How the name of a clock begins, in small letters.
CLOCK_NAMES = ("time", "elapsed time")
# A step this much longer than the usual one is a gap, unless the clock alone is uneven.
GAP_STEPS = 1.5
# A surge cycle lasts from a tenth of a second to some seconds: sections in which it shows, and
# quiet ones between two cycles that do not end it.
SECTION_S, BRIDGED_S = 0.25, 3.0
# Before stall the noise of a probe is a few tenths of a per cent, a surge swings it by tens of per
# cent: sections that move so many times as much as the quiet ones are a surge's.
LEAST_RATIO = 10.0
# The share of sections that are as quiet as the machine is before it surges.
QUIET_SHARE = 0.01


@dataclass(frozen=True)
class ChannelFacts:
    """One column of a file.

    Parameters
    ----------
    name : str
        Its name in the file.
    unit : str
        The unit that the file states; empty without.
    rows, not_finite : int
        Rows that were read, and those of them without a finite number.
    minimum, mean, maximum : float
        Of the finite values; NaN without any.
    at_minimum, at_maximum : int
        Rows at the extreme values themselves.
    longest_run : int
        Rows of the longest run of one value.
    whole_numbers : bool
        Whether all values are whole, as codes are.
    plateaus : tuple of str
        Ends of its range at which it is cut off: ``"minimum"``, ``"maximum"``.
    """

    name: str
    unit: str
    rows: int
    not_finite: int
    minimum: float
    mean: float
    maximum: float
    at_minimum: int
    at_maximum: int
    longest_run: int
    whole_numbers: bool
    plateaus: tuple[str, ...] = ()

    @property
    def constant(self) -> bool:
        """Whether it has one value alone."""
        return self.minimum == self.maximum


@dataclass(frozen=True)
class ClockFacts:
    """The column of times.

    Parameters
    ----------
    name : str
        Its name in the file.
    unit : str
        Its unit; ``"s"`` where the file states none.
    first_s, last_s : float
        Its ends.
    rate_hz : float
        Rows a second: by a line through all times, or where rows are missing over the steps that
        are neither gaps nor back; NaN without any.
    jitter : float
        The largest deviation of these from the usual step, in steps.
    troubles : mapping of str to (int, int)
        How often there is a ``"gap"``, a ``"repeat"`` or a ``"step back"``, and the row after the
        first of them, counted from 1.
    """

    name: str
    unit: str
    first_s: float
    last_s: float
    rate_hz: float
    jitter: float
    troubles: Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class Inspection:
    """What is in a file.

    Parameters
    ----------
    source : str
        The file.
    rows : int
        Rows that were read.
    channels : tuple of ChannelFacts
        Every column of numbers, that of the clock among them.
    clock : ClockFacts or None
        The clock; None where no column looks like one.
    left_aside : mapping of str to str
        What is in the file and no column of numbers, and why.
    surges_s : tuple of float or None
        From when to when the machine surges, by the clock of the file; None where no part of the
        record stands out.
    stated_step_s : float or None
        The step that the file states of its waveforms.
    """

    source: str
    rows: int
    channels: tuple[ChannelFacts, ...]
    clock: ClockFacts | None
    left_aside: dict[str, str]
    surges_s: tuple[float, float] | None = None
    stated_step_s: float | None = None

    def channel(self, name: str) -> ChannelFacts | None:
        """Return one column, or None where there is none of that name."""
        return next((channel for channel in self.channels if channel.name == name), None)


def inspect_file(
    path: str | os.PathLike[str], layout: FileLayout | None = None, *, group: str | None = None
) -> Inspection:
    """Look through a file of channels, block by block.

    Parameters
    ----------
    path : str or path
        A raw record or a series of any format that there is a reader for.
    layout : FileLayout, optional
        Group and clock; without it the clock is found by its name, or as it runs.
    group : str, optional
        Group to look into, without a layout.

    Returns
    -------
    Inspection
        What was found.

    Raises
    ------
    InputError
        When the file cannot be read to its end.
    """
    counts: list[dict[str, Any]] = []
    sections: list[FloatArray] = []
    times: list[FloatArray] = []
    clock: str | None = None
    with open_stored(path, layout or FileLayout(group=group)) as stored:
        names = tuple(name for name in stored.names if name not in stored.left_aside)
        if not names:
            raise InputError(stored.source, expected="columns of numbers", found="text alone")
        for block in stored.blocks(names):
            values = {n: column.astype(float) for n, column in zip(names, block, strict=True)}
            if not counts:
                clock = _clock_column(values, layout)
                unit = _clock_unit(stored, clock, layout)
            counts += [_counts(name, column) for name, column in values.items()]
            if clock is not None:
                times.append(conversion_to_si(unit, "time", clock).to_si(values.pop(clock)))
                sections += _sections(times[-1], _usual(times[0]), list(values.values()))
    channels = _channels(counts, stored.units)
    return Inspection(
        stored.source,
        channels[0].rows if channels else 0,
        channels,
        None if clock is None else _clock_facts(clock, unit, np.concatenate(times)),
        dict(stored.left_aside),
        _surging(np.concatenate(sections)) if sections else None,
        stored.step_s if stored.step_s > 0.0 else None,
    )


def _clock_column(values: Mapping[str, FloatArray], layout: FileLayout | None) -> str | None:
    """Return which column is the clock; None where none looks like one."""
    if layout is not None:
        return layout.time if layout.time in values else None
    lower = {name: name.strip().lower() for name in values}
    named = [n for n, low in lower.items() if low == "t" or low.startswith(CLOCK_NAMES)]
    return named[0] if named else next((n for n, v in values.items() if _runs(v)), None)


def _runs(values: FloatArray) -> bool:
    """Return whether a column goes on in even steps, as a clock does, and is no count of rows."""
    with np.errstate(invalid="ignore"):
        steps = np.diff(values)
    least, largest = float(steps.min(initial=np.inf)), float(steps.max(initial=0.0))
    return 0.0 < largest < GAP_STEPS * least and not bool(np.all(steps == 1.0))


def _clock_unit(stored: StoredTable, clock: str | None, layout: FileLayout | None) -> str:
    stated = stored.units.get(clock or "", "")
    unit = (layout.time_unit if layout is not None else None) or stated
    return unit if kind_of_unit(unit) == "time" else "s"


def _usual(time_s: FloatArray) -> float:
    """Return the usual step of a clock; NaN where it never moves on."""
    steps = np.diff(time_s)
    return float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.nan


def _clock_facts(name: str, unit: str, time_s: FloatArray) -> ClockFacts:
    # What is no number makes no step.
    steps, even_s = np.diff(time_s), jittering_period_s(time_s)
    usual_s = even_s if np.isfinite(even_s) else _usual(time_s)
    is_gap = (steps > GAP_STEPS * usual_s) & ~np.isfinite(even_s)
    kinds = {"gap": is_gap, "repeat": steps == 0.0, "step back": steps < 0.0}
    good = steps[(steps > 0.0) & ~is_gap]
    # What is cut off above is cut off below: the mean of jittering steps stays where it is.
    even = good[good > (2.0 - GAP_STEPS) * usual_s]
    return ClockFacts(
        name,
        unit,
        float(time_s[0]),
        float(time_s[-1]),
        1.0 / (even_s if np.isfinite(even_s) else float(np.mean(even)) if even.size else np.nan),
        float(np.max(np.abs(good - usual_s) / usual_s, initial=0.0)),
        {
            kind: (int(np.count_nonzero(where)), int(np.argmax(where)) + 2)
            for kind, where in kinds.items()
            if where.any()
        },
    )


def _counts(name: str, values: FloatArray) -> dict[str, Any]:
    """Return what some rows of a column hold, by the fields of :class:`ChannelFacts`."""
    finite = values[np.isfinite(values)]
    low, high = (finite.min(), finite.max()) if finite.size else (np.nan, np.nan)
    starts = np.concatenate(([0], np.flatnonzero(values[1:] != values[:-1]) + 1, [values.size]))
    at_maximum, whole = int(np.count_nonzero(finite == high)), bool(np.all(finite % 1.0 == 0.0))
    ends = range_ends(finite) if low < high else ()
    # The rules are those of a reduction; beside them the top code of a converter is known.
    is_code = whole and low < high and high >= 255.0 and np.log2(high + 1.0) % 1.0 == 0.0
    with np.errstate(over="ignore"):
        total = np.sum(finite)
    return {
        "name": name,
        "rows": values.size,
        "not_finite": values.size - finite.size,
        "minimum": low,
        "total": total,
        "maximum": high,
        "at_minimum": np.count_nonzero(finite == low),
        "at_maximum": at_maximum,
        "longest_run": np.max(np.diff(starts)),
        "whole_numbers": whole and finite.size > 0,
        "cut_minimum": low in ends,
        "cut_maximum": high in ends or (is_code and at_maximum > 1),
    }


def _channels(counts: list[dict[str, Any]], units: Mapping[str, str]) -> tuple[ChannelFacts, ...]:
    """Return what all rows of each column hold, of the counts of its parts."""
    import pandas as pd

    parts = pd.DataFrame(counts)
    by_name = parts.groupby("name", sort=False)
    extremes = {"minimum": "min", "maximum": "max"}
    reached = by_name["minimum"].transform("min"), by_name["maximum"].transform("max")
    for end, extreme in zip(extremes, reached, strict=True):
        # What is at the extreme of a part alone does not count.
        counted = [f"at_{end}", f"cut_{end}"]
        parts[counted] = parts[counted].mul(parts[end] == extreme, axis=0)
    sums = dict.fromkeys(("rows", "not_finite", "total", "at_minimum", "at_maximum"), "sum")
    others = {"longest_run": "max", "whole_numbers": "all"}
    others |= {"cut_minimum": "any", "cut_maximum": "any"}
    whole = parts.groupby("name", sort=False).agg(sums | extremes | others)
    whole["mean"] = whole.pop("total") / (whole["rows"] - whole["not_finite"])
    cut = whole[["cut_minimum", "cut_maximum"]].set_axis(list(extremes), axis=1)
    whole["plateaus"] = [tuple(ends.index[ends]) for _, ends in cut.iterrows()]
    whole["unit"] = [units.get(name, "") for name in whole.index]
    rows = whole.drop(columns=["cut_minimum", "cut_maximum"]).reset_index().to_dict("records")
    return tuple(ChannelFacts(**{str(key): value for key, value in row.items()}) for row in rows)


def _sections(time_s: FloatArray, step_s: float, columns: Sequence[FloatArray]) -> list[FloatArray]:
    """Return for each section of some rows its start, its end and the spread of each channel."""
    rows = max(2, round(SECTION_S / step_s)) if step_s > 0.0 else 0
    n_sections = time_s.size // rows if rows else 0
    if not n_sections or not columns:
        return []
    whole = n_sections * rows
    # A reading that is no number makes the spread of its section none.
    with np.errstate(invalid="ignore", over="ignore"):
        spreads = [np.std(c[:whole].reshape(-1, rows), axis=1) for c in columns]
    return [np.column_stack((time_s[:whole:rows], time_s[rows - 1 : whole : rows], *spreads))]


def _surging(sections: FloatArray) -> tuple[float, float] | None:
    """Return from when to when the longest surge lasts; None where no part stands out.

    The swing of a section is the median over the channels of their standard deviation in it, each
    beside that of the same channel in the quiet sections.
    """
    starts_s, ends_s, spreads = sections[:, 0], sections[:, 1], sections[:, 2:]
    spreads = spreads[:, np.isfinite(spreads).all(axis=0)]
    if not spreads.size or not np.isfinite(sections[:, :2]).all():
        return None
    quiet = np.quantile(spreads, QUIET_SHARE, axis=0, method="lower")
    # A channel that stands still in its quiet sections is no measure of the others.
    if not (quiet > 0.0).any():
        return None
    swing = np.median(spreads[:, quiet > 0.0] / quiet[quiet > 0.0], axis=1)
    lively = np.flatnonzero(swing > LEAST_RATIO)
    if not lively.size:
        return None
    apart = np.flatnonzero(np.diff(starts_s[lively]) > BRIDGED_S) + 1
    longest = max(np.split(lively, apart), key=len)
    first, last = max(0, longest[0] - 1), min(longest[-1] + 1, len(sections) - 1)
    return float(starts_s[first]), float(ends_s[last])
