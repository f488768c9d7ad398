"""What a file of channels is to a test.toml: mapping, ranges in SI, near stall, the reduction."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from classic_ml.calibration import probe_pressure_Pa
from classic_ml.description import TestDescription
from classic_ml.inspect.facts import Inspection
from classic_ml.io.formats import open_stored
from classic_ml.io.mapping import FeedColumn, feeds, nearest_names
from classic_ml.io.raw import MOST_VALUES, near_stall_means, read_raw
from classic_ml.records import Record
from classic_ml.reduction import reduce_record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["ChannelMatch", "PairOrder", "ReductionPreview", "TestMatch", "match_test", "preview"]


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
        Why not, where the file says more than that; else columns of a similar name.
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
class ReductionPreview:
    """What `sindy-surge reduce` would make of the record.

    Parameters
    ----------
    refusal : str
        The sentence that it would refuse the record with; the rest is empty then.
    window_s : tuple of float or None
        Quasi-steady cycles.
    cycles : int or None
        How many, where they were found rather than named.
    steps : tuple of str
        What each step says of itself.
    dropped : tuple of str
        What would be left out, and why.
    flags : tuple of str
        Warnings.
    """

    refusal: str
    window_s: tuple[float, float] | None = None
    cycles: int | None = None
    steps: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()


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
    refusal : str
        Why the file and test.toml do not go together; empty where they do.
    pairs : tuple of PairOrder
        Forward against aft, where both are there.
    """

    # Not a test: it describes one.
    __test__ = False

    test: str
    channels: tuple[ChannelMatch, ...]
    left_over: tuple[str, ...]
    refusal: str
    pairs: tuple[PairOrder, ...]


def match_test(
    raw_path: str | os.PathLike[str], test: TestDescription, inspection: Inspection
) -> TestMatch:
    """Set a file beside the description of its test.

    Parameters
    ----------
    raw_path : str or path
        The file.
    test : TestDescription
        The description.
    inspection : Inspection
        What :func:`classic_ml.inspect.inspect_file` found in it with ``test.file``.

    Returns
    -------
    TestMatch
        Whatever does not fit is a finding in it, not an error.
    """
    stored = open_stored(raw_path, test.file, lenient=True)
    try:
        columns = feeds(stored, test)
    except InputError as error:
        return TestMatch(test.name, (), (), str(error), ())
    refusal, means = "", dict[str, float]()
    try:
        # Every conversion is a straight line, so that the mean may be taken before it.
        means = {
            name: float(_si(name, np.array([mean]), test)[0])
            for name, mean in near_stall_means(raw_path, test).items()
        }
    except InputError as error:
        refusal = str(error)
    fed = {column.column for column in columns}
    left_over = tuple(c.name for c in inspection.channels if c.name not in fed)
    return TestMatch(
        test.name,
        tuple(_match(column, test, inspection, means, left_over) for column in columns),
        left_over,
        refusal,
        tuple(_pairs(test, means)),
    )


def preview(
    raw_path: str | os.PathLike[str], test: TestDescription, inspection: Inspection
) -> ReductionPreview:
    """Reduce a record with the usual settings, and say what came of it.

    Parameters
    ----------
    raw_path : str or path
        The record.
    test : TestDescription
        Its description.
    inspection : Inspection
        What was found in it: of a record too long to be read whole, the part where the machine
        surges is reduced.

    Returns
    -------
    ReductionPreview
        A record that is refused is a result, with the sentence.
    """
    too_long = inspection.rows * (len(test.channel_names) + 1) > MOST_VALUES
    window = inspection.surges_s if too_long and test.window_s is None else None
    try:
        record, test = read_raw(raw_path, test, window=window)
        reduction = reduce_record(record, test, keep_probes=False)
    except InputError as error:
        return ReductionPreview(str(error))
    history = reduction.record.history
    return ReductionPreview(
        "",
        reduction.window_s,
        _cycles(reduction.record),
        tuple(f"{entry.step}: {entry.did}" for entry in history),
        tuple(f"{d.what} ({d.count}): {d.why}" for entry in history for d in entry.dropped),
        tuple(flag for entry in history for flag in entry.flags),
    )


def _cycles(record: Record) -> int | None:
    found = [entry.parameters.get("n_cycles") for entry in record.history if entry.step == "window"]
    return next((n for n in found if isinstance(n, int)), None)


def _match(
    column: FeedColumn,
    test: TestDescription,
    inspection: Inspection,
    means: dict[str, float],
    left_over: tuple[str, ...],
) -> ChannelMatch:
    facts = inspection.channel(column.column)
    low = high = np.nan
    if facts is not None:
        ends = np.array([facts.minimum, facts.maximum])
        low, high = sorted(float(v) for v in _si(column.name, column.conversion.to_si(ends), test))
    why_not = ""
    if facts is None and column.column:
        near = nearest_names(column.column, left_over, 3)
        elsewhere = (
            why
            for name, why in inspection.left_aside.items()
            if name == column.column or name.endswith(f"/{column.column}")
        )
        why_not = next(elsewhere, "perhaps " + ", ".join(near) if near else "")
    return ChannelMatch(
        column.name,
        column.column,
        facts is not None or not column.column,
        why_not,
        facts.unit if facts is not None else "",
        column.unit,
        "Pa" if column.record_unit == "count" else column.record_unit,
        low,
        high,
        means.get(column.name, np.nan),
        _facility(column.name, test),
    )


def _facility(name: str, test: TestDescription) -> float:
    """Return what the facility read near stall at the plane of a channel."""
    pressures = {c.name: test.near_stall.pressure_Pa(c.plane) for c in test.pressures}
    temperatures = {c.name: test.near_stall.temperature_K(c.plane) for c in test.temperatures}
    return {**pressures, **temperatures}.get(name, np.nan)


def _si(name: str, values: FloatArray, test: TestDescription) -> FloatArray:
    """Return readings as a record has them as total pressures or temperatures."""
    for probe in test.pressures:
        if probe.name == name:
            return probe_pressure_Pa(probe, test, values)
    for couple in test.temperatures:
        if couple.name == name:
            return values / couple.recovery_factor
    return values


def _pairs(test: TestDescription, means: dict[str, float]) -> Iterator[PairOrder]:
    for plane in test.areas_m2:
        for pair in test.pairs(plane):
            if pair.forward.name in means and pair.aft.name in means:
                above_Pa = means[pair.forward.name] - means[pair.aft.name]
                yield PairOrder(f"P{pair.name}", above_Pa)
