"""What is in a file of channels: clock, ranges, gaps, saturation, without holding its rows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from classic_ml.faults.held import held_rows
from classic_ml.faults.plateaus import LEAST_ROWS, range_ends
from classic_ml.inspection_clock import ClockFacts, ClockTally, clock_tally
from classic_ml.readers.raw_formats import open_stored
from classic_ml.readers.raw_table import RawFile
from classic_ml.readers.sampled_together import sampled_apart
from classic_ml.readers.test_description import FileLayout
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["ChannelFacts", "ClockFacts", "Inspection", "inspect_file", "is_still"]

# Rows that are read at once.
BLOCK_ROWS = 65_536
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
    clock: ClockTally | None = None
    rows, fault = 0, ""
    try:
        for block in stored.chunks(BLOCK_ROWS):
            if rows == 0:
                clock = clock_tally(stored, block, chosen, named=layout is not None)
            if clock is not None:
                clock.add(block[:, clock.column], rows)
            for number, tally in enumerate(tallies):
                tally.add(block[:, number], rows)
            rows += len(block)
    except InputError as error:
        if rows == 0:
            raise
        fault = str(error)
    plateaus, held = _plateaus_and_held(stored, tallies, rows)
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


def _plateaus_and_held(
    stored: RawFile, tallies: list[_Tally], n_rows: int
) -> tuple[dict[int, tuple[str, ...]], dict[int, float]]:
    """Return, by column, the ends at which it is cut off, and how many rows each value stands for.

    The rows are read once more, for both at once, where a column stands still at one of its ends
    or half of its values stand for several rows; the rules are those of a reduction.
    """
    candidates = [k for k, tally in enumerate(tallies) if tally.may_be_cut_off or tally.may_be_held]
    plateaus: dict[int, tuple[str, ...]] = {}
    held: dict[int, float] = {}
    blocks = [block[:, candidates] for block in _up_to(stored, n_rows)] if candidates else []
    for number, values in zip(candidates, np.concatenate(blocks).T if blocks else [], strict=True):
        readings = values[np.isfinite(values)]
        ends = range_ends(readings) if tallies[number].may_be_cut_off else ()
        plateaus[number] = tuple("maximum" if end.upper else "minimum" for end in ends)
        held[number] = held_rows(readings)
    for number, tally in enumerate(tallies):
        named = plateaus.get(number, ())
        if tally.at_top_code and "maximum" not in named:
            plateaus[number] = (*named, "maximum")
    return plateaus, held


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
        least = LEAST_ROWS
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
