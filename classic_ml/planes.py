"""From the probes of a plane to its averages, by Eq 1 to 4."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import reduce

import numpy as np

from classic_ml.description import ProbePair, TestDescription
from classic_ml.flow import pair_flow, physical_flow
from classic_ml.intervals import bridged
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

# One reading in a hundred that is no pressure is noise at a probe; more is a wrong reference.
IMPOSSIBLE_SHARE = 0.01
BLOCK_ROWS = 1 << 13


def local_flows(
    record: Record,
    test: TestDescription,
    *,
    planes: Collection[int] = (25, 31),
    probe_ramp: float = 0.0,
) -> Record:
    """Compute corrected flow and total pressure at every probe pair (Eq 1 to 3).

    They are added as ``Wc25_A_tip_kg_s``, ``Pt25_A_tip_Pa`` and so on, the flow for some planes
    alone; below the calculated Mach number ``probe_ramp`` b of Eq 2 falls to nothing in proportion.
    A probe of which more than one in a hundred absolute pressures is not positive is refused.
    """
    added: list[Channel] = []
    reversed_share: dict[str, str | int | float | bool] = {}
    flags: tuple[str, ...] = ()
    for plane in test.areas_m2:
        for pair in _present_pairs(record, test, plane):
            (forward_Pa, n_forward), (aft_Pa, n_aft) = (
                _positive(record, probe.name) for probe in (pair.forward, pair.aft)
            )
            if n_forward or n_aft:
                flags += (
                    f"pair {pair.name}: {n_forward + n_aft} readings that are no absolute "
                    "pressure, bridged",
                )
            total = np.maximum(forward_Pa, aft_Pa)
            added.append(Channel.adopt(f"Pt{pair.name}_Pa", total, "Pa"))
            if plane in planes:
                law = pair.forward.probe_slope, pair.forward.probe_offset, test.areas_m2[plane]
                # In blocks, whose intermediate results stay in the cache.
                cuts = np.arange(BLOCK_ROWS, total.size, BLOCK_ROWS)
                blocks = zip(np.split(forward_Pa, cuts), np.split(aft_Pa, cuts), strict=True)
                parts = [pair_flow(*both, *law, test.compressor, probe_ramp) for both in blocks]
                flow = np.concatenate(parts)
                added.append(Channel.adopt(f"Wc{pair.name}_kg_s", flow, "kg/s"))
                share = np.count_nonzero(flow < 0.0) / max(flow.size, 1)
                reversed_share[f"reversed_{pair.name}"] = round(share, 4)
    entry = LedgerEntry(
        "local flows",
        f"Eq 1 to 3 at {len(reversed_share)} probe pairs; the share of rows with reversed flow is "
        "in the parameters",
        reversed_share,
        flags=flags,
    )
    return record.after(entry, add=added)


def plane_averages(record: Record, test: TestDescription) -> Record:
    """Average over rakes and immersions, and compute the physical flow (Eq 4).

    The arithmetic mean over the rakes is taken at each immersion and then over the immersions,
    so that a missing pair does not tilt the mean to the other immersion; with all pairs there
    it is the plain arithmetic mean. Added are ``P25_Pa``, ``T25_K``, ``Wc25_kg_s``,
    ``Wc25_tip_kg_s``, ``Wc25_hub_kg_s``, those of immersions between, and ``W25_kg_s``; the same at
    plane 31 as far as its flow and T31 are known. A plane of which no pair is left is refused.
    """
    columns: dict[str, FloatArray] = {}
    parameters: dict[str, str | int | float | bool] = {}
    for plane in test.areas_m2:
        pairs = _present_pairs(record, test, plane)
        present = sorted({pair.immersion for pair in pairs}, reverse=True)
        if not present:
            raise InputError(
                f"{record.source}: plane {plane}",
                expected="at least one usable probe pair",
                found="none",
                remedy="the history of the record says which were left out and why",
            )
        total: dict[str, FloatArray] = {}
        flow: dict[str, FloatArray] = {}
        for immersion in present:
            names = [pair.name for pair in pairs if pair.immersion == immersion]
            total[immersion] = _mean([record[f"Pt{name}_Pa"] for name in names])
            if f"Wc{names[0]}_kg_s" in record:
                flow[immersion] = _mean([record[f"Wc{name}_kg_s"] for name in names])
                columns[f"Wc{plane}_{immersion}_kg_s"] = flow[immersion]
        columns[f"P{plane}_Pa"] = _mean(list(total.values()))
        couples = [c.name for c in test.thermocouples(plane) if c.name in record]
        if couples:
            columns[f"T{plane}_K"] = _mean([record[name] for name in couples])
        if flow:
            corrected = _mean(list(flow.values()))
            columns[f"Wc{plane}_kg_s"] = corrected
            if couples:
                plane_Pa, plane_K = columns[f"P{plane}_Pa"], columns[f"T{plane}_K"]
                columns[f"W{plane}_kg_s"] = physical_flow(corrected, plane_Pa, plane_K)
        parameters[f"pairs_{plane}"] = len(pairs)
    units = {"s": "kg/s", "Pa": "Pa", "K": "K"}
    added = [Channel.adopt(n, v, units[n.rpartition("_")[2]]) for n, v in columns.items()]
    did = "arithmetic mean over rakes and immersions, Eq 4 at each plane"
    return record.after(LedgerEntry("plane averages", did, parameters), add=added)


def _present_pairs(record: Record, test: TestDescription, plane: int) -> list[ProbePair]:
    """Return the pairs whose two probes are (still) in the record."""
    pairs = test.pairs(plane)
    return [p for p in pairs if p.forward.name in record and p.aft.name in record]


def _positive(record: Record, name: str) -> tuple[FloatArray, int]:
    """Return a pressure with lines across readings that are none, or refuse one with many."""
    values = record[name]
    good = values > 0.0
    n_bad = values.size - int(np.count_nonzero(good))
    if n_bad == 0:
        return values, 0
    if n_bad > IMPOSSIBLE_SHARE * values.size:
        row = int(np.argmin(values))
        raise InputError(
            f"{record.source}: channel {name}",
            expected="a positive absolute pressure",
            found=f"{values[row]:g} Pa at {record.time_at_s(row):.3f} s, one of {n_bad} such rows",
            remedy="check zoc_reference_Pa and the zero and calibrate readings",
        )
    return bridged(values, good), n_bad


def _mean(values: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(reduce(np.add, values) / len(values))
