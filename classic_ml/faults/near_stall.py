"""The steady flow near stall: is it steady, and does all that reads it read one machine?

A probe that differs from those beside it is found by them. What is wrong with all of a plane alike
shows in levels alone, which may be unusual and right: these are flags.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from classic_ml.calibration import near_stall_rows
from classic_ml.coefficients import flow_coefficient
from classic_ml.description import TestDescription
from classic_ml.faults.choice import choose_channels
from classic_ml.flow import local_flows, physical_flow, plane_averages
from classic_ml.records import LedgerEntry, Record
from surge_core.errors import InputError

# On 12 untouched records the end of the reading differs from the rest by 0.07 % at most; a machine
# that is throttled slowly towards its limit drifts by a few per cent.
STEADY = 0.05
# The last part of the reading, which runs into the surge where it was chosen too long.
LAST_SHARE = 0.2
# Of fewer probes each may be off alone.
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


def check_near_stall(
    record: Record, test: TestDescription, shifts: Mapping[str, float]
) -> LedgerEntry:
    """Check φ, and the flow of one plane against the other's, in the steady flow near stall.

    The record is calibrated and matched; ``shifts`` is what the match has added to each channel. It
    is refused when the flow is not steady, W25 and W31 differ by more than a fifth, or no
    compressor has such a φ.
    """
    if test.near_stall_shifts:
        return LedgerEntry("near-stall flow", "not known: the reading is not in this record")
    steady = record.part(near_stall_rows(record, test))
    _check_steady(steady, test)
    # No row is in a window yet: only what cannot be matched is left out here.
    steady = choose_channels(steady, test, slice(0, 0))
    steady = plane_averages(local_flows(steady, test), test)
    findings = _common_shifts(test, shifts)
    how = "" if "W31_kg_s" in steady else " (with the facility's T31)"
    exit_K = steady["T31_K"] if not how else np.full(1, test.near_stall.temperature_K(31))
    inlet = float(np.mean(steady["W25_kg_s"]))
    leaving = float(np.mean(physical_flow(steady["Wc31_kg_s"], steady["P31_Pa"], exit_K)))
    differ = abs(leaving / inlet - 1.0)
    if differ > FLOWS_REFUSED and not how:
        raise InputError(
            f"{steady.source}: flow near stall",
            expected=f"W25 and W31 within {FLOWS_REFUSED:.0%} of each other",
            found=f"{inlet:.4g} and {leaving:.4g} kg/s",
            remedy="check area_m2 of [planes.25] and [planes.31], and the zero and calibrate "
            f"readings in {test.source}",
        )
    if differ > FLOWS_DIFFER:
        findings.append(
            f"near stall W25 is {inlet:.4g} kg/s and W31 {leaving:.4g} kg/s{how}: check area_m2 "
            f"of [planes.25] and [planes.31] in {test.source}"
        )
    columns = steady["Wc25_kg_s"], steady["T25_K"]
    area_m2, speed_m_s = test.areas_m2[25], test.rotor_velocity_m_s
    phi = float(np.mean(flow_coefficient(*columns, area_m2, speed_m_s, test.compressor)))
    if not NEAR_STALL_PHI[0] <= phi <= NEAR_STALL_PHI[1]:
        # The area is not among the causes: it cancels between Eq 3 and its inverse.
        raise InputError(
            f"{steady.source}: φ near stall",
            expected="{:g} to {:g}".format(*NEAR_STALL_PHI),
            found=f"{phi:.3g}",
            remedy="check rotor_speed_rpm, mean_radius_m, and the zero and calibrate readings in "
            f"{test.source}",
        )
    return LedgerEntry(
        "near-stall flow",
        f"φ {phi:.3f}, W25 {inlet:.2f} kg/s, W31 {leaving:.2f} kg/s{how}",
        {"phi": round(phi, 4), "W25_kg_s": round(inlet, 4), "W31_kg_s": round(leaving, 4)},
        flags=tuple(findings),
    )


def _common_shifts(test: TestDescription, shifts_Pa: Mapping[str, float]) -> list[str]:
    """Return each plane of which all probes are off the facility's reading alike."""
    findings = []
    for plane in test.areas_m2:
        forward = [pair.forward.name for pair in test.pairs(plane)]
        shifts = [shifts_Pa[name] for name in forward if shifts_Pa.get(name, 0.0) != 0.0]
        if len(shifts) < FEWEST:
            continue
        mean, spread = -float(np.mean(shifts)), float(np.std(shifts))
        share = abs(mean) / test.near_stall.pressure_Pa(plane)
        if share > COMMON_SHARE and abs(mean) > COMMON_SPREADS * spread:
            findings.append(
                f"near stall all probes of plane {plane} read {share:.1%} "
                f"{'above' if mean > 0.0 else 'below'} the facility ({abs(mean):.3g} Pa, "
                f"{spread:.2g} Pa apart): is P{plane}_Pa of [near_stall] in {test.source} right, "
                "or the calibrate_pressure_Pa and zoc_reference_Pa of all of them? the match hides "
                "it, and τ follows"
            )
    return findings


def _check_steady(steady: Record, test: TestDescription) -> None:
    """Refuse a near-stall reading that ends in another state than it began."""
    last = round((1.0 - LAST_SHARE) * steady.n_samples)
    for probe in test.pressures:
        if steady.marks(probe.name).any():
            # What is clipped or stuck there is left out when the channels are chosen.
            continue
        values = steady[probe.name]
        move = float(np.mean(values[last:]) / np.mean(values[:last]) - 1.0)
        if abs(move) > STEADY:
            reading = test.near_stall
            raise InputError(
                f"{test.source}: [near_stall]",
                expected=f"a steady part of the record, as the reading of the facility is "
                f"({reading.from_s:g} to {reading.to_s:g} s)",
                found=f"{probe.name} {move:+.0%} in its last fifth",
                remedy="let it end before the surge begins",
            )
