"""What a file of channels is to a test.toml: mapping, ranges in SI, the reduction."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from classic_ml.calibration import total_reading
from classic_ml.description import AnyChannel, TestDescription
from classic_ml.inspect.facts import Inspection
from classic_ml.io.raw import MOST_VALUES, read_raw
from classic_ml.records import LedgerEntry
from classic_ml.reduction import reduce_record
from surge_core.errors import InputError


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
