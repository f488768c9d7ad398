"""The steady flow near stall: is it steady, and does all that reads it read one machine?

A probe that differs from those beside it is found by them. What is wrong with all of a plane alike,
or with the machine that test.toml describes, shows in levels alone, which may be unusual and right:
these are flags.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from classic_ml.calibration import near_stall_rows
from classic_ml.coefficients import flow_coefficient
from classic_ml.description import ProbePair, TestDescription
from classic_ml.faults.choice import choose_channels
from classic_ml.faults.findings import Finding, marked_rows
from classic_ml.flow import T_STANDARD_K, physical_flow
from classic_ml.planes import local_flows, plane_averages, present_pairs
from classic_ml.records import LedgerEntry, Record
from surge_core.errors import InputError

__all__ = ["check_near_stall", "common_shifts"]

# On 12 untouched records the end of the reading differs from the rest by 0.07 % at most; a machine
# that is throttled slowly towards its limit drifts by a few per cent.
STEADY = 0.05
# The last part of the reading, which runs into the surge where it was chosen too long.
LAST_SHARE = 0.2
# Hub and tip of a real machine differ near stall, but not by a factor.
FLOW_FACTOR = 2.0
# Pairs at one immersion of the same records differ by 1.5 % at most.
SAME_IMMERSION = 0.1
# Of two probes or pairs that differ either may be wrong.
FEWEST = 3
# In the steady flow near stall the planes pass the same but for bleeds of a few per cent (0.3 % on
# the independent record); exchanged areas are a factor of twenty.
FLOWS_DIFFER, FLOWS_REFUSED = 0.05, 0.2
# An axial compressor near stall is at φ of 0.3 to 0.6, a centrifugal one above 0.1.
NEAR_STALL_PHI = (0.1, 1.5)
# The match near stall is for the drift of single amplifiers: on 28 clean records of three rigs the
# probes of a plane are off by 0.08 % of the reading on average at most, and by 0.5 % each. P31 that
# is off by 2 % moves τ by 1 to 2 ms of 18 on three of them, by 5 % by 4 to 14, by 10 % by 20 to 30.
COMMON_SHARE = 0.02
# In standard deviations of the probes.
COMMON_SPREADS = 3.0
# A stage raises the pressure coefficient by 0.4 to 1 near stall, an axial compressor has 17 stages
# at most, and they are the less loaded; its flow coefficient is 0.3 to 0.6. Machines are tested up
# to a tenth above their design speed.
MOST_PSI_P, MOST_PHI, MOST_SPEED = 15.0, 0.8, 1.2


def check_near_stall(
    record: Record, test: TestDescription, shifts: Mapping[str, float]
) -> LedgerEntry:
    """Check φ, and the flow of one plane against the other's, in the steady flow near stall.

    Parameters
    ----------
    record : Record
        Calibrated and matched.
    test : TestDescription
        Its test.
    shifts : mapping of str to float
        What the match has added to each channel.

    Returns
    -------
    LedgerEntry
        What was found.

    Raises
    ------
    InputError
        When the flow is not steady, pairs of one plane contradict each other, W25 and W31 differ
        by more than a fifth, or no compressor has such a φ near stall.
    """
    if test.near_stall_shifts:
        return LedgerEntry("near-stall flow", "not known: the reading is not in this record")
    steady = record.part(near_stall_rows(record, test))
    _check_steady(steady, test)
    # No row is in a window yet: only what cannot be matched is left out here.
    steady = local_flows(choose_channels(steady, test, slice(0, 0)), test)
    findings = [*common_shifts(test, shifts), *_differing_pairs(steady, test)]
    steady = plane_averages(steady, test)
    inlet, leaving = _steady_flows(steady, test)
    how = "" if "W31_kg_s" in steady else " (with the facility's T31)"
    differ = abs(leaving / inlet - 1.0)
    if differ > FLOWS_REFUSED and not how:
        raise InputError(
            f"{record.source}: flow near stall",
            expected=f"W25 and W31 within {FLOWS_REFUSED:.0%} of each other",
            found=f"{inlet:.4g} and {leaving:.4g} kg/s",
            remedy=f"check area_m2 of [planes.25] and [planes.31] in {test.source} "
            f"({test.areas_m2[25]:g} and {test.areas_m2[31]:g} m²)",
        )
    phi = _steady_phi(steady, test)
    findings += _unusual_machine(test, phi)
    if differ > FLOWS_DIFFER:
        details: dict[str, str | float] = {
            "inlet": inlet,
            "leaving": leaving,
            "how": how,
            "source": test.source,
        }
        findings.append(Finding("planes differ", details=details))
    return LedgerEntry(
        "near-stall flow",
        f"φ {phi:.3f}, W25 {inlet:.2f} kg/s, W31 {leaving:.2f} kg/s{how}",
        {"phi": round(phi, 4), "W25_kg_s": round(inlet, 4), "W31_kg_s": round(leaving, 4)},
        flags=tuple(finding.sentence for finding in findings),
    )


def common_shifts(test: TestDescription, shifts_Pa: Mapping[str, float]) -> list[Finding]:
    """Return each plane of which all probes are off the facility's reading alike.

    Parameters
    ----------
    test : TestDescription
        The facility's reading.
    shifts_Pa : mapping of str to float
        By forward probe, what takes it to the reading; 0 for one that does not count.
    """
    findings = []
    for plane in test.areas_m2:
        forward = [pair.forward.name for pair in test.pairs(plane)]
        shifts = [shifts_Pa[name] for name in forward if shifts_Pa.get(name, 0.0) != 0.0]
        target = test.near_stall.pressure_Pa(plane)
        if not _is_common(shifts, target):
            continue
        mean = -float(np.mean(shifts))
        details: dict[str, str | float] = {
            "plane": plane,
            "share": abs(mean) / target,
            "side": "above" if mean > 0.0 else "below",
            "shift_Pa": abs(mean),
            "spread_Pa": float(np.std(shifts)),
            "source": test.source,
        }
        findings.append(Finding("common shift", details=details))
    return findings


def _is_common(shifts: Sequence[float], target: float) -> bool:
    if len(shifts) < FEWEST:
        return False
    mean = abs(float(np.mean(shifts)))
    return mean > COMMON_SHARE * target and mean > COMMON_SPREADS * float(np.std(shifts))


def _check_steady(steady: Record, test: TestDescription) -> None:
    """Refuse a near-stall reading that ends in another state than it began."""
    last = round((1.0 - LAST_SHARE) * steady.n_samples)
    moves = {}
    for probe in test.pressures:
        marks = marked_rows(steady, probe.name)
        # What is clipped or stuck there is left out when the channels are chosen.
        if marks is None or not marks.any():
            values = steady[probe.name]
            moves[probe.name] = float(np.mean(values[last:]) / np.mean(values[:last]) - 1.0)
    name = max(moves, key=lambda n: abs(moves[n]), default="")
    if name and abs(moves[name]) > STEADY:
        reading = test.near_stall
        raise InputError(
            f"{test.source}: [near_stall]",
            expected=f"a steady part of the record, as the reading of the facility is "
            f"({reading.from_s:g} to {reading.to_s:g} s)",
            found=f"{name} {moves[name]:+.0%} in its last fifth",
            remedy="let it end before the surge begins",
        )


def _differing_pairs(steady: Record, test: TestDescription) -> list[Finding]:
    """Compare the flow at each pair of a plane with that at the others.

    A pair whose flow is another one's by a factor is refused: its calibration is wrong.
    """
    findings = []
    for plane in test.areas_m2:
        pairs = present_pairs(steady, test, plane)
        mean = {pair.name: float(np.mean(steady[f"Wc{pair.name}_kg_s"])) for pair in pairs}
        if len(pairs) >= FEWEST:
            for pair in pairs:
                _check_pair(steady, test, pair, mean)
        for immersion in dict.fromkeys(pair.immersion for pair in pairs):
            flows = {p.name: mean[p.name] for p in pairs if p.immersion == immersion}
            low, high = min(flows, key=flows.__getitem__), max(flows, key=flows.__getitem__)
            if flows[high] > (1.0 + SAME_IMMERSION) * flows[low]:
                details: dict[str, str | float] = {
                    "low": low,
                    "high": high,
                    "lowest": flows[low],
                    "highest": flows[high],
                }
                findings.append(Finding("pairs differ", details=details))
    return findings


def _check_pair(
    steady: Record, test: TestDescription, pair: ProbePair, mean: Mapping[str, float]
) -> None:
    others = float(np.median([flow for name, flow in mean.items() if name != pair.name]))
    # No forward flow near stall at all is another fault, and reported as such.
    if others <= 0.0 or others < FLOW_FACTOR * mean[pair.name] < FLOW_FACTOR**2 * others:
        return
    raise InputError(
        f"{steady.source}: pair P{pair.name}",
        expected=f"about the corrected flow of the others of plane {pair.forward.plane} near stall "
        f"({others:.3g} kg/s)",
        found=f"{mean[pair.name]:.3g}",
        remedy=f"check the zero and calibrate readings, references and probe slope of "
        f"{pair.forward.name} and {pair.aft.name} in {test.source}",
    )


def _unusual_machine(test: TestDescription, phi: float) -> list[Finding]:
    """Return where φ, ψ' or the corrected speed near stall are those of no usual machine."""
    reading, gamma = test.near_stall, test.compressor.gamma
    ratio = reading.P31_Pa / reading.P25_Pa
    heat = test.compressor.specific_heat_J_kg_K * reading.T25_K
    psi_p = 2.0 * heat / test.rotor_velocity_m_s**2 * (ratio ** ((gamma - 1.0) / gamma) - 1.0)
    corrected_rpm = test.rotor_speed_rpm * (T_STANDARD_K / reading.T25_K) ** 0.5
    speed = corrected_rpm / test.design_corrected_speed_rpm
    odd = []
    if phi > MOST_PHI:
        odd.append(f"φ is {phi:.2f}, above {MOST_PHI:g}")
    if psi_p > MOST_PSI_P:
        odd.append(f"ψ' is {psi_p:.1f}, more than {MOST_PSI_P:g} of any number of stages")
    if speed > MOST_SPEED:
        odd.append(f"the corrected speed is {speed:.0%} of that of the design")
    if not odd:
        return []
    details: dict[str, str | float] = {"what": " and ".join(odd), "source": test.source}
    return [Finding("unusual machine", details=details)]


