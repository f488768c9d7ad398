"""Eq 1 to 4: from the pressures of a probe pair to flow, with the rule for reversed flow."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from classic_ml.errors import InputError
from classic_ml.readers.test_description import Compressor, ProbePair, TestDescription
from classic_ml.records import Channel, FloatArray, LedgerEntry, Record

__all__ = [
    "LBM_KG",
    "P_STANDARD_PA",
    "T_STANDARD_K",
    "calculated_mach",
    "corrected_flow",
    "corrected_from_physical",
    "local_flows",
    "mach_from_corrected_flow",
    "physical_flow",
    "plane_averages",
    "true_mach",
]

# US standard day, as the paper's corrected quantities use it, and the avoirdupois pound.
P_STANDARD_PA = 101_325.0
T_STANDARD_K = 288.15
LBM_KG = 0.45359237


def calculated_mach(forward_Pa: FloatArray, aft_Pa: FloatArray, gamma: float) -> FloatArray:
    """Return the signed calculated Mach number of a probe pair.

    Parameters
    ----------
    forward_Pa, aft_Pa : ndarray of shape (n,)
        Pressures of the forward and the aft probe. In reversed flow the aft probe reads the
        total pressure and the forward one the wake; the Mach number is then negative.
    gamma : float
        Ratio of the specific heats.

    Returns
    -------
    ndarray of shape (n,)
        M_calc = ±√{2/(γ−1) [(P_high/P_low)^((γ−1)/γ) − 1]}, Eq 1 with the reverse rule.
    """
    ratio = np.maximum(forward_Pa, aft_Pa) / np.minimum(forward_Pa, aft_Pa)
    square = 2.0 / (gamma - 1.0) * (ratio ** ((gamma - 1.0) / gamma) - 1.0)
    return np.asarray(np.sign(forward_Pa - aft_Pa) * np.sqrt(square))


def true_mach(calculated: FloatArray, slope: float, offset: float) -> FloatArray:
    """Return the signed true Mach number, M_true = ±(a |M_calc| + b) (Eq 2).

    Parameters
    ----------
    calculated : ndarray of shape (n,)
        Signed M_calc.
    slope, offset : float
        a and b of the pair, from its flow calibration; the same in reversed flow.

    Returns
    -------
    ndarray of shape (n,)
        Signed M_true; zero where the probes read alike, since the sign is not known there.
    """
    magnitude = np.maximum(slope * np.abs(calculated) + offset, 0.0)
    return np.asarray(np.sign(calculated) * magnitude)


def _flow_constant(area_m2: float, compressor: Compressor) -> float:
    """Return A P_o √(γ/(R T_o)): 416.86 kg/s for 1 m² of air."""
    gas = compressor.gamma / (compressor.gas_constant_J_kg_K * T_STANDARD_K)
    return float(area_m2 * P_STANDARD_PA * np.sqrt(gas))


def corrected_flow(mach: FloatArray, area_m2: float, compressor: Compressor) -> FloatArray:
    """Return the corrected flow for a Mach number, odd in it (Eq 3).

    Parameters
    ----------
    mach : ndarray of shape (n,)
        Signed true Mach number.
    area_m2 : float
        Flow area of the plane.
    compressor : Compressor
        For γ and R.

    Returns
    -------
    ndarray of shape (n,)
        W_c = A P_o √(γ/(R T_o)) M / (1 + (γ−1)/2 M²)^((γ+1)/(2(γ−1))), in kg/s.
    """
    gamma = compressor.gamma
    exponent = (gamma + 1.0) / (2.0 * (gamma - 1.0))
    swallowed = mach / (1.0 + 0.5 * (gamma - 1.0) * mach**2) ** exponent
    return np.asarray(_flow_constant(area_m2, compressor) * swallowed)


def mach_from_corrected_flow(
    corrected_kg_s: FloatArray, area_m2: float, compressor: Compressor
) -> FloatArray:
    """Invert Eq 3 on its subsonic branch.

    Parameters
    ----------
    corrected_kg_s : ndarray of shape (n,)
        Signed corrected flow, in kg/s.
    area_m2 : float
        Flow area of the plane.
    compressor : Compressor
        For γ and R.

    Returns
    -------
    ndarray of shape (n,)
        Signed Mach number, |M| ≤ 1.

    Raises
    ------
    InputError
        When the flow is more than the area can pass.
    """
    gamma = compressor.gamma
    exponent = (gamma + 1.0) / (2.0 * (gamma - 1.0))
    target = np.abs(np.asarray(corrected_kg_s)) / _flow_constant(area_m2, compressor)
    choked = (2.0 / (gamma + 1.0)) ** exponent
    if np.any(target > choked):
        raise InputError(
            "corrected flow",
            expected=f"at most {choked * _flow_constant(area_m2, compressor):.4g} kg/s through "
            f"{area_m2:g} m²",
            found=f"{np.max(target) * _flow_constant(area_m2, compressor):.4g} kg/s",
            remedy="check the area and the calibration of the probes",
        )
    mach = target.copy()
    # m ← target·(1 + (γ−1)/2 m²)^e converges from below; Newton on the logarithm finishes it in
    # a few steps everywhere but at the choke itself, where the slope is zero.
    for _ in range(60):
        bracket = 1.0 + 0.5 * (gamma - 1.0) * mach**2
        residual = mach / bracket**exponent - target
        slope = (1.0 - mach**2) / bracket ** (exponent + 1.0)
        step = residual / np.maximum(slope, 1e-6)
        mach = np.clip(mach - step, 0.0, 1.0)
        if np.max(np.abs(step), initial=0.0) < 1e-14:
            break
    return np.asarray(np.sign(corrected_kg_s) * mach)


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


def present_pairs(record: Record, test: TestDescription, plane: int) -> tuple[ProbePair, ...]:
    """Return the pairs whose two probes are (still) in the record."""
    return tuple(
        pair
        for pair in test.pairs(plane)
        if pair.forward.name in record and pair.aft.name in record
    )


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
    """
    added: list[Channel] = []
    reversed_share: dict[str, str | int | float | bool] = {}
    for plane, area in test.areas_m2.items():
        for pair in present_pairs(record, test, plane):
            forward, aft = record[pair.forward.name], record[pair.aft.name]
            _check_absolute(record, pair)
            calculated = calculated_mach(forward, aft, test.compressor.gamma)
            mach = true_mach(calculated, pair.forward.probe_slope, pair.forward.probe_offset)
            flow = corrected_flow(mach, area, test.compressor)
            total = np.maximum(forward, aft)
            added.append(Channel(f"Wc{pair.name}_kg_s", flow, "kg/s"))
            added.append(Channel(f"Pt{pair.name}_Pa", total, "Pa"))
            reversed_share[f"reversed_{pair.name}"] = round(float(np.mean(flow < 0.0)), 4)
    entry = LedgerEntry(
        "local flows",
        f"Eq 1 to 3 at {len(added) // 2} probe pairs; the share of rows with reversed flow is in "
        "the parameters",
        reversed_share,
    )
    return record.after(entry, add=added)


