"""The columns of a feed as the channels that test.toml describes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classic_ml.errors import InputError
from classic_ml.readers.raw_files import FeedColumn, feeds
from classic_ml.readers.raw_table import RawFile
from classic_ml.readers.test_description import TestDescription
from classic_ml.records import Channel, FloatArray, Record
from classic_ml.units import COUNT

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

    def impossible(self, readings: FloatArray) -> NDArray[np.bool_]:
        """Mark the rows for which the reader of raw files would refuse the whole record."""
        bad = np.zeros(len(readings), dtype=np.bool_)
        for channel, column in zip(self.channels, readings.T, strict=True):
            if channel.record_unit == COUNT:
                bad |= (column < 0) | (column > self.test.adc.top_code)
            elif channel.record_unit == "K":
                bad |= column <= 0.0
        return bad

    def _of(self, values: FloatArray, column: FeedColumn) -> FloatArray:
        readings: FloatArray = values[:, self.names.index(column.column)]
        return column.conversion.to_si(readings)


def feed_columns(names: tuple[str, ...], test: TestDescription) -> FeedColumns:
    """Check the header of a feed against the description of the test.

    Parameters
    ----------
    names : tuple of str
        Names of the columns.
    test : TestDescription
        The test.

    Raises
    ------
    InputError
        When the feed has no clock, lacks a channel, or has a column too many.
    """
    described = described_columns(test)
    clock, channels = described.clock, described.channels
    wanted = list(described.names)
    missing = [name for name in wanted if name not in names]
    extra = [name for name in names if name not in wanted]
    doubled = [name for name in names if names.count(name) > 1]
    if missing:
        raise InputError(
            f"{FEED}: column {missing[0]}",
            expected=f"it in the header, as {test.source} describes it",
            found="a header without it" + (f" and {len(missing) - 1} more" if missing[1:] else ""),
        )
    if doubled:
        raise InputError(
            f"{FEED}: column {doubled[0]}", expected="it once", found="it more often in the header"
        )
    if extra and test.file.other_columns == "refuse":
        raise InputError(
            f"{FEED}: column {extra[0]}",
            expected=f"a table [channels.{extra[0]}] in {test.source}",
            found="none" + (f" (nor for {len(extra) - 1} more)" if extra[1:] else ""),
            remedy='describe the channel, or write other_columns = "ignore" in [file]',
        )
    return FeedColumns(names, clock, channels, test)


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
    if test.file.clock != "column":
        raise InputError(
            f"{test.source}: [file] clock",
            expected='"column": rows of a feed are put in order by the clock they bring',
            found=f'"{test.file.clock}"',
        )
    clock, *channels = feeds(RawFile(FEED, (), lambda _: iter(())), test)
    names = (clock.column, *(channel.column for channel in channels))
    return FeedColumns(names, clock, tuple(channels), test)
