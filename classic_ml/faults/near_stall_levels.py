"""What the reading near stall says that no one probe does: of a whole plane, and of the machine.

A probe that differs from those beside it is told by them. What is wrong with all of a plane alike,
or with the machine that test.toml describes, shows in levels alone, which may be unusual and right:
these are flags.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.records import Record

__all__ = ["beside_the_record", "common_shifts", "unusual_machine"]

# The match near stall is for the drift of single amplifiers: on 28 clean records of three rigs the
# probes of a plane are off by 0.08 % of the reading on average at most, and by 0.5 % each. P31 that
# is off by 2 % moves τ by 1 to 2 ms of 18 on three of them, by 5 % by 4 to 14, by 10 % by 20 to 30.
COMMON_SHARE = 0.02
# In standard deviations of the probes.
COMMON_SPREADS = 3.0
# Of two probes nobody knows which one is wrong.
FEWEST_PROBES = 3
# A stage raises the pressure coefficient by 0.4 to 1 near stall, an axial compressor has 17 stages
# at most, and they are the less loaded; its flow coefficient is 0.3 to 0.6.
MOST_PSI_P, MOST_PHI = 15.0, 0.8
# Of the design speed; machines are tested up to a tenth above it.
MOST_SPEED = 1.2
# Rows of the reading of the facility that are not in the record.
FEWEST_ROWS_BESIDE = 2
STANDARD_K = 288.15


def common_shifts(test: TestDescription, shifts_Pa: Mapping[str, float]) -> tuple[str, ...]:
    """Return a flag for each plane of which all probes are off the facility's reading alike.

    Parameters
    ----------
    test : TestDescription
        The facility's reading.
    shifts_Pa : mapping of str to float
        By forward probe, what takes it to the reading; 0 for one that does not count.

    Returns
    -------
    tuple of str
        The flags.
    """
    flags = []
    for plane in test.areas_m2:
        forward = [pair.forward.name for pair in test.pairs(plane)]
        shifts = [shifts_Pa[name] for name in forward if shifts_Pa.get(name, 0.0) != 0.0]
        target = test.near_stall.pressure_Pa(plane)
        if _is_common(shifts, target):
            share = -float(np.mean(shifts)) / target
            flags.append(
                f"near stall all probes of plane {plane} read {abs(share):.1%} "
                f"{'above' if share > 0.0 else 'below'} the facility ({abs(share) * target:.3g} "
                f"Pa, {np.std(shifts):.2g} Pa apart): is P{plane}_Pa of [near_stall] in "
                f"{test.source} right, or the calibrate_pressure_Pa and zoc_reference_Pa of all of "
                "them? the match hides it, and τ follows"
            )
    return tuple(flags)


def _is_common(shifts: Sequence[float], target: float) -> bool:
    if len(shifts) < FEWEST_PROBES:
        return False
    mean = abs(float(np.mean(shifts)))
    return mean > COMMON_SHARE * target and mean > COMMON_SPREADS * float(np.std(shifts))


def unusual_machine(test: TestDescription, phi: float) -> tuple[str, ...]:
    """Return a flag where φ, ψ' or the corrected speed near stall are those of no usual machine.

    Parameters
    ----------
    test : TestDescription
        Speed, radius, and the facility's reading.
    phi : float
        Flow coefficient near stall.

    Returns
    -------
    tuple of str
        The flag, or nothing.
    """
    reading, gamma = test.near_stall, test.compressor.gamma
    ratio = reading.P31_Pa / reading.P25_Pa
    heat = test.compressor.specific_heat_J_kg_K * reading.T25_K
    psi_p = 2.0 * heat / test.rotor_velocity_m_s**2 * (ratio ** ((gamma - 1.0) / gamma) - 1.0)
    corrected_rpm = test.rotor_speed_rpm * (STANDARD_K / reading.T25_K) ** 0.5
    speed = corrected_rpm / test.design_corrected_speed_rpm
    odd = []
    if phi > MOST_PHI:
        odd.append(f"φ is {phi:.2f}, above {MOST_PHI:g}")
    if psi_p > MOST_PSI_P:
        odd.append(f"ψ' is {psi_p:.1f}, more than {MOST_PSI_P:g} of any number of stages")
    if speed > MOST_SPEED:
        odd.append(f"the corrected speed is {speed:.0%} of that of the design")
    if not odd:
        return ()
    return (
        f"near stall {' and '.join(odd)}: check rotor_speed_rpm, mean_radius_m and "
        f"design_corrected_speed_rpm in {test.source}",
    )


def beside_the_record(record: Record, test: TestDescription) -> tuple[str, ...]:
    """Return a flag where a part of the facility's reading is not in the record.

    Parameters
    ----------
    record : Record
        The record.
    test : TestDescription
        When the reading was taken.

    Returns
    -------
    tuple of str
        The flag, or nothing.
    """
    reading, period_s = test.near_stall, record.sample_period_s
    first_s, last_s = record.time_at_s(0), record.time_at_s(record.n_samples - 1)
    beside_s = max(first_s - reading.from_s, reading.to_s - last_s)
    if beside_s < FEWEST_ROWS_BESIDE * period_s:
        return ()
    within_s = min(reading.to_s, last_s) - max(reading.from_s, first_s)
    return (
        f"[near_stall] of {test.source} is {reading.from_s:g} to {reading.to_s:g} s, of which "
        f"{within_s:.3g} s are in the record ({first_s:g} to {last_s:g} s): do both go by the same "
        "clock?",
    )
