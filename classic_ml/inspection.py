"""What is in a file of channels: clock, ranges, gaps, saturation, without holding its rows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from classic_ml.columns.workspace import BLOCK_ROWS
from classic_ml.errors import InputError
from classic_ml.faults.held import held_in_chunks
from classic_ml.faults.plateaus import LEAST_TIMES, REACH, EndSearch
from classic_ml.readers.passed_over_clock import CLOCK_NAMES
from classic_ml.readers.raw_formats import open_stored
from classic_ml.readers.raw_table import RawFile
from classic_ml.readers.sampled_together import sampled_apart
from classic_ml.readers.test_description import FileLayout
from classic_ml.records import FloatArray
from classic_ml.units import Conversion, time_conversion

__all__ = ["ChannelFacts", "ClockFacts", "Inspection", "inspect_file", "is_still"]

# A step this much longer than the usual one is a gap: 1.5 leaves room for any jitter below.
GAP_STEPS = 1.5
# A surging machine moves every probe by many counts in 50 ms; what stands still longer is named,
# whatever the rate from so many rows on.
STILL_S = 0.05
STILL_ROWS = 50
STILL_LEAST_ROWS = 5
# Highest codes of converters, unsigned and signed; a channel that reaches one twice may be clipped.
_TOP_CODES = frozenset(2**bits - 1 for bits in (8, 10, 12, 14, 16, 18, 20, 24)) | frozenset(
    2 ** (bits - 1) - 1 for bits in (12, 14, 16, 18, 20, 24)
)


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
    run_at_minimum, run_at_maximum : int
        The longest run of rows there.
    longest_run, longest_run_row : int
        The longest run of one value, and its first row, counted from 1.
    whole_numbers : bool
        Whether all values are whole, as codes are.
    plateaus : tuple of str
        Ends of its range at which it is cut off: ``"minimum"``, ``"maximum"``.
    held_rows : float
        Rows that each value stands for, on average where it is no whole number; 1 for a channel
        that is not held, or of which nobody can tell.
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
    run_at_minimum: int
    run_at_maximum: int
    longest_run: int
    longest_run_row: int
    whole_numbers: bool
    plateaus: tuple[str, ...] = ()
    held_rows: float = 1.0

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
        What it is where it is no column of times.
    first_s, last_s : float
        Its ends.
    rate_hz : float
        Rows a second, over the steps that are neither gaps nor back; NaN without any.
    jitter : float
        The largest deviation of these from the usual step, in steps.
    gaps, repeats, steps_back : int
        How often it jumps, stands still and runs back.
    first_gap, first_repeat, first_step_back : int or None
        The row after the first of them, counted from 1.
    """

    name: str
    unit: str
    about: str
    first_s: float
    last_s: float
    rate_hz: float
    jitter: float
    gaps: int
    repeats: int
    steps_back: int
    first_gap: int | None
    first_repeat: int | None
    first_step_back: int | None


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
    other_groups : mapping of str to str
        Groups of the file of which there is nothing in the record, and what they hold.
    sampled_apart : str
        Which channels the file says were not sampled together; empty where it says nothing so.
    """

    source: str
    rows: int
    channels: tuple[ChannelFacts, ...]
    clock: ClockFacts | None
    left_aside: dict[str, str]
    fault: str
    other_groups: dict[str, str] = field(default_factory=dict)
    sampled_apart: str = ""

    def channel(self, name: str) -> ChannelFacts | None:
        """Return one column, or None where there is none of that name."""
        return next((channel for channel in self.channels if channel.name == name), None)


def inspect_file(
    path: str | os.PathLike[str], layout: FileLayout | None = None, *, group: str | None = None
) -> Inspection:
    """Look through a file of channels, chunk by chunk.

    Parameters
    ----------
    path : str or path
        A raw record or a series of any format that there is a reader for.
    layout : FileLayout, optional
        Group and clock; without it the clock is told by its name, else by its steps.
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
    stored = open_stored(path, chosen, lenient=True)
    tallies = [_Tally() for _ in stored.names]
    clock: _ClockTally | None = None
    rows, fault = 0, ""
    try:
        for block in stored.chunks(BLOCK_ROWS):
            if rows == 0:
                clock = _clock_tally(stored, block, chosen, named=layout is not None)
            if clock is not None:
                clock.add(block[:, clock.column], rows)
            for number, tally in enumerate(tallies):
                tally.add(block[:, number], rows)
            rows += len(block)
    except InputError as error:
        if rows == 0:
            raise
        fault = str(error)
    plateaus, held = _plateaus(stored, tallies, rows), _held_rows(stored, tallies, rows)
    return Inspection(
        stored.source,
        rows,
        tuple(
            tally.facts(
                name,
                stored.units.get(name, ""),
                rows,
                plateaus.get(number, ()),
                held.get(number, 1.0),
            )
            for number, (name, tally) in enumerate(zip(stored.names, tallies, strict=True))
        ),
        None if clock is None else clock.facts(),
        dict(stored.unusable),
        fault,
        dict(stored.other_groups),
        str(sampled_apart(stored, stored.names) or ""),
    )