def _steady_phi(steady: Record, test: TestDescription) -> float:
    """Return the mean φ, or refuse one that no compressor has."""
    columns = steady["Wc25_kg_s"], steady["T25_K"]
    area_m2, speed_m_s = test.areas_m2[25], test.rotor_velocity_m_s
    phi = float(np.mean(flow_coefficient(*columns, area_m2, speed_m_s, test.compressor)))
    if NEAR_STALL_PHI[0] <= phi <= NEAR_STALL_PHI[1]:
        return phi
    raise InputError(
        f"{steady.source}: φ near stall",
        expected=f"{NEAR_STALL_PHI[0]:g} to {NEAR_STALL_PHI[1]:g}",
        found=f"{phi:.3g}",
        # The area is not among them: it cancels between Eq 3 and its inverse.
        remedy=f"check rotor_speed_rpm and mean_radius_m in {test.source}, and the zero and "
        "calibrate readings",
    )


def _steady_flows(steady: Record, test: TestDescription) -> tuple[float, float]:
    """Return W25 and W31, the latter with the facility's T31 where no thermocouple counts."""
    inlet = float(np.mean(steady["W25_kg_s"]))
    if "W31_kg_s" in steady:
        return inlet, float(np.mean(steady["W31_kg_s"]))
    exit_K = np.full(steady.n_samples, test.near_stall.temperature_K(31))
    return inlet, float(np.mean(physical_flow(steady["Wc31_kg_s"], steady["P31_Pa"], exit_K)))
