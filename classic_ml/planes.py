"""From the probes of a plane to its averages, by Eq 1 to 4."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from classic_ml.columns.order_statistics import lowest
from classic_ml.columns.together import computed_together
from classic_ml.columns.workspace import ColumnWriter, blocks
from classic_ml.flow import flow_constant_kg_s, physical_flow, reversed_above
from classic_ml.flow_kernels import pair_flow, pair_total
from classic_ml.probe_plane import AveragedPlane, averaged_plane, present_pairs
from classic_ml.readers.test_description import ProbePair, TestDescription
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "EvaluatedFlows",
    "PlaneFlows",
    "Readings",
    "local_flows",
    "plane_averages",
    "plane_flows",
]

# The readings of some rows, by channel.
Readings = Callable[[slice], Mapping[str, FloatArray]]


def local_flows(record: Record, test: TestDescription) -> Record:
    """Compute corrected flow and total pressure at every probe pair (Eq 1 to 3).

    A reduction needs their averages alone: see :func:`plane_flows`.

    Parameters
    ----------
    record : Record
        Calibrated pressures in Pa.
    test : TestDescription
        Places and probe constants.

    Returns
    -------
    Record
        With ``Wc25_A_tip_kg_s``, ``Pt25_A_tip_Pa`` and so on for every pair in the record.

    Raises
    ------
    InputError
        When an absolute pressure is not positive.
    """
    pairs = _all_pairs(record, test)
    names = [f"{kind}{p.name}_{u}" for p in pairs for kind, u in (("Wc", "kg_s"), ("Pt", "Pa"))]
    columns = {name: record.workspace.writer(record.n_samples) for name in names}
    n_reversed = dict.fromkeys((pair.name for pair in pairs), 0)
    readings = _as_they_are(record, test)
    for rows in blocks(record.n_samples):
        block = readings(rows)
        for pair in pairs:
            flow, total, n_rows = _pair_flow(block, test, pair)
            if n_rows is None:
                raise _not_absolute(record, test, readings)
            columns[f"Wc{pair.name}_kg_s"].append(flow)
            columns[f"Pt{pair.name}_Pa"].append(total)
            n_reversed[pair.name] += n_rows
        record.workspace.release()
    added = [_channel(name, column) for name, column in columns.items()]
    return record.after(_flows_entry(n_reversed, record.n_samples), add=added)


def _all_pairs(record: Record, test: TestDescription) -> list[ProbePair]:
    return [pair for plane in test.areas_m2 for pair in present_pairs(record, test, plane)]


def _channel(name: str, column: ColumnWriter) -> Channel:
    return Channel(name, column.finished(), _unit(name))


def _unit(name: str) -> str:
    """Return the unit that the name of a channel tells."""
    return {"s": "kg/s", "Pa": "Pa", "K": "K"}[name.rpartition("_")[2]]


def _product(record: Record, factors: Sequence[FloatArray]) -> FloatArray:
    """Return the physical flow (Eq 4) of columns, computed each time that it is asked for."""
    return record.workspace.derived(
        record.n_samples, lambda rows: physical_flow(*(factor[rows] for factor in factors))
    )


def _flows_entry(n_reversed: Mapping[str, int], n_rows: int) -> LedgerEntry:
    return LedgerEntry(
        "local flows",
        f"Eq 1 to 3 at {len(n_reversed)} probe pairs; the share of rows with reversed flow is in "
        "the parameters",
        {f"reversed_{name}": round(n / max(n_rows, 1), 4) for name, n in n_reversed.items()},
    )


def _as_they_are(record: Record, test: TestDescription) -> Readings:
    """Return the readings of the channels in the record."""
    names = [name for name in test.channel_names if name in record]
    return lambda rows: {name: record[name][rows] for name in names}


def _pair_flow(
    block: Mapping[str, FloatArray], test: TestDescription, pair: ProbePair
) -> tuple[FloatArray, FloatArray, int | None]:
    """Return corrected flow and total pressure in some rows, and in how many it is reversed.

    None instead of the last where a pressure is not above zero.
    """
    forward, aft = block[pair.forward.name], block[pair.aft.name]
    flow, total = np.empty(forward.size), np.empty(forward.size)
    slope, offset = pair.forward.probe_slope, pair.forward.probe_offset
    constant = flow_constant_kg_s(test.areas_m2[pair.forward.plane], test.compressor)
    gamma = test.compressor.gamma
    above = reversed_above(slope, offset, gamma)
    reversed_, refused = pair_flow(forward, aft, gamma, slope, offset, constant, above, flow, total)
    return flow, total, None if refused else int(reversed_)


def _pair_total(
    block: Mapping[str, FloatArray], test: TestDescription, pair: ProbePair
) -> tuple[FloatArray, int | None]:
    """Return the total pressure in some rows, and the rows with reversed flow or None, as above."""
    forward, aft = block[pair.forward.name], block[pair.aft.name]
    total = np.empty(forward.size)
    probe = pair.forward
    above = reversed_above(probe.probe_slope, probe.probe_offset, test.compressor.gamma)
    reversed_, refused = pair_total(forward, aft, above, total)
    return total, None if refused else int(reversed_)


def _not_absolute(record: Record, test: TestDescription, readings: Readings) -> InputError:
    """Tell of the least reading of the first channel that is not above zero throughout."""

    def of(name: str) -> Iterator[FloatArray]:
        return (readings(rows)[name] for rows in blocks(record.n_samples))

    for probe in (p for pair in _all_pairs(record, test) for p in (pair.forward, pair.aft)):
        low, row = lowest(partial(of, probe.name), workspace=record.workspace)
        if low <= 0.0:
            break
    return InputError(
        f"{record.source}: channel {probe.name}",
        expected="a positive absolute pressure",
        found=f"{low:g} Pa at {record.time_at_s(row):.3f} s",
        remedy="check zoc_reference_Pa and the zero and calibrate readings",
    )


def plane_averages(record: Record, test: TestDescription, probes: str = "all") -> Record:
    """Average over rakes and immersions, and compute the physical flow (Eq 4).

    The arithmetic mean over the rakes is taken at each immersion and then over the immersions,
    so that a missing pair does not tilt the mean to the other immersion; with all pairs there
    it is the plain arithmetic mean.

    Parameters
    ----------
    record : Record
        Local flows, and temperatures in K.
    test : TestDescription
        Places of the probes.
    probes : {"all", "tip", "hub"}
        Immersions to use.

    Returns
    -------
    Record
        With ``P25_Pa``, ``T25_K``, ``Wc25_kg_s``, ``Wc25_tip_kg_s``, ``Wc25_hub_kg_s`` and
        ``W25_kg_s``; the same at plane 31 as far as T31 is known.

    Raises
    ------
    InputError
        When an immersion that is wanted has no pair left, or plane 25 no thermocouple.
    """
    planes = [averaged_plane(record, test, plane, probes) for plane in test.areas_m2]
    columns = _columns(record, planes)
    for rows in blocks(record.n_samples):
        for plane in planes:
            local = {
                pair.name: (record[f"Wc{pair.name}_kg_s"][rows], record[f"Pt{pair.name}_Pa"][rows])
                for pairs in plane.pairs.values()
                for pair in pairs
            }
            couples = [record[name][rows] for name in plane.couples]
            for name, values in plane.averages(local, couples, plane.names()).items():
                columns[name].append(values)
        record.workspace.release()
    added = [_channel(name, column) for name, column in columns.items()]
    return record.after(_averages_entry(planes, probes), add=added)


def plane_flows(
    record: Record,
    test: TestDescription,
    probes: str = "all",
    *,
    wanted: Collection[str] | None = None,
    stored: Collection[str] | None = None,
) -> Record:
    """Compute what :func:`plane_averages` makes of :func:`local_flows`, without keeping the latter.

    Parameters
    ----------
    record : Record
        Calibrated pressures in Pa, and temperatures in K.
    test : TestDescription
        Places and probe constants.
    probes : {"all", "tip", "hub"}
        Immersions to use.
    wanted, stored : collection of str, optional
        As for :meth:`PlaneFlows.evaluated`.

    Returns
    -------
    Record
        With the plane averages, equal to the last bit, and the ledger entries of both steps.

    Raises
    ------
    InputError
        As both do.
    """
    return PlaneFlows(record, test, probes).evaluated(wanted, stored).record


@dataclass(frozen=True)
class EvaluatedFlows:
    """What has been evaluated of the averages.

    Parameters
    ----------
    record : Record
        With the averages, and what the ledger says of them.
    entries : tuple of LedgerEntry
        This alone.
    stored : tuple of str
        The averages that were evaluated.
    n_reversed : mapping of int to mapping of str to int
        Rows with reversed flow, by the first row of a block and by pair.
    """

    record: Record
    entries: tuple[LedgerEntry, ...]
    stored: tuple[str, ...]
    n_reversed: Mapping[int, Mapping[str, int]]


class PlaneFlows:
    """Flows and pressures averaged over the planes, of any block of rows.

    Parameters
    ----------
    record : Record
        Which channels there are.
    test : TestDescription
        Places and probe constants.
    probes : {"all", "tip", "hub"}
        Immersions to use.
    readings : callable, optional
        ``readings(rows)`` returns the readings of those rows by channel, where they are not those
        in the record: filtered, say, without being kept.
    """

    def __init__(
        self,
        record: Record,
        test: TestDescription,
        probes: str = "all",
        readings: Readings | None = None,
    ) -> None:
        self._record, self._test, self._probes = record, test, probes
        self._readings = readings if readings is not None else _as_they_are(record, test)
        self._planes = [averaged_plane(record, test, plane, probes) for plane in test.areas_m2]

    def evaluated(
        self, wanted: Collection[str] | None = None, stored: Collection[str] | None = None
    ) -> EvaluatedFlows:
        """Average over all rows.

        Parameters
        ----------
        wanted : collection of str, optional
            Which averages there are in the record; all of them without it.
        stored : collection of str, optional
            Those that are evaluated now; on disk the others are computed each time that somebody
            asks for them. All without it. Where it is empty the ledger says nothing of the flows,
            which nobody has looked at.
        """
        place, n_rows = self._record.workspace, self._record.n_samples
        names = self._names(wanted)
        everything = stored is None or not place.computes_anew
        now = tuple(name for name in names if everything or name in (stored or ()))
        columns = {name: place.writer(n_rows) for name in now}
        n_reversed: dict[int, dict[str, int]] = {}
        for rows in blocks(n_rows) if now else ():
            found, n_reversed[rows.start] = self._averages_and_counts(rows, now)
            for name, column in columns.items():
                column.append(found[name])
            place.release()
        channels = {name: _channel(name, column) for name, column in columns.items()}
        told = n_reversed if stored is None or stored else {}
        return self._with(channels, names, told)

    def evaluated_anew(self, before: EvaluatedFlows, where: Iterable[slice]) -> EvaluatedFlows:
        """Return the averages of another record, of which only some blocks are not the same.

        Parameters
        ----------
        before : EvaluatedFlows
            Of the other record, with the same channels; its columns are taken over and written to.
        where : iterable of slice
            The blocks that differ.
        """
        place, names = self._record.workspace, self._names(None)
        n_reversed = dict(before.n_reversed)
        now = tuple(name for name in names if name in before.stored)
        for rows in where:
            found, n_reversed[rows.start] = self._averages_and_counts(rows, now)
            for name, values in found.items():
                place.overwrite(before.record[name], rows, values)
            place.release()
        return self._with({name: before.record.channel(name) for name in now}, names, n_reversed)

    def _names(self, wanted: Collection[str] | None) -> list[str]:
        names = [name for plane in self._planes for name in plane.names()]
        return names if wanted is None else [name for name in names if name in wanted]

    def _block(self, rows: slice, names: Collection[str]) -> dict[str, FloatArray]:
        """Return some averages over some rows."""
        readings = self._readings(rows)
        found: dict[str, FloatArray] = {}
        for plane in self._planes:
            asked = [name for name in plane.names() if name in names]
            if asked:
                found |= self._of_plane(plane, readings, asked)[0]
        return found

    def _averages_and_counts(
        self, rows: slice, names: Collection[str]
    ) -> tuple[dict[str, FloatArray], dict[str, int]]:
        """Return some averages, and in how many rows the flow of each pair of all is reversed."""
        readings = self._readings(rows)
        found: dict[str, FloatArray] = {}
        counts: dict[str, int] = {}
        for plane in self._planes:
            asked = [name for name in plane.names() if name in names]
            averages, n_reversed = self._of_plane(plane, readings, asked)
            found |= averages
            counts |= n_reversed
        return found, counts

    def _of_plane(
        self, plane: AveragedPlane, readings: Mapping[str, FloatArray], names: Sequence[str]
    ) -> tuple[dict[str, FloatArray], dict[str, int]]:
        """Return the averages of one plane, without a flow where none is asked for, and counts."""
        with_flows = plane.needs_flows(names)
        local: dict[str, tuple[FloatArray | None, FloatArray]] = {}
        counts: dict[str, int] = {}
        for pair in plane.all_pairs():
            flow = None
            if with_flows:
                flow, total, n_rows = _pair_flow(readings, self._test, pair)
            else:
                total, n_rows = _pair_total(readings, self._test, pair)
            if n_rows is None:
                raise _not_absolute(self._record, self._test, self._readings)
            local[pair.name], counts[pair.name] = (flow, total), n_rows
        couples = [readings[name] for name in plane.couples]
        return plane.averages(local, couples, names), counts

    def _with(
        self,
        evaluated: Mapping[str, Channel],
        names: Sequence[str],
        n_reversed: Mapping[int, Mapping[str, int]],
    ) -> EvaluatedFlows:
        """Add columns that are evaluated, and the others of those named, to the record."""
        record = self._record
        others = [name for name in names if name not in evaluated]
        columns = computed_together(
            record.n_samples, others, lambda rows: self._block(rows, others)
        )
        for plane in self._planes:
            # One product of what is at hand, for which no flow need be computed.
            if plane.flow in others and all(name in evaluated for name in plane.flow_factors):
                factors = [evaluated[name].values for name in plane.flow_factors]
                columns[plane.flow] = _product(record, factors)
        added = [
            evaluated[name] if name in evaluated else Channel(name, columns[name], _unit(name))
            for name in names
        ]
        entries = self._entries(n_reversed)
        record = replace(record.after(entries[-1], add=added), history=(*record.history, *entries))
        return EvaluatedFlows(record, entries, tuple(evaluated), n_reversed)

    def _entries(self, n_reversed: Mapping[int, Mapping[str, int]]) -> tuple[LedgerEntry, ...]:
        """Return what the ledger says of the flows, where they were looked at, and averages."""
        averages = _averages_entry(self._planes, self._probes)
        if not n_reversed:
            return (averages,)
        totals = {
            pair.name: sum(counts[pair.name] for counts in n_reversed.values())
            for pair in _all_pairs(self._record, self._test)
        }
        return _flows_entry(totals, self._record.n_samples), averages


def _columns(record: Record, planes: Sequence[AveragedPlane]) -> dict[str, ColumnWriter]:
    names = [name for plane in planes for name in plane.names()]
    return {name: record.workspace.writer(record.n_samples) for name in names}


def _averages_entry(planes: Sequence[AveragedPlane], probes: str) -> LedgerEntry:
    return LedgerEntry(
        "plane averages",
        f"arithmetic mean over rakes and immersions ({probes}), Eq 4 at each plane",
        {
            "probes": probes,
            **{f"pairs_{p.plane}": sum(map(len, p.pairs.values())) for p in planes},
        },
    )