def is_still(channel: ChannelFacts, rate_hz: float) -> bool:
    """Tell whether a channel repeats one value for longer than a surging machine lets any.

    Parameters
    ----------
    channel : ChannelFacts
        The column.
    rate_hz : float
        Rows a second; NaN or 0 where it is not known.
    """
    rows = STILL_S * rate_hz if rate_hz > 0.0 else STILL_ROWS
    return channel.longest_run >= max(STILL_LEAST_ROWS, rows)


def _plateaus(stored: RawFile, tallies: list[_Tally], n_rows: int) -> dict[int, tuple[str, ...]]:
    """Return, by column, the ends of its range at which it is cut off.

    The rows are read once more where a column stands still at one of its ends, by the same rule
    as in a reduction.
    """
    searches = {
        number: EndSearch(n_rows, tally.minimum, tally.maximum, tally.least_step)
        for number, tally in enumerate(tallies)
        if tally.may_be_cut_off
    }
    if searches:
        kept, first = np.empty((0, len(tallies))), 0
        for block in _up_to(stored, n_rows):
            kept = np.concatenate((kept, block))
            last = first + len(kept)
            stop = last if last == n_rows else last - REACH
            if stop <= first:
                continue
            for number, search in searches.items():
                search.follow(np.ascontiguousarray(kept[:, number]), first, stop)
            behind = max(0, stop - REACH)
            kept, first = kept[behind - first :], behind
    found = {
        number: tuple("maximum" if end.upper else "minimum" for end in search.ends)
        for number, search in searches.items()
    }
    for number, tally in enumerate(tallies):
        ends = found.get(number, ())
        if tally.at_top_code and "maximum" not in ends:
            found[number] = (*ends, "maximum")
    return found


def _held_rows(stored: RawFile, tallies: list[_Tally], n_rows: int) -> dict[int, float]:
    """Return, by column, how many rows each value stands for, where that may be more than one.

    The rows are read once more where half of the values of a column stand for several.
    """
    steps = {number: tally.least_step for number, tally in enumerate(tallies) if tally.may_be_held}
    return held_in_chunks(_up_to(stored, n_rows), steps) if steps else {}


def _up_to(stored: RawFile, n_rows: int) -> Iterator[FloatArray]:
    """Yield the rows that could be read before."""
    rows = 0
    for block in stored.chunks(BLOCK_ROWS):
        yield np.where(np.isfinite(block), block, np.nan)
        rows += len(block)
        if rows >= n_rows:
            return


