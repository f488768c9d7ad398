"""Readings cut off at an end of the range, told from a channel by itself: no converter is known.

A transducer, an amplifier or the software behind it holds what is beyond its range at the last
value that it can give. In a channel of a physical unit nothing says where that is, but it shows:

- readings stand bit-equal at the channel's own extreme, several separate times;
- they arrive there and leave at full speed, many steps of the resolution away, as those around
  the peak of a smooth signal do not: one that stays within a step of its peak for L rows is no more
  than five steps below it another (L - 1)/2 rows away;
- hardly any lie a few steps short of the extreme, where a slow or a noisy signal has most;
- and the channel stands still like that nowhere else, as one does that is held, interpolated or
  coarse.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.columns.compiled_as_written import as_written
from classic_ml.columns.workspace import IN_MEMORY, Workspace, blocks
from classic_ml.description import TestDescription
from classic_ml.faults.standstill import Tally
from classic_ml.records import Record
from surge_core.types import FloatArray, IntArray

__all__ = ["LEAST_TIMES", "REACH", "End", "EndSearch", "cut_off_ends", "ends_of_ranges"]


# Times that a channel must be seen to be cut off for two rows or more. Some of them are longer, or
# single readings reach the extreme too: in a signal that repeats itself exactly, two readings
# on either side of the peak may be alike again and again.
LEAST_TIMES, LEAST_LONG, LONG_ROWS, LEAST_SINGLE = 3, 2, 3, 3
# Between two times, and on either side of one, so many rows are somewhere else.
APART_ROWS, REACH = 3, 4
# In steps of the resolution, and half a one, so that no rounding decides: readings within the
# first are near the extreme; by the second a run is arrived at and left.
NEAR_STEPS, RISE_STEPS = 8.5, 5.5
# A jump of so many times what the four rows before it moved is a dropout, or the step of a channel
# that is held.
LEAP = 2.0
# Of its slope, a line between two readings of a slower recorder is as straight as that.
STRAIGHT = 1e-6
# So many runs elsewhere for each time at the extreme, and they tell nothing.
ELSEWHERE = 0.5


@dataclass(frozen=True)
class End:
    """An end of the range, at which the readings of a channel are cut off.

    Parameters
    ----------
    reading : float
        The channel's largest or least reading.
    upper : bool
        Whether it is the largest.
    rows : int
        How many readings stand there.
    times : int
        How many separate times they are plainly cut off.
    """

    reading: float
    upper: bool
    rows: int
    times: int

    def beyond(self, readings: FloatArray) -> NDArray[np.bool_]:
        """Tell which readings stand there."""
        return readings >= self.reading if self.upper else readings <= self.reading


def ends_of_ranges(
    record: Record, test: TestDescription, found: Mapping[str, Tally]
) -> tuple[dict[str, tuple[End, ...]], list[str]]:
    """Return where channels of a physical unit are cut off.

    Parameters
    ----------
    record : Record
        As read.
    test : TestDescription
        Its channels. Where ``limits`` says which readings of one count, it is believed.
    found : mapping of str to Tally
        Of all channels.

    Returns
    -------
    dict of str to tuple of End
        By channel, of those that are; none of counts, whose converter is known.
    list of str
        A flag for each channel whose limits let such readings count.
    """
    counts = {probe.name for probe in test.pressures if probe.record_unit == "count"}
    ends: dict[str, tuple[End, ...]] = {}
    flags = []
    for name in test.channel_names:
        if name in counts:
            continue
        tally, place = found[name], record.workspace
        here = cut_off_ends(record[name], tally.low, tally.high, tally.least_step, workspace=place)
        if here and name not in test.limits:
            ends[name] = here
        for end in here if name in test.limits else ():
            low, high = test.limits[name]
            if low < end.reading < high:
                flags.append(
                    f"{name}: {end.rows} rows at its {'largest' if end.upper else 'least'} reading "
                    f"of {end.reading:.6g} {record.channel(name).unit}, where it stands still "
                    f"again and again: does its range end there? [limits] of {test.source} lets "
                    "them count"
                )
    return ends, flags


def cut_off_ends(
    values: FloatArray,
    low: float,
    high: float,
    least_step: float,
    *,
    workspace: Workspace = IN_MEMORY,
) -> tuple[End, ...]:
    """Return the ends of its range at which a channel is cut off.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The channel.
    low, high : float
        Its least and its largest reading.
    least_step : float
        Least change from row to row that is one: its resolution.
    workspace : Workspace
        Where the column lies.

    Returns
    -------
    tuple of End
        None, one or two.
    """
    if not low < high:
        return ()
    n_rows = values.size
    search = EndSearch(n_rows, low, high, least_step)
    for rows in blocks(n_rows):
        first = max(0, rows.start - REACH)
        search.follow(values[first : rows.stop + REACH], first, rows.stop)
        workspace.release()
    return search.ends


class EndSearch:
    """The search for the ends of a range, block by block.

    Parameters
    ----------
    n_rows : int
        Rows of the channel.
    low, high : float
        Its least and its largest reading.
    least_step : float
        Least change from row to row that is one: its resolution.
    """

    def __init__(self, n_rows: int, low: float, high: float, least_step: float) -> None:
        self._n_rows, self._step = n_rows, least_step
        self._extremes = np.array([low, high])
        self._counts = np.zeros((2, 6), dtype=np.int64)
        self._counts[:, 5] = -APART_ROWS
        self._carried, self._lead = np.array([1, 0, 0]), np.full(REACH, np.nan)

    def follow(self, values: FloatArray, first: int, stop: int) -> None:
        """Go on to a row.

        Parameters
        ----------
        values : ndarray of shape (m,)
            Rows of the channel, NaN without a reading: from `REACH` before the row where the last
            call stopped, up to `REACH` behind the one where this stops; at the ends of the record
            as many as there are.
        first : int
            Row of the first of them.
        stop : int
            Where to stop.
        """
        state = (self._extremes, self._step, self._counts, self._carried, self._lead)
        _follow(values, first, stop, self._n_rows, *state)

    @property
    def ends(self) -> tuple[End, ...]:
        """What was found."""
        elsewhere = int(self._carried[2])
        return tuple(
            End(float(self._extremes[end]), bool(end), int(at), int(times))
            for end, (at, near, times, long, single, _) in enumerate(self._counts)
            if times >= LEAST_TIMES
            and (long >= LEAST_LONG or single >= LEAST_SINGLE)
            and at > near
            and elsewhere <= ELSEWHERE * times
        )


@as_written
def _follow(
    values: FloatArray,
    first: int,
    stop: int,
    n_rows: int,
    extremes: FloatArray,
    step: float,
    counts: IntArray,
    carried: IntArray,
    lead: FloatArray,
) -> None:
    """Count the runs of equal readings that end before a row of a channel.

    Parameters
    ----------
    values : ndarray of shape (m,)
        Rows of the channel, `REACH` before those of a block and `REACH` behind them.
    first : int
        Row of the first of them.
    stop : int
        Where the block ends; the next call goes on there. What the record ends with is left by
        nothing, and tells nothing.
    n_rows : int
        Rows of the whole channel.
    extremes : ndarray of shape (2,)
        Its least and its largest reading.
    step : float
        Its resolution.
    counts : ndarray of int64, shape (2, 6)
        For each extreme: readings there, readings near it, times that it is cut off there for two
        rows or more, those of three or more, single readings, and the row behind the last time.
    carried : ndarray of int64, shape (3,)
        The row to look at next, where the run begins that it may continue, and how many runs like
        those at the extremes were elsewhere.
    lead : ndarray of shape (REACH,)
        The readings before that run, the nearest first.
    """
    row, start, elsewhere = carried
    low, high = extremes
    low_near, high_near = low + NEAR_STEPS * step, high - NEAR_STEPS * step
    n_low, n_high, n_low_near, n_high_near = 0, 0, 0, 0
    # Of a part from its own first row on, no index can be below zero, which the compiler must know.
    part = values[row - 1 - first : stop - first - (1 if stop < n_rows else 0)]
    for k in range(part.size):
        value = part[k]
        n_low += value == low
        n_high += value == high
        n_low_near += low < value <= low_near
        n_high_near += high > value >= high_near
    counts[0, 0] += n_low
    counts[1, 0] += n_high
    counts[0, 1] += n_low_near
    counts[1, 1] += n_high_near
    level = values[row - 1 - first]
    while row < stop:
        value = values[row - first]
        if value == level:
            row += 1
            continue
        length = row - start
        end = 0 if level == low else 1 if level == high else -1
        if end >= 0 and length == 1:
            counts[end, 4] += 1
        elif end >= 0 and length > 1 and start - counts[end, 5] >= APART_ROWS:
            if _is_cut_off(values, first, start, row, n_rows, lead, step):
                counts[end, 2] += 1
                counts[end, 3] += length >= LONG_ROWS
                counts[end, 5] = row
        elif end < 0 and length >= LONG_ROWS:
            elsewhere += _is_cut_off(values, first, start, row, n_rows, lead, step)
        start, level = row, value
        row += 1
    if start - first >= REACH:
        for k in range(REACH):
            lead[k] = values[start - 1 - k - first]
    carried[0], carried[1], carried[2] = row, start, elsewhere


@as_written
def _is_cut_off(
    values: FloatArray,
    first: int,
    start: int,
    stop: int,
    n_rows: int,
    lead: FloatArray,
    step: float,
) -> bool:
    """Tell whether a signal would go on where a run of equal readings stands, on either side."""
    if start < REACH or stop + REACH > n_rows:
        return False
    level = values[stop - 1 - first]
    away = max(1, min((stop - start - 1) // 2, REACH))
    straight = True
    for before in (True, False):
        jump = least = largest = nearer = 0.0
        for k in range(REACH):
            if not before:
                value = values[stop + k - first]
            elif start - first >= REACH:
                value = values[start - 1 - k - first]
            else:
                value = lead[k]
            # What is not a number fulfils no condition.
            if k == away - 1 and not abs(value - level) > RISE_STEPS * step:
                return False
            if k == 0:
                jump, least, largest = value - level, value, value
            else:
                least, largest = min(least, value), max(largest, value)
                straight &= abs(value - nearer - jump) <= STRAIGHT * abs(jump)
            nearer = value
        if not abs(jump) <= LEAP * (largest - least):
            return False
    return not straight
