"""What a file of channels is to a test.toml: mapping, ranges in SI, near stall, the reduction."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from classic_ml.calibration import probe_pressure_Pa
from classic_ml.description import PressureChannel, TestDescription
from classic_ml.inspect.facts import Inspection
from classic_ml.io.formats import open_stored
from classic_ml.io.mapping import Feed, feeds, nearest_name
from classic_ml.io.raw import MOST_VALUES, read_raw
from classic_ml.records import LedgerEntry, Record
from classic_ml.reduction import reduce_record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["ChannelMatch", "PairOrder", "TestMatch", "match_test"]


@dataclass(frozen=True)
class ChannelMatch:
    """A channel of test.toml, or the clock, and the column that feeds it.

    Parameters
    ----------
    channel : str
        Its name in test.toml.
    column : str
        Column of the file; empty for a clock that is made.
    present : bool
        Whether the file has it.
    why_not : str
        Why not, where the file says more than that; else a column of a similar name.
    stated_unit, unit : str
        Unit as the file states it, and as test.toml says.
    si_unit : str
        ``"Pa"``, ``"K"`` or ``"s"``.
    minimum, maximum : float
        Range of the readings in that unit; NaN where the column is missing.
    near_stall : float
        Mean over the near-stall interval; NaN where it could not be taken.
    facility : float
        What the facility read there; NaN for the clock.
    """

    channel: str
    column: str
    present: bool
    why_not: str
    stated_unit: str
    unit: str
    si_unit: str
    minimum: float
    maximum: float
    near_stall: float
    facility: float


@dataclass(frozen=True)
class PairOrder:
    """The forward probe of a pair above the aft one near stall.

    Parameters
    ----------
    pair : str
        Plane, rake, immersion.
    above_Pa : float
        Forward minus aft.
    """

    pair: str
    above_Pa: float

    @property
    def exchanged(self) -> bool:
        """Whether the aft probe reads no less than the forward one."""
        return not self.above_Pa > 0.0


@dataclass(frozen=True)
class TestMatch:
    """What a file is to a test.toml.

    Parameters
    ----------
    test : str
        The name of the test.
    channels : tuple of ChannelMatch
        The clock and the channels.
    left_over : tuple of str
        Columns that feed nothing.
    pairs : tuple of PairOrder
        Forward against aft, where both are there.
    refusal : str
        The sentence that the reduction would refuse the record with; the rest is empty then.
    window_s : tuple of float or None
        Quasi-steady cycles.
    history : tuple of LedgerEntry
        The ledger of its reduction.
    """

    # Not a test: it describes one.
    __test__ = False

    test: str
    channels: tuple[ChannelMatch, ...]
    left_over: tuple[str, ...]
    pairs: tuple[PairOrder, ...]
    refusal: str
    window_s: tuple[float, float] | None
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
    columns: tuple[Feed, ...] = ()
    means: dict[str, float] = {}
    refusal, found, history = "", None, tuple[LedgerEntry, ...]()
    too_long = inspection.rows * (len(test.channel_names) + 1) > MOST_VALUES
    window = inspection.surges_s if too_long and test.window_s is None else None
    try:
        with open_stored(raw_path, test.file, lenient=True) as stored:
            columns = feeds(stored, test)
        record, test = read_raw(raw_path, test, window=window)
        means = _near_stall_means(record, test)
        reduction = reduce_record(record, test, keep_probes=False)
        found, history = reduction.window_s, reduction.record.history
    except InputError as error:
        refusal = str(error)
    fed = {column.column for column in columns}
    left_over = tuple(c.name for c in inspection.channels if c.name not in fed)
    return TestMatch(
        test.name,
        tuple(_match(column, test, inspection, means, left_over) for column in columns),
        left_over,
        tuple(_pairs(test, means)),
        refusal,
        found,
        history,
    )


def _near_stall_means(record: Record, test: TestDescription) -> dict[str, float]:
    """Return the mean total pressure or temperature of each channel near stall, if it is there."""
    rows = record.rows_between(test.near_stall.from_s, test.near_stall.to_s)
    if rows.stop == rows.start:
        return {}
    # Every conversion is a straight line, so that the mean may be taken before it.
    means = {name: np.array([np.mean(record[name][rows])]) for name in test.channel_names}
    return {name: float(_total(name, mean, test)[0]) for name, mean in means.items()}


def _total(name: str, values: FloatArray, test: TestDescription) -> FloatArray:
    """Return readings of a channel as total pressures or temperatures."""
    channel = next((channel for channel in test.channels if channel.name == name), None)
    if channel is None:
        return values
    if isinstance(channel, PressureChannel):
        return probe_pressure_Pa(channel, test, values)
    return values / channel.recovery_factor


def _match(
    feed: Feed,
    test: TestDescription,
    inspection: Inspection,
    means: Mapping[str, float],
    left_over: tuple[str, ...],
) -> ChannelMatch:
    facts = inspection.channel(feed.column)
    low = high = facility = np.nan
    if facts is not None:
        ends = feed.conversion.to_si(np.array([facts.minimum, facts.maximum]))
        low, high = sorted(float(value) for value in _total(feed.name, ends, test))
    if feed.channel is not None:
        is_pressure = isinstance(feed.channel, PressureChannel)
        of_plane = test.near_stall.pressure_Pa if is_pressure else test.near_stall.temperature_K
        facility = of_plane(feed.channel.plane)
    present = facts is not None or not feed.column
    near = "" if present else nearest_name(feed.column, left_over)
    why_not = f"perhaps {near}" if near else ""
    for name, why in inspection.left_aside.items():
        if name.split("/")[-1] == feed.column:
            why_not = why
    return ChannelMatch(
        feed.name,
        feed.column,
        present,
        "" if present else why_not,
        facts.unit if facts is not None else "",
        feed.unit,
        "Pa" if feed.record_unit == "count" else feed.record_unit,
        low,
        high,
        means.get(feed.name, np.nan),
        facility,
    )


def _pairs(test: TestDescription, means: Mapping[str, float]) -> Iterator[PairOrder]:
    for plane in test.areas_m2:
        for pair in test.pairs(plane):
            if means:
                above_Pa = means[pair.forward.name] - means[pair.aft.name]
                yield PairOrder(f"P{pair.name}", above_Pa)