@dataclass
class _Tally:
    """What is kept of a column from chunk to chunk."""

    total: float = 0.0
    finite: int = 0
    first_not_finite: int | None = None
    minimum: float = np.inf
    maximum: float = -np.inf
    at_minimum: int = 0
    at_maximum: int = 0
    run_at_minimum: int = 0
    run_at_maximum: int = 0
    longest_run: int = 0
    longest_run_row: int = 1
    whole_numbers: bool = True
    least_step: float = np.inf
    runs: int = 0
    long_runs: int = 0
    run_value: float = np.nan
    run_length: int = 0

    def add(self, values: FloatArray, first_row: int) -> None:
        """Take the next rows into account."""
        good = np.isfinite(values)
        if not good.all() and self.first_not_finite is None:
            self.first_not_finite = first_row + int(np.argmin(good)) + 1
        finite = values if good.all() else values[good]
        if finite.size:
            self._extremes(finite)
            self.total += float(np.sum(finite))
            self.finite += finite.size
            self.whole_numbers = self.whole_numbers and bool(np.all(finite == np.rint(finite)))
        self._runs(values, first_row)

    @property
    def may_be_cut_off(self) -> bool:
        """Whether it stands still at one of its ends so often that a search is worth while."""
        ends = (
            (self.at_minimum, self.run_at_minimum),
            (self.at_maximum, self.run_at_maximum),
        )
        least = 2 * LEAST_TIMES
        return self.minimum < self.maximum and any(at >= least and run > 1 for at, run in ends)

    @property
    def may_be_held(self) -> bool:
        """Whether at least half of its values stand for some rows."""
        return self.minimum < self.maximum and 2 * self.long_runs >= self.runs

    @property
    def at_top_code(self) -> bool:
        """Whether it reaches what is the highest code of a converter more than once."""
        top = self.minimum < self.maximum and self.whole_numbers and self.maximum in _TOP_CODES
        return top and self.at_maximum > 1

    def _extremes(self, finite: FloatArray) -> None:
        low, high = float(np.min(finite)), float(np.max(finite))
        if low < self.minimum:
            self.minimum, self.at_minimum, self.run_at_minimum = low, 0, 0
        if high > self.maximum:
            self.maximum, self.at_maximum, self.run_at_maximum = high, 0, 0
        self.at_minimum += int(np.count_nonzero(finite == self.minimum))
        self.at_maximum += int(np.count_nonzero(finite == self.maximum))

    def _runs(self, values: FloatArray, first_row: int) -> None:
        """Follow the runs of one value, the last of a chunk into the next one."""
        with np.errstate(invalid="ignore"):
            steps = np.abs(np.diff(values, prepend=self.run_value))
        least = np.min(steps, where=steps > 0.0, initial=np.inf)
        self.least_step = min(self.least_step, float(least))
        starts = np.concatenate(([0], np.flatnonzero(values[1:] != values[:-1]) + 1))
        lengths = np.diff(np.concatenate((starts, [values.size])))
        carried = self.run_length if values[0] == self.run_value else 0
        lengths[0] += carried
        self.runs += lengths.size
        self.long_runs += int(np.count_nonzero(lengths > 1))
        heads = values[starts]
        longest = int(np.argmax(np.where(np.isnan(heads), 0, lengths)))
        if lengths[longest] > self.longest_run and np.isfinite(heads[longest]):
            self.longest_run = int(lengths[longest])
            self.longest_run_row = first_row + int(starts[longest]) + 1
            self.longest_run_row -= carried if longest == 0 else 0
        for extreme, name in ((self.minimum, "run_at_minimum"), (self.maximum, "run_at_maximum")):
            there = lengths[heads == extreme]
            if there.size:
                setattr(self, name, max(getattr(self, name), int(np.max(there))))
        self.run_value, self.run_length = float(heads[-1]), int(lengths[-1])

    def facts(
        self, name: str, unit: str, rows: int, plateaus: tuple[str, ...], held_rows: float
    ) -> ChannelFacts:
        """Return what was found."""
        some = self.finite > 0
        return ChannelFacts(
            name,
            unit,
            rows,
            rows - self.finite,
            self.first_not_finite,
            self.minimum if some else np.nan,
            self.total / self.finite if some else np.nan,
            self.maximum if some else np.nan,
            self.at_minimum,
            self.at_maximum,
            self.run_at_minimum,
            self.run_at_maximum,
            self.longest_run,
            self.longest_run_row,
            some and self.whole_numbers,
            plateaus,
            held_rows,
        )


