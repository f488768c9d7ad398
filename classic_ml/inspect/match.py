"""What a file of channels is to a test.toml: mapping, ranges in SI, near stall, the reduction."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from classic_ml.calibration import probe_pressure_Pa
from classic_ml.description import AnyChannel, PressureChannel, TestDescription
from classic_ml.inspect.facts import Inspection
from classic_ml.io.raw import MOST_VALUES, read_raw
from classic_ml.records import LedgerEntry, Record
from classic_ml.reduction import reduce_record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["ChannelMatch", "TestMatch", "match_test"]


@dataclass(frozen=True)
class ChannelMatch:
    """A channel of test.toml, and the column that feeds it.

    Parameters
    ----------
    channel : str
        Its name in test.toml.
    column : str
        Column of the file.
    present : bool
        Whether the file has it.
    why_not : str
        Why not, where the file says more than that.
    unit : str
        Unit as test.toml says.
    si_unit : str
        ``"Pa"`` or ``"K"``.
    minimum, maximum : float
        Range of the readings in that unit; NaN where the column is missing.
    near_stall : float
        Mean over the near-stall interval; NaN where it could not be taken.
    facility : float
        What the facility read there.
    """

    channel: str
    column: str
    present: bool
    why_not: str
    unit: str
    si_unit: str
    minimum: float
    maximum: float
    near_stall: float
    facility: float


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
    above_Pa : mapping of str to float
        By pair, the forward probe above the aft one near stall; not above 0 where they are
        exchanged.
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
    above_Pa: Mapping[str, float]
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
    means: dict[str, float] = {}
    refusal, found, history = "", None, tuple[LedgerEntry, ...]()
    too_long = inspection.rows * (len(test.channel_names) + 1) > MOST_VALUES
    window = inspection.surges_s if too_long and test.window_s is None else None
    try:
        record, test = read_raw(raw_path, test, window=window)
        means = _near_stall_means(record, test)
        reduction = reduce_record(record, test, keep_probes=False)
        found, history = reduction.window_s, reduction.record.history
    except InputError as error:
        refusal = str(error)
    fed = {test.file.time, *(channel.file_column for channel in test.channels)}
    left_over = tuple(c.name for c in inspection.channels if c.name not in fed)
    return TestMatch(
        test.name,
        tuple(_match(channel, test, inspection, means) for channel in test.channels),
        left_over,
        dict(_pairs(test, means)),
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
    means = {}
    for channel in test.channels:
        mean = np.array([np.mean(record[channel.name][rows])])
        means[channel.name] = float(_total(channel, mean, test)[0])
    return means


def _total(channel: AnyChannel, values: FloatArray, test: TestDescription) -> FloatArray:
    """Return readings of a channel as total pressures or temperatures."""
    if isinstance(channel, PressureChannel):
        return probe_pressure_Pa(channel, test, values)
    return values / channel.recovery_factor


def _match(
    channel: AnyChannel,
    test: TestDescription,
    inspection: Inspection,
    means: Mapping[str, float],
) -> ChannelMatch:
    facts = inspection.channel(channel.file_column)
    low = high = np.nan
    why_not = ""
    if facts is not None:
        ends = channel.conversion.to_si(np.array([facts.minimum, facts.maximum]))
        low, high = sorted(float(value) for value in _total(channel, ends, test))
    else:
        for name, why in inspection.left_aside.items():
            if name.split("/")[-1] == channel.file_column:
                why_not = why
    is_pressure = isinstance(channel, PressureChannel)
    facility = test.near_stall.pressure_Pa if is_pressure else test.near_stall.temperature_K
    return ChannelMatch(
        channel.name,
        channel.file_column,
        facts is not None,
        why_not,
        channel.unit,
        "Pa" if is_pressure else "K",
        low,
        high,
        means.get(channel.name, np.nan),
        facility(channel.plane),
    )


def _pairs(test: TestDescription, means: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    for pair in (*test.pairs(25), *test.pairs(31)):
        if means:
            yield f"P{pair.name}", means[pair.forward.name] - means[pair.aft.name]
