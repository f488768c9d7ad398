"""What is in a file of channels: clock, ranges, saturation, and where the machine surges."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.faults.plateaus import range_ends
from classic_ml.io.formats import open_stored
from classic_ml.io.raw import CLOCK_NAMES
from classic_ml.io.table import Columns, StoredTable
from classic_ml.units import Conversion, conversion_to_si, kind_of_unit
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["ChannelFacts", "ClockFacts", "Inspection", "inspect_file"]

# Rows that are looked at together: what is shorter than this is found whole.
SEARCHED_ROWS = 1 << 20
# A step this much longer than the usual one is a gap: 1.5 leaves room for any jitter below.
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
    rows : int
        Rows that were read.
    not_finite : int
        Of these, rows without a finite number.
    first_not_finite : int or None
        The first of them, counted from 1.
    minimum, mean, maximum : float
        Of the finite values; NaN without any.
    at_minimum, at_maximum : int
        Rows at the extreme values themselves.
    longest_run, longest_run_row : int
        The longest run of one value, and its first row, counted from 1.
    whole_numbers : bool
        Whether all values are whole, as codes are.
    plateaus : tuple of str
        Ends of its range at which it is cut off: ``"minimum"``, ``"maximum"``.
    """

    name: str
    unit: str
    rows: int
    not_finite: int
    first_not_finite: int | None
    minimum: float
    mean: float
    maximum: float
    at_minimum: int
    at_maximum: int
    longest_run: int
    longest_run_row: int
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
    about : str
        What its seconds count from where it is a column of dates.
    first_s, last_s : float
        Its ends.
    rate_hz : float
        Rows a second, over the steps that are neither gaps nor back; NaN without any.
    jitter : float
        The largest deviation of these from the usual step, in steps.
    troubles : mapping of str to (int, int)
        How often there is a ``"gap"``, a ``"repeat"`` or a ``"step back"``, and the row after the
        first of them, counted from 1.
    """

    name: str
    unit: str
    about: str
    first_s: float
    last_s: float
    rate_hz: float
    jitter: float
    troubles: Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class Inspection:
    """What is in a file, as far as it can be read.

    Parameters
    ----------
    source : str
        The file.
    rows : int
        Rows that were read.
    channels : tuple of ChannelFacts
        Every column, that of the clock among them.
    clock : ClockFacts or None
        The clock; None where no column looks like one.
    left_aside : mapping of str to str
        What is in the file and no column of the record, and why.
    fault : str
        The sentence that the reading ended with; empty where it went through.
    surges_s : tuple of float or None
        From when to when the machine surges, by the clock of the file; None where no part of the
        record stands out.
    """

    source: str
    rows: int
    channels: tuple[ChannelFacts, ...]
    clock: ClockFacts | None
    left_aside: dict[str, str]
    fault: str
    surges_s: tuple[float, float] | None = None

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
        Group and clock; without it the clock is found by its name, else by its steps.
    group : str, optional
        Group to look into, without a layout.

    Returns
    -------
    Inspection
        What was found before the end, or before what cannot be read.

    Raises
    ------
    InputError
        When nothing can be read.
    """
    chosen = layout if layout is not None else FileLayout(group=group)
    channels: list[ChannelFacts] = []
    sections: list[FloatArray] = []
    clock: _ClockTally | None = None
    rows, fault = 0, ""
    with open_stored(path, chosen, lenient=True) as stored:
        try:
            for block in _searched(stored.blocks(stored.names)):
                values = {
                    name: column.astype(np.float64)
                    for name, column in zip(stored.names, block, strict=True)
                }
                if rows == 0:
                    name = _clock_column(stored, values, chosen, named=layout is not None)
                    clock = None if name is None else _ClockTally(stored, name, chosen)
                if clock is not None:
                    time_s = clock.add(values[clock.name], rows)
                    others = [v for name, v in values.items() if name != clock.name]
                    sections += _sections(time_s, clock.usual_s, others)
                facts = [_facts(n, stored.unit(n), v, rows) for n, v in values.items()]
                channels = [_joined(*pair) for pair in zip(channels, facts, strict=False)] or facts
                rows += block[0].size
        except InputError as error:
            if rows == 0:
                raise
            fault = str(error)
    return Inspection(
        stored.source,
        rows,
        tuple(channels),
        None if clock is None else clock.facts(),
        dict(stored.left_aside),
        fault,
        _surging(np.concatenate(sections)) if sections else None,
    )


def _searched(blocks: Iterator[Columns]) -> Iterator[Columns]:
    """Yield the rows in blocks large enough to be searched; those before a fault come first."""
    kept: list[Columns] = []
    fault: InputError | None = None
    try:
        for block in blocks:
            kept.append(block)
            if sum(columns[0].size for columns in kept) >= SEARCHED_ROWS:
                yield tuple(map(np.concatenate, zip(*kept, strict=True)))
                kept = []
    except InputError as error:
        fault = error
    if sum(columns[0].size for columns in kept):
        yield tuple(map(np.concatenate, zip(*kept, strict=True)))
    if fault is not None:
        raise fault


def _clock_column(
    stored: StoredTable, values: Mapping[str, FloatArray], layout: FileLayout, *, named: bool
) -> str | None:
    """Return which column is the clock; None where none looks like one."""
    if layout.time in stored.names or named:
        return layout.time if layout.time in stored.names else None
    folded = {name.strip().lower(): name for name in stored.names}
    known = [folded[name] for name in CLOCK_NAMES if name in folded]
    rising = (name for name, column in values.items() if _rises_evenly(column))
    return next(iter((*known, *stored.dates, *rising)), None)


