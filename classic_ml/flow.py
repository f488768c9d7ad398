"""Eq 1 to 4: from probe pairs to flow, reversed flow too, and to the averages of a plane."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import reduce

import numpy as np

from classic_ml.description import Compressor, ProbePair, TestDescription
from classic_ml.intervals import bridged
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

# One reading in a hundred that is no pressure is noise at a probe; more is a wrong reference.
IMPOSSIBLE_SHARE = 0.01


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
            added.append(Channel(f"Pt{pair.name}_Pa", total, "Pa"))
            if plane in planes:
                law = pair.forward.probe_slope, pair.forward.probe_offset, test.areas_m2[plane]
                flow = pair_flow(forward_Pa, aft_Pa, *law, test.compressor, probe_ramp)
                added.append(Channel(f"Wc{pair.name}_kg_s", flow, "kg/s"))
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
    added = [Channel(n, v, units[n.rpartition("_")[2]]) for n, v in columns.items()]
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


# US standard day, as the paper's corrected quantities use it, and the avoirdupois pound.
P_STANDARD_PA = 101_325.0
T_STANDARD_K = 288.15
LBM_KG = 0.45359237

# Newton's steps for the inverse of Eq 3; four are enough from the first guess below.
MOST_STEPS = 60
ARRIVED = 1e-16
# At the choke the slope of Eq 3 is zero; a step must stay finite there.
LEAST_SLOPE = 1e-6


def calculated_mach(forward_Pa: FloatArray, aft_Pa: FloatArray, gamma: float) -> FloatArray:
    """Return the signed calculated Mach number of a probe pair.

    M_calc = ±√{2/(γ−1) [(P_high/P_low)^((γ−1)/γ) − 1]}, Eq 1 with the rule for reversed flow, in
    which the aft probe reads the total pressure and the forward one the wake: it is then negative.
    """
    ratio = np.maximum(forward_Pa, aft_Pa) / np.minimum(forward_Pa, aft_Pa)
    square = 2.0 / (gamma - 1.0) * (ratio ** ((gamma - 1.0) / gamma) - 1.0)
    return np.asarray(np.sign(forward_Pa - aft_Pa) * np.sqrt(square))


def true_mach(calculated: FloatArray, slope: float, offset: float, ramp: float = 0.0) -> FloatArray:
    """Return the signed true Mach number, M_true = ±(a |M_calc| + b) (Eq 2).

    ``slope`` and ``offset`` are a and b of the pair, from its flow calibration, the same in
    reversed flow. Below a M_calc of ``ramp`` b falls to nothing in proportion; with 0 it jumps at
    zero flow, as in Eq 2, where the probes read alike and the sign is not known: there M_true is
    zero.
    """
    size = np.abs(calculated)
    jump = offset * np.minimum(size / ramp, 1.0) if ramp > 0.0 else offset
    magnitude = np.maximum(slope * size + jump, 0.0)
    return np.asarray(np.sign(calculated) * magnitude)


def corrected_flow(mach: FloatArray, area_m2: float, compressor: Compressor) -> FloatArray:
    """Return the corrected flow in kg/s for a signed true Mach number, odd in it (Eq 3).

    W_c = A P_o √(γ/(R T_o)) M / (1 + (γ−1)/2 M²)^((γ+1)/(2(γ−1))).
    """
    return _flow_constant_kg_s(area_m2, compressor) * mach / _expansion(mach, compressor.gamma)


def choked_flow(area_m2: float, compressor: Compressor) -> float:
    """Return the largest corrected flow that an area passes, that of M = 1 in Eq 3, in kg/s."""
    return _flow_constant_kg_s(area_m2, compressor) * _choked_share(compressor.gamma)


def pair_flow(
    forward_Pa: FloatArray,
    aft_Pa: FloatArray,
    slope: float,
    offset: float,
    area_m2: float,
    compressor: Compressor,
    ramp: float = 0.0,
) -> FloatArray:
    """Return the signed corrected flow that a probe pair shows, Eq 1 to 3 one after the other."""
    calculated = calculated_mach(forward_Pa, aft_Pa, compressor.gamma)
    return corrected_flow(true_mach(calculated, slope, offset, ramp), area_m2, compressor)


def mach_from_corrected_flow(
    corrected_kg_s: FloatArray, area_m2: float, compressor: Compressor
) -> FloatArray:
    """Invert Eq 3 on its subsonic branch, |M| ≤ 1, by Newton's method.

    A flow in kg/s, signed, that is more than the area can pass is refused.
    """
    gamma = compressor.gamma
    constant_kg_s = _flow_constant_kg_s(area_m2, compressor)
    share = np.abs(corrected_kg_s) / constant_kg_s
    choked = _choked_share(gamma)
    largest = float(np.max(share, initial=0.0))
    if largest > choked:
        raise InputError(
            "corrected flow",
            expected=f"at most {choked * constant_kg_s:.4g} kg/s through {area_m2:g} m²",
            found=f"{largest * constant_kg_s:.4g} kg/s",
            remedy="check area_m2 of the plane and the calibration of its probes",
        )
    # First guess: exact at rest and at the choke, with the slopes there, as a function of
    # u = √(1 − share/choked), in which the choke is no singularity.
    u = np.sqrt(np.maximum(1.0 - share / choked, 0.0))
    linear = 1.0 - np.sqrt(0.5 * (gamma + 1.0))
    mach = (1.0 - u) * (1.0 + u * (linear + u * (2.0 * choked - 1.0 - linear)))
    for _ in range(MOST_STEPS):
        expansion = _expansion(mach, gamma)
        slope = (1.0 - mach**2) / (expansion * (1.0 + 0.5 * (gamma - 1.0) * mach**2))
        slope = np.maximum(slope, LEAST_SLOPE)
        step = (mach / expansion - share) / slope
        mach = np.clip(mach - step, 0.0, 1.0)
        # The square of a step over the slope bounds what it leaves.
        if np.all(step**2 < ARRIVED * slope):
            break
    return np.asarray(np.copysign(mach, corrected_kg_s))


def physical_flow(
    corrected_kg_s: FloatArray, pressure_Pa: FloatArray, temperature_K: FloatArray
) -> FloatArray:
    """Return W = W_c (P/P_o) √(T_o/T), with total P and T of the plane (Eq 4)."""
    return np.asarray(
        corrected_kg_s * (pressure_Pa / P_STANDARD_PA) * np.sqrt(T_STANDARD_K / temperature_K)
    )


def corrected_from_physical(
    flow_kg_s: FloatArray, pressure_Pa: FloatArray, temperature_K: FloatArray
) -> FloatArray:
    """Return W_c = W √θ/δ, the inverse of Eq 4."""
    return np.asarray(
        flow_kg_s * np.sqrt(temperature_K / T_STANDARD_K) / (pressure_Pa / P_STANDARD_PA)
    )


def _flow_constant_kg_s(area_m2: float, compressor: Compressor) -> float:
    """Return A P_o √(γ/(R T_o)) of Eq 3 in kg/s: 416.86 for 1 m² of air."""
    gas = compressor.gamma / (compressor.gas_constant_J_kg_K * T_STANDARD_K)
    return float(area_m2 * P_STANDARD_PA * np.sqrt(gas))


def _choked_share(gamma: float) -> float:
    """Return the share of that constant that passes at M = 1."""
    return float((2.0 / (gamma + 1.0)) ** _exponent(gamma))


def _exponent(gamma: float) -> float:
    return (gamma + 1.0) / (2.0 * (gamma - 1.0))


def _expansion(mach: FloatArray, gamma: float) -> FloatArray:
    """Return (1 + (γ−1)/2 M²)^((γ+1)/(2(γ−1))), whose exponent is 3 for γ = 1.4."""
    return np.asarray((1.0 + 0.5 * (gamma - 1.0) * mach**2) ** _exponent(gamma))