def _clock_tally(
    stored: RawFile, block: FloatArray, layout: FileLayout, *, named: bool
) -> _ClockTally | None:
    """Return a tally for the column that is the clock, with its usual step."""
    column = _clock_column(stored, block, layout, named=named)
    if column is None:
        return None
    name = stored.names[column]
    unit = (layout.time_unit if name == layout.time else None) or stored.units.get(name, "") or "s"
    try:
        conversion = time_conversion(unit, name)
    except InputError:
        conversion, unit = Conversion(), "s"
    steps = np.diff(conversion.to_si(block[:, column]))
    steps = steps[np.isfinite(steps) & (steps > 0.0)]
    usual = float(np.median(steps)) if steps.size else np.nan
    about = stored.stamps.get(name, stored.clock if name == layout.time else "")
    return _ClockTally(column, name, unit, about, conversion, usual)


def _clock_column(
    stored: RawFile, block: FloatArray, layout: FileLayout, *, named: bool
) -> int | None:
    if layout.time in stored.names:
        return stored.names.index(layout.time)
    if named:
        return None
    folded = [name.strip().lower() for name in stored.names]
    for name in CLOCK_NAMES:
        if name in folded:
            return folded.index(name)
    if stored.stamps:
        return stored.names.index(next(iter(stored.stamps)))
    for number in range(len(stored.names)):
        steps = np.diff(block[:, number])
        # A clock rises, and by the same step nearly always.
        if steps.size > 1 and np.all(steps > 0.0):
            usual = float(np.median(steps))
            if np.mean(np.abs(steps - usual) < 0.5 * usual) > 0.99:
                return number
    return None


@dataclass
class _ClockTally:
    """What is kept of the clock from chunk to chunk."""

    column: int
    name: str
    unit: str
    about: str
    conversion: Conversion
    usual_s: float
    first_s: float = np.nan
    last_s: float = np.nan
    good_steps: int = 0
    good_time_s: float = 0.0
    jitter: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    firsts: dict[str, int] = field(default_factory=dict)

    def add(self, values: FloatArray, first_row: int) -> None:
        """Take the next rows into account."""
        time_s = self.conversion.to_si(values)
        rows = first_row + 1 + np.flatnonzero(np.isfinite(time_s))
        time_s = time_s[np.isfinite(time_s)]
        if time_s.size == 0:
            return
        if np.isnan(self.first_s):
            self.first_s = float(time_s[0])
        else:
            time_s = np.concatenate(([self.last_s], time_s))
            rows = np.concatenate(([first_row], rows))
        self.last_s = float(time_s[-1])
        steps = np.diff(time_s)
        kinds = {
            "gap": steps > GAP_STEPS * self.usual_s,
            "repeat": steps == 0.0,
            "step_back": steps < 0.0,
        }
        good = ~(kinds["gap"] | kinds["repeat"] | kinds["step_back"])
        self.good_steps += int(np.count_nonzero(good))
        self.good_time_s += float(np.sum(steps[good]))
        if good.any():
            off = np.max(np.abs(steps[good] - self.usual_s)) / self.usual_s
            self.jitter = max(self.jitter, float(off))
        for kind, where in kinds.items():
            count = int(np.count_nonzero(where))
            self.counts[kind] = self.counts.get(kind, 0) + count
            if count and kind not in self.firsts:
                self.firsts[kind] = int(rows[1:][np.argmax(where)])

    def facts(self) -> ClockFacts:
        """Return what was found."""
        return ClockFacts(
            self.name,
            self.unit,
            self.about,
            self.first_s,
            self.last_s,
            self.good_steps / self.good_time_s if self.good_time_s > 0.0 else np.nan,
            self.jitter,
            self.counts.get("gap", 0),
            self.counts.get("repeat", 0),
            self.counts.get("step_back", 0),
            self.firsts.get("gap"),
            self.firsts.get("repeat"),
            self.firsts.get("step_back"),
        )