def _rises_evenly(values: FloatArray) -> bool:
    """Return whether a column rises, and by the same step nearly always."""
    steps = np.diff(values)
    if steps.size < 2 or not np.all(steps > 0.0):
        return False
    usual = float(np.median(steps))
    return bool(np.mean(np.abs(steps - usual) < 0.5 * usual) > 0.99)


class _ClockTally:
    """What is found of the clock from block to block."""

    def __init__(self, stored: StoredTable, name: str, layout: FileLayout) -> None:
        unit = (layout.time_unit if name == layout.time else None) or stored.unit(name)
        self.name, self.unit, self._conversion = name, "s", Conversion()
        if kind_of_unit(unit) == "time":
            self.unit, self._conversion = unit, conversion_to_si(unit, "time", name)
        self._about = stored.counts_from(name)
        self.usual_s = self._first_s = self._last_s = np.nan
        self._n_good, self._good_s, self._jitter = 0, 0.0, 0.0
        self._troubles: dict[str, tuple[int, int]] = {}

    def add(self, values: FloatArray, first_row: int) -> FloatArray:
        """Take the next rows of the column into account, and return their times in s."""
        time_s = self._conversion.to_si(values)
        # What is no number makes no step.
        steps = np.diff(time_s, prepend=self._last_s)
        self._last_s = float(time_s[-1])
        if first_row == 0:
            self._first_s = float(time_s[0])
            self.usual_s = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.nan
        is_gap = steps > GAP_STEPS * self.usual_s
        for kind, where in (("gap", is_gap), ("repeat", steps == 0.0), ("step back", steps < 0.0)):
            if where.any():
                n, first = self._troubles.get(kind, (0, first_row + int(np.argmax(where)) + 1))
                self._troubles[kind] = n + int(np.count_nonzero(where)), first
        good = steps[(steps > 0.0) & ~is_gap]
        self._n_good += good.size
        self._good_s += float(np.sum(good))
        off = np.abs(good - self.usual_s) / self.usual_s
        self._jitter = max(self._jitter, float(np.max(off, initial=0.0)))
        return time_s

    def facts(self) -> ClockFacts:
        """Return what was found."""
        rate_hz = self._n_good / self._good_s if self._good_s > 0.0 else np.nan
        ends_s = self._first_s, self._last_s
        return ClockFacts(
            self.name, self.unit, self._about, *ends_s, rate_hz, self._jitter, self._troubles
        )


def _facts(name: str, unit: str, values: FloatArray, first_row: int) -> ChannelFacts:
    """Return what some rows of a column hold."""
    good = np.isfinite(values)
    finite = values[good]
    low, high = (finite.min(), finite.max()) if finite.size else (np.nan, np.nan)
    starts = np.concatenate(([0], np.flatnonzero(values[1:] != values[:-1]) + 1))
    lengths = np.diff(np.concatenate((starts, [values.size])))
    still = np.where(np.isfinite(values[starts]), lengths, 0)
    longest = int(np.argmax(still))
    at_maximum, whole = int(np.count_nonzero(finite == high)), bool(np.all(finite % 1.0 == 0.0))
    plateaus: set[str] = set()
    if low < high:
        # The rules are those of a reduction; beside them the top code of a converter is known.
        plateaus = {"maximum" if end.upper else "minimum" for end in range_ends(finite)}
        if whole and at_maximum > 1 and high >= 255.0 and np.log2(high + 1.0) % 1.0 == 0.0:
            plateaus.add("maximum")
    with np.errstate(over="ignore"):
        mean = float(np.mean(finite)) if finite.size else np.nan
    return ChannelFacts(
        name,
        unit,
        values.size,
        values.size - finite.size,
        None if good.all() else first_row + int(np.argmin(good)) + 1,
        float(low),
        mean,
        float(high),
        int(np.count_nonzero(finite == low)),
        at_maximum,
        int(still[longest]),
        first_row + int(starts[longest]) + 1,
        finite.size > 0 and whole,
        tuple(sorted(plateaus, reverse=True)),
    )


def _joined(one: ChannelFacts, later: ChannelFacts) -> ChannelFacts:
    """Return what some rows of a column and those behind them hold together."""
    low, high = np.fmin(one.minimum, later.minimum), np.fmax(one.maximum, later.maximum)
    lowest = [part for part in (one, later) if part.minimum == low]
    highest = [part for part in (one, later) if part.maximum == high]
    longest = max((one, later), key=lambda part: part.longest_run)
    parts = [part for part in (one, later) if part.rows > part.not_finite]
    weights = [part.rows - part.not_finite for part in parts]
    return replace(
        one,
        rows=one.rows + later.rows,
        not_finite=one.not_finite + later.not_finite,
        first_not_finite=one.first_not_finite or later.first_not_finite,
        minimum=float(low),
        mean=float(np.average([p.mean for p in parts], weights=weights)) if parts else np.nan,
        maximum=float(high),
        at_minimum=sum(part.at_minimum for part in lowest),
        at_maximum=sum(part.at_maximum for part in highest),
        longest_run=longest.longest_run,
        longest_run_row=longest.longest_run_row,
        whole_numbers=all(part.whole_numbers for part in parts) and bool(parts),
        plateaus=tuple(
            end
            for end, ends in (("minimum", lowest), ("maximum", highest))
            if any(end in part.plateaus for part in ends)
        ),
    )


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
