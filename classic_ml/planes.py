"""From the probes of a plane to its averages, by Eq 1 to 4."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from classic_ml.description import ProbePair, TestDescription
from classic_ml.flow import pair_flow, physical_flow
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["local_flows", "plane_averages", "present_pairs"]

# Rows of which the equations are evaluated at once: their intermediate results stay in the cache.
BLOCK_ROWS = 1 << 14


def local_flows(record: Record, test: TestDescription) -> Record:
    """Compute corrected flow and total pressure at every probe pair (Eq 1 to 3).

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
    added: list[Channel] = []
    reversed_share: dict[str, str | int | float | bool] = {}
    for plane in test.areas_m2:
        for pair in present_pairs(record, test, plane):
            forward, aft = record[pair.forward.name], record[pair.aft.name]
            total = np.maximum(forward, aft)
            if np.min(np.minimum(forward, aft), initial=np.inf) <= 0.0:
                raise _not_absolute(record, pair)
            flow = _flow_of(pair, forward, aft, test)
            share = np.count_nonzero(flow < 0.0) / max(flow.size, 1)
            reversed_share[f"reversed_{pair.name}"] = round(share, 4)
            added.append(Channel.adopt(f"Wc{pair.name}_kg_s", flow, "kg/s"))
            added.append(Channel.adopt(f"Pt{pair.name}_Pa", total, "Pa"))
    entry = LedgerEntry(
        "local flows",
        f"Eq 1 to 3 at {len(reversed_share)} probe pairs; the share of rows with reversed flow is "
        "in the parameters",
        reversed_share,
    )
    return record.after(entry, add=added)


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
    columns: dict[str, FloatArray] = {}
    parameters: dict[str, str | int | float | bool] = {"probes": probes}
    for plane in test.areas_m2:
        pairs = _pairs_by_immersion(record, test, plane)
        used = _immersions(record, test, plane, pairs, probes)
        flow = {i: _mean([record[f"Wc{p.name}_kg_s"] for p in pairs[i]]) for i in pairs}
        total = {i: _mean([record[f"Pt{p.name}_Pa"] for p in pairs[i]]) for i in used}
        columns[f"Wc{plane}_kg_s"] = _mean([flow[i] for i in used])
        columns |= {f"Wc{plane}_{i}_kg_s": flow[i] for i in flow}
        columns[f"P{plane}_Pa"] = _mean([total[i] for i in used])
        couples = [c.name for c in test.thermocouples(plane) if c.name in record]
        if plane == 25 and not couples:
            raise InputError(
                f"{record.source}: plane 25",
                expected="at least one thermocouple that can be used",
                found="none",
                remedy="without T25 there is neither φ nor ψ'",
            )
        if couples:
            columns[f"T{plane}_K"] = _mean([record[name] for name in couples])
            columns[f"W{plane}_kg_s"] = physical_flow(
                *(columns[f"{name}"] for name in (f"Wc{plane}_kg_s", f"P{plane}_Pa", f"T{plane}_K"))
            )
        parameters[f"pairs_{plane}"] = sum(map(len, pairs.values()))
    units = {"s": "kg/s", "Pa": "Pa", "K": "K"}
    added = [Channel.adopt(n, v, units[n.rpartition("_")[2]]) for n, v in columns.items()]
    did = f"arithmetic mean over rakes and immersions ({probes}), Eq 4 at each plane"
    return record.after(LedgerEntry("plane averages", did, parameters), add=added)


def present_pairs(record: Record, test: TestDescription, plane: int) -> tuple[ProbePair, ...]:
    """Return the pairs whose two probes are (still) in the record."""
    return tuple(
        pair
        for pair in test.pairs(plane)
        if pair.forward.name in record and pair.aft.name in record
    )


def _flow_of(
    pair: ProbePair, forward_Pa: FloatArray, aft_Pa: FloatArray, test: TestDescription
) -> FloatArray:
    probe, machine = pair.forward, test.compressor
    area_m2 = test.areas_m2[probe.plane]
    flow = np.empty(forward_Pa.size)
    for rows in _blocks(forward_Pa.size):
        flow[rows] = pair_flow(
            forward_Pa[rows], aft_Pa[rows], probe.probe_slope, probe.probe_offset, area_m2, machine
        )
    return flow


def _blocks(n_rows: int) -> Iterator[slice]:
    return (slice(first, first + BLOCK_ROWS) for first in range(0, n_rows, BLOCK_ROWS))


def _not_absolute(record: Record, pair: ProbePair) -> InputError:
    name = min((pair.forward.name, pair.aft.name), key=lambda n: float(record[n].min()))
    row = int(np.argmin(record[name]))
    return InputError(
        f"{record.source}: channel {name}",
        expected="a positive absolute pressure",
        found=f"{record[name][row]:g} Pa at {record.time_at_s(row):.3f} s",
        remedy="check zoc_reference_Pa and the zero and calibrate readings",
    )


def _pairs_by_immersion(
    record: Record, test: TestDescription, plane: int
) -> dict[str, list[ProbePair]]:
    pairs = present_pairs(record, test, plane)
    by_immersion = {i: [p for p in pairs if p.immersion == i] for i in ("tip", "hub")}
    return {immersion: some for immersion, some in by_immersion.items() if some}


def _immersions(
    record: Record,
    test: TestDescription,
    plane: int,
    pairs: Mapping[str, Sequence[ProbePair]],
    probes: str,
) -> list[str]:
    """Return the immersions to average over; one of which the test has pairs must have one left."""
    wanted = ("tip", "hub") if probes == "all" else (probes,)
    used = [i for i in wanted if any(p.immersion == i for p in test.pairs(plane))]
    missing = [i for i in used if i not in pairs]
    if missing or not used:
        raise InputError(
            f"{record.source}: plane {plane}",
            expected="at least one usable probe pair at " + (" and ".join(missing) or "a place"),
            found="none",
            remedy="the history of the record says which were left out and why",
        )
    return used


def _mean(values: Sequence[FloatArray]) -> FloatArray:
    if len(values) == 1:
        return values[0]
    added = values[0] + values[1]
    for further in values[2:]:
        added += further
    added /= len(values)
    return added
