"""From the probes of a plane to its averages, by Eq 1 to 4."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from classic_ml.airflow import flow_constant_kg_s, physical_flow
from classic_ml.columns.order_statistics import lowest
from classic_ml.columns.workspace import ColumnWriter, blocks
from classic_ml.errors import InputError
from classic_ml.flow_kernels import pair_flow
from classic_ml.readers.test_description import ProbePair, TestDescription
from classic_ml.records import Channel, FloatArray, LedgerEntry, Record

__all__ = [
    "PlaneFlows",
    "Readings",
    "local_flows",
    "plane_averages",
    "plane_flows",
    "present_pairs",
]

# The readings of some rows, by channel.
Readings = Callable[[slice], Mapping[str, FloatArray]]


def present_pairs(record: Record, test: TestDescription, plane: int) -> tuple[ProbePair, ...]:
    """Return the pairs whose two probes are (still) in the record."""
    return tuple(
        pair
        for pair in test.pairs(plane)
        if pair.forward.name in record and pair.aft.name in record
    )


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
    """Return a column as a channel, its unit told by the name."""
    unit = {"s": "kg/s", "Pa": "Pa", "K": "K"}[name.rpartition("_")[2]]
    return Channel(name, column.finished(), unit)


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
    reversed_, refused = pair_flow(forward, aft, gamma, slope, offset, constant, flow, total)
    return flow, total, None if refused else int(reversed_)


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
    planes = [_plane(record, test, plane, probes) for plane in test.areas_m2]
    columns = _columns(record, planes)
    for rows in blocks(record.n_samples):
        for plane in planes:
            local = {
                pair.name: (record[f"Wc{pair.name}_kg_s"][rows], record[f"Pt{pair.name}_Pa"][rows])
                for pairs in plane.pairs.values()
                for pair in pairs
            }
            couples = [record[name][rows] for name in plane.couples]
            for name, values in plane.averages(local, couples).items():
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
    wanted : collection of str, optional
        Which averages are kept; all of them without it. The ledger tells nothing of the flows of a
        plane of which the pressure alone is wanted.

    Returns
    -------
    Record
        With the plane averages, equal to the last bit, and the ledger entries of both steps.

    Raises
    ------
    InputError
        As both do.
    """
    return PlaneFlows(record, test, probes).evaluated(wanted)


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
        self._planes = [_plane(record, test, plane, probes) for plane in test.areas_m2]
        # By the first row of a block and by pair.
        self._n_reversed: dict[int, dict[str, int]] = {}

    def block(self, rows: slice, wanted: Collection[str] | None = None) -> dict[str, FloatArray]:
        """Return the averages over some rows, those of one block, or of these the ones wanted."""
        readings = self._readings(rows)
        counts = self._n_reversed[rows.start] = {}
        found: dict[str, FloatArray] = {}
        for plane in self._planes:
            if wanted is None or any(n in wanted for n in plane.names() if n != plane.pressure):
                found |= self._averages(plane, readings, counts)
            elif plane.pressure in wanted:
                found[plane.pressure] = self._pressure(plane, readings)
        return found

    def _averages(
        self, plane: _Plane, readings: Mapping[str, FloatArray], counts: dict[str, int]
    ) -> dict[str, FloatArray]:
        local = {}
        for pair in plane.all_pairs():
            flow, total, n_rows = _pair_flow(readings, self._test, pair)
            if n_rows is None:
                raise _not_absolute(self._record, self._test, self._readings)
            local[pair.name], counts[pair.name] = (flow, total), n_rows
        return plane.averages(local, [readings[name] for name in plane.couples])

    def _pressure(self, plane: _Plane, readings: Mapping[str, FloatArray]) -> FloatArray:
        total = {}
        for pair in plane.all_pairs():
            forward, aft = readings[pair.forward.name], readings[pair.aft.name]
            if not min(forward.min(), aft.min()) > 0.0:
                raise _not_absolute(self._record, self._test, self._readings)
            total[pair.name] = np.maximum(forward, aft)
        return plane.over_places(total)[1]

    def evaluated(self, wanted: Collection[str] | None = None) -> Record:
        """Return the record with the averages over all rows, and the ledger entries."""
        record = self._record
        columns = _columns(record, self._planes)
        if wanted is not None:
            columns = {name: column for name, column in columns.items() if name in wanted}
        for rows in blocks(record.n_samples):
            found = self.block(rows, wanted)
            for name, column in columns.items():
                column.append(found[name])
            record.workspace.release()
        added = [_channel(name, column) for name, column in columns.items()]
        return replace(record.after(self.entries[-1], add=added), history=self._history(record))

    def evaluated_anew(
        self, before: PlaneFlows, averaged: Record, where: Iterable[slice]
    ) -> Record:
        """Return the averages of another record, of which only some blocks are not the same.

        Parameters
        ----------
        before : PlaneFlows
            Of the other record, with the same channels.
        averaged : Record
            What it was evaluated to; its columns are taken over and written to.
        where : iterable of slice
            The blocks that differ.
        """
        record = self._record
        names = [name for plane in self._planes for name in plane.names()]
        self._n_reversed = dict(before._n_reversed)
        for rows in where:
            for name, values in self.block(rows).items():
                record.workspace.overwrite(averaged[name], rows, values)
            record.workspace.release()
        added = [averaged.channel(name) for name in names]
        return replace(record.after(self.entries[-1], add=added), history=self._history(record))

    def _history(self, record: Record) -> tuple[LedgerEntry, ...]:
        return (*record.history, *self.entries)

    @property
    def entries(self) -> tuple[LedgerEntry, LedgerEntry]:
        """What the ledger says of the flows and of the averages."""
        totals = {
            pair.name: sum(counts.get(pair.name, 0) for counts in self._n_reversed.values())
            for pair in _all_pairs(self._record, self._test)
            if any(pair.name in counts for counts in self._n_reversed.values())
        }
        flows = _flows_entry(totals, self._record.n_samples)
        return flows, _averages_entry(self._planes, self._probes)