def _check_absolute(record: Record, pair: ProbePair) -> None:
    for probe in (pair.forward, pair.aft):
        values = record[probe.name]
        if np.min(values) <= 0.0:
            row = int(np.argmin(values))
            raise InputError(
                f"{record.source}: channel {probe.name}",
                expected="a positive absolute pressure",
                found=f"{values[row]:g} Pa at {record.time_s[row]:.3f} s",
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
    wanted = ("tip", "hub") if probes == "all" else (probes,)
    added: list[Channel] = []
    for plane in test.areas_m2:
        pairs = present_pairs(record, test, plane)
        by_place = {i: [p.name for p in pairs if p.immersion == i] for i in ("tip", "hub")}
        used = [
            i for i in wanted if by_place[i] or any(p.immersion == i for p in test.pairs(plane))
        ]
        _check_places(record, plane, used, by_place)
        flow = {
            i: _mean(record[f"Wc{n}_kg_s"] for n in by_place[i]) for i in by_place if by_place[i]
        }
        total = {i: _mean(record[f"Pt{n}_Pa"] for n in by_place[i]) for i in used}
        corrected = _mean(flow[i] for i in used)
        pressure = _mean(total[i] for i in used)
        added.append(Channel(f"Wc{plane}_kg_s", corrected, "kg/s"))
        added += [Channel(f"Wc{plane}_{i}_kg_s", values, "kg/s") for i, values in flow.items()]
        added.append(Channel(f"P{plane}_Pa", pressure, "Pa"))
        couples = [c.name for c in test.thermocouples(plane) if c.name in record]
        if couples:
            temperature = _mean(record[name] for name in couples)
            added.append(Channel(f"T{plane}_K", temperature, "K"))
            added.append(
                Channel(f"W{plane}_kg_s", physical_flow(corrected, pressure, temperature), "kg/s")
            )
        elif plane == 25:
            raise InputError(
                f"{record.source}: plane 25",
                expected="at least one thermocouple that can be used",
                found="none",
                remedy="without T25 there is neither φ nor ψ'",
            )
    entry = LedgerEntry(
        "plane averages",
        f"arithmetic mean over rakes and immersions ({probes}), Eq 4 at each plane",
        {
            "probes": probes,
            **{f"pairs_{p}": len(present_pairs(record, test, p)) for p in test.areas_m2},
        },
    )
    return record.after(entry, add=added)


def _check_places(
    record: Record, plane: int, used: list[str], by_place: dict[str, list[str]]
) -> None:
    missing = [i for i in used if not by_place[i]]
    if missing or not used:
        raise InputError(
            f"{record.source}: plane {plane}",
            expected="at least one usable probe pair at " + (" and ".join(missing) or "a place"),
            found="none",
            remedy="the history of the record says which were left out and why",
        )


def _mean(values: Iterable[FloatArray]) -> FloatArray:
    return np.asarray(np.mean(np.stack(list(values)), axis=0))
