"""The columns of a feed as the channels that test.toml describes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.description import TestDescription
from classic_ml.io import possible_ranges
from classic_ml.io.mapping import FeedColumn, check_columns, check_units, feeds
from classic_ml.io.table import RawFile, check_unique
from classic_ml.records import Channel, Record
from classic_ml.units import unit_in_brackets
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["FEED", "FeedColumns", "described_columns", "feed_columns"]

# What the feed is called in messages.
FEED = "the feed"


@dataclass(frozen=True)
class FeedColumns:
    """Which column of a feed is the clock, which ones the channels, and what they are in.

    Parameters
    ----------
    names : tuple of str
        Columns in the order of the feed.
    clock : FeedColumn
        The clock.
    channels : tuple of FeedColumn
        The channels, pressures first.
    test : TestDescription
        The test they belong to.
    """

    names: tuple[str, ...]
    clock: FeedColumn
    channels: tuple[FeedColumn, ...]
    test: TestDescription

    def time_s(self, values: FloatArray) -> FloatArray:
        """Return the clock of rows of shape (n, n_columns), in seconds."""
        return self._of(values, self.clock)

    def readings(self, values: FloatArray) -> FloatArray:
        """Return the channels as columns: counts, Pa and K."""
        return np.column_stack([self._of(values, channel) for channel in self.channels])

    def record(self, readings: FloatArray, start_s: float) -> Record:
        """Return rows of :meth:`readings` that follow one another as a record.

        Parameters
        ----------
        readings : ndarray of shape (n, n_channels)
            The channels.
        start_s : float
            Clock of the first row.
        """
        channels = {
            channel.name: Channel(channel.name, column, channel.record_unit)
            for channel, column in zip(self.channels, readings.T, strict=True)
        }
        return Record(channels, self.test.sample_rate_hz, start_s, FEED)

    def impossible(self, time_s: FloatArray, readings: FloatArray) -> NDArray[np.bool_]:
        """Mark the rows for which the reader of raw files would refuse the whole record."""
        names = tuple(channel.name for channel in self.channels)
        lowest, highest = possible_ranges(self.test, names)
        possible = np.isfinite(readings) & (readings >= lowest) & (readings <= highest)
        return np.asarray(~(possible.all(axis=1) & np.isfinite(time_s)))

    def _of(self, values: FloatArray, column: FeedColumn) -> FloatArray:
        readings: FloatArray = values[:, self.names.index(column.column)]
        return column.conversion.to_si(readings)


def feed_columns(
    names: tuple[str, ...], test: TestDescription, units: tuple[str, ...] = ()
) -> FeedColumns:
    """Check the header of a feed against the description of the test.

    Parameters
    ----------
    names : tuple of str
        Names of the columns.
    test : TestDescription
        The test.
    units : tuple of str
        Their units, where a line below the header states them.

    Raises
    ------
    InputError
        When the feed has no clock, lacks a channel, has a column too many, or one that
        states another unit than the test does.
    """
    table = _table(names, units)
    columns = _layout(table, test)
    check_columns(table, test, columns)
    check_unique(FEED, names)
    check_units(table, test, columns)
    return FeedColumns(names, columns[0], columns[1:], test)


def _table(names: tuple[str, ...], units: tuple[str, ...] = ()) -> RawFile:
    """Return a feed as a table of which nothing is known but names and units of its columns."""
    labels = units or tuple(map(unit_in_brackets, names))
    stated = {name: label for name, label in zip(names, labels, strict=True) if label}
    return RawFile(FEED, names, lambda *_: iter(()), stated)


def _layout(table: RawFile, test: TestDescription) -> tuple[FeedColumn, ...]:
    if test.file.clock != "column":
        raise InputError(
            f"{test.source}: [file] clock",
            expected='"column": rows of a feed are put in order by the clock they bring',
            found=f'"{test.file.clock}"',
        )
    return feeds(table, test)


def described_columns(test: TestDescription) -> FeedColumns:
    """Return the columns that the description of a test asks for, in its own order.

    Parameters
    ----------
    test : TestDescription
        The test.

    Raises
    ------
    InputError
        When it describes rows without a clock.
    """
    clock, *channels = _layout(_table(()), test)
    names = (clock.column, *(channel.column for channel in channels))
    return FeedColumns(names, clock, tuple(channels), test)