@dataclass(frozen=True)
class _Plane:
    """What is averaged over one plane."""

    plane: int
    pairs: Mapping[str, tuple[ProbePair, ...]]
    used: tuple[str, ...]
    couples: tuple[str, ...]

    @property
    def pressure(self) -> str:
        """Name of the total pressure."""
        return f"P{self.plane}_Pa"

    def all_pairs(self) -> Iterator[ProbePair]:
        """Yield the pairs of all immersions."""
        return (pair for pairs in self.pairs.values() for pair in pairs)

    def over_places(
        self, local: Mapping[str, FloatArray]
    ) -> tuple[dict[str, FloatArray], FloatArray]:
        """Return the mean of each immersion, and over those in use, of what each pair shows."""
        by_place = {i: _mean([local[p.name] for p in pairs]) for i, pairs in self.pairs.items()}
        return by_place, _mean([by_place[i] for i in self.used])

    def names(self) -> list[str]:
        """Return the names of the averages."""
        p = self.plane
        flows = [f"Wc{p}_kg_s", *(f"Wc{p}_{i}_kg_s" for i in self.pairs)]
        return [*flows, f"P{p}_Pa", *([f"T{p}_K", f"W{p}_kg_s"] if self.couples else [])]

    def averages(
        self,
        local: Mapping[str, tuple[FloatArray, FloatArray]],
        temperatures_K: Sequence[FloatArray],
    ) -> dict[str, FloatArray]:
        """Return the averages of some rows.

        Parameters
        ----------
        local : mapping of str to tuple of ndarray
            Corrected flow and total pressure of each pair.
        temperatures_K : sequence of ndarray
            Of the thermocouples.
        """
        p = self.plane
        flow, corrected = self.over_places({name: values[0] for name, values in local.items()})
        _, pressure = self.over_places({name: values[1] for name, values in local.items()})
        values = {f"Wc{p}_kg_s": corrected, self.pressure: pressure}
        values |= {f"Wc{p}_{i}_kg_s": flow[i] for i in flow}
        if temperatures_K:
            temperature = _mean(temperatures_K)
            values[f"T{p}_K"] = temperature
            values[f"W{p}_kg_s"] = physical_flow(corrected, pressure, temperature)
        return values


def _columns(record: Record, planes: Sequence[_Plane]) -> dict[str, ColumnWriter]:
    names = [name for plane in planes for name in plane.names()]
    return {name: record.workspace.writer(record.n_samples) for name in names}


def _averages_entry(planes: Sequence[_Plane], probes: str) -> LedgerEntry:
    return LedgerEntry(
        "plane averages",
        f"arithmetic mean over rakes and immersions ({probes}), Eq 4 at each plane",
        {
            "probes": probes,
            **{f"pairs_{p.plane}": sum(map(len, p.pairs.values())) for p in planes},
        },
    )


def _plane(record: Record, test: TestDescription, plane: int, probes: str) -> _Plane:
    """Choose what is averaged over a plane, or refuse where there is too little."""
    wanted = ("tip", "hub") if probes == "all" else (probes,)
    pairs = present_pairs(record, test, plane)
    by_place = {i: tuple(p for p in pairs if p.immersion == i) for i in ("tip", "hub")}
    used = [i for i in wanted if by_place[i] or any(p.immersion == i for p in test.pairs(plane))]
    missing = [i for i in used if not by_place[i]]
    if missing or not used:
        raise InputError(
            f"{record.source}: plane {plane}",
            expected="at least one usable probe pair at " + (" and ".join(missing) or "a place"),
            found="none",
            remedy="the history of the record says which were left out and why",
        )
    couples = tuple(c.name for c in test.thermocouples(plane) if c.name in record)
    if plane == 25 and not couples:
        raise InputError(
            f"{record.source}: plane 25",
            expected="at least one thermocouple that can be used",
            found="none",
            remedy="without T25 there is neither φ nor ψ'",
        )
    return _Plane(plane, {i: p for i, p in by_place.items() if p}, tuple(used), couples)


def _mean(values: Sequence[FloatArray]) -> FloatArray:
    if len(values) == 1:
        return values[0]
    added = values[0] + values[1]
    for further in values[2:]:
        added += further
    if len(values) & (len(values) - 1):
        added /= len(values)
    else:
        # Of a power of two the inverse is a double, and a product takes half the time.
        added *= 1.0 / len(values)
    return added
