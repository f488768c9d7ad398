"""What is in a file of channels: clock, ranges, gaps, saturation, and where the machine surges."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from classic_ml.description import FileLayout
from classic_ml.faults.held import held_rows
from classic_ml.faults.plateaus import range_ends
from classic_ml.inspect.clock import ClockFacts, ClockTally, clock_column
from classic_ml.inspect.surge import SurgeSearch
from classic_ml.io.formats import open_stored
from classic_ml.io.mapping import sampled_apart
from classic_ml.io.table import Columns, RawFile
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["ChannelFacts", "ClockFacts", "Inspection", "inspect_file", "is_still"]

# Rows that are looked at together: what is shorter than this is found whole.
SEARCHED_ROWS = 1 << 20
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
        that is not held, or moves too little to show it.
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
    other_groups: dict[str, str] = field(default_factory=dict)
    sampled_apart: str = ""
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
    stored = open_stored(path, chosen, lenient=True)
    channels: list[_Part] = []
    clock: ClockTally | None = None
    clock_at: int | None = None
    surge = SurgeSearch()
    rows, fault = 0, ""
    try:
        for block in _searched_blocks(stored):
            if rows == 0:
                clock_at = clock_column(stored, block, chosen, named=layout is not None)
                clock = None if clock_at is None else ClockTally(stored, clock_at, chosen)
            values = [column.astype(np.float64) for column in block]
            if clock is not None and clock_at is not None:
                time_s = clock.add(values[clock_at], rows)
                others = [v for number, v in enumerate(values) if number != clock_at]
                surge.add(time_s, clock.usual_s, others)
            parts = [_part_of(column, rows) for column in values]
            joined = [a.joined(b) for a, b in zip(channels, parts, strict=bool(channels))]
            channels = joined or parts
            rows += values[0].size
    except InputError as error:
        if rows == 0:
            raise
        fault = str(error)
    return Inspection(
        stored.source,
        rows,
        tuple(
            part.facts(name, stored.units.get(name, ""))
            for name, part in zip(stored.names, channels, strict=True)
        ),
        None if clock is None else clock.facts(),
        dict(stored.unusable),
        fault,
        dict(stored.other_groups),
        str(sampled_apart(stored, stored.names) or ""),
        surge.window_s(),
    )


def _searched_blocks(stored: RawFile) -> Iterator[Columns]:
    """Yield the rows in blocks large enough to be searched; those before a fault come first."""
    kept: list[Columns] = []
    fault: InputError | None = None
    blocks = stored.blocks()
    while fault is None:
        try:
            block = next(blocks, None)
        except InputError as error:
            block, fault = None, error
        if block is not None and block[0].size:
            kept.append(block)
        n_rows = sum(columns[0].size for columns in kept)
        if n_rows and (block is None or n_rows >= SEARCHED_ROWS):
            yield tuple(np.concatenate(parts) for parts in zip(*kept, strict=True))
            kept = []
        if block is None:
            break
    if fault is not None:
        raise fault


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


@dataclass(frozen=True)
class _Part:
    """What some rows of a column hold; `ChannelFacts` says what the fields are."""

    rows: int
    not_finite: int
    first_not_finite: int | None
    minimum: float
    total: float
    maximum: float
    at_minimum: int
    at_maximum: int
    run_at_minimum: int
    run_at_maximum: int
    longest_run: int
    longest_run_row: int
    whole_numbers: bool
    # Ends of the range at which these rows are cut off.
    cut_off: frozenset[float]
    held_rows: float

    def joined(self, later: _Part) -> _Part:
        """Return what these rows and those behind them hold together."""
        low, high = min(self.minimum, later.minimum), max(self.maximum, later.maximum)
        lowest = [part for part in (self, later) if part.minimum == low]
        highest = [part for part in (self, later) if part.maximum == high]
        longest = max((self, later), key=lambda part: part.longest_run)
        return replace(
            self,
            rows=self.rows + later.rows,
            not_finite=self.not_finite + later.not_finite,
            first_not_finite=self.first_not_finite or later.first_not_finite,
            minimum=low,
            total=self.total + later.total,
            maximum=high,
            at_minimum=sum(part.at_minimum for part in lowest),
            at_maximum=sum(part.at_maximum for part in highest),
            run_at_minimum=max((part.run_at_minimum for part in lowest), default=0),
            run_at_maximum=max((part.run_at_maximum for part in highest), default=0),
            longest_run=longest.longest_run,
            longest_run_row=longest.longest_run_row,
            whole_numbers=self.whole_numbers and later.whole_numbers,
            cut_off=self.cut_off | later.cut_off,
            # A channel that is held is so throughout.
            held_rows=min(self.held_rows, later.held_rows),
        )

    def facts(self, name: str, unit: str) -> ChannelFacts:
        """Return what was found."""
        finite = self.rows - self.not_finite
        ends = {"minimum": self.minimum, "maximum": self.maximum}
        plateaus = [end for end, reading in ends.items() if reading in self.cut_off]
        at_top_code = self.whole_numbers and self.maximum in _TOP_CODES and self.at_maximum > 1
        if at_top_code and self.minimum < self.maximum and "maximum" not in plateaus:
            plateaus.append("maximum")
        return ChannelFacts(
            name,
            unit,
            self.rows,
            self.not_finite,
            self.first_not_finite,
            self.minimum if finite else np.nan,
            self.total / finite if finite else np.nan,
            self.maximum if finite else np.nan,
            self.at_minimum,
            self.at_maximum,
            self.run_at_minimum,
            self.run_at_maximum,
            self.longest_run,
            self.longest_run_row,
            finite > 0 and self.whole_numbers,
            tuple(plateaus),
            self.held_rows,
        )


def _part_of(values: FloatArray, first_row: int) -> _Part:
    """Return what some rows of a column hold."""
    good = np.isfinite(values)
    finite = values[good]
    low, high = (finite.min(), finite.max()) if finite.size else (np.inf, -np.inf)
    starts = np.concatenate(([0], np.flatnonzero(values[1:] != values[:-1]) + 1))
    lengths = np.diff(np.concatenate((starts, [values.size])))
    heads = values[starts]
    still = np.where(np.isfinite(heads), lengths, 0)
    longest = int(np.argmax(still))
    with np.errstate(over="ignore"):
        total = float(np.sum(finite))
    cut_off: frozenset[float] = frozenset()
    held = 1.0
    if low < high:
        # The rules are those of a reduction.
        cut_off = frozenset(end.reading for end in range_ends(finite))
        # At least half of the values of a channel that is held stand for several rows.
        if 2 * np.count_nonzero(lengths > 1) >= lengths.size:
            held = held_rows(finite)
    return _Part(
        values.size,
        values.size - finite.size,
        None if good.all() else first_row + int(np.argmin(good)) + 1,
        float(low),
        total,
        float(high),
        int(np.count_nonzero(finite == low)),
        int(np.count_nonzero(finite == high)),
        int(np.max(lengths[heads == low], initial=0)),
        int(np.max(lengths[heads == high], initial=0)),
        int(still[longest]),
        first_row + int(starts[longest]) + 1,
        bool(np.all(finite == np.rint(finite))),
        cut_off,
        held,
    )
