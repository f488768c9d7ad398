"""The facility numbers of the simulated rig: what its test engineer would hand over."""

from __future__ import annotations

import re

from comparisons.rig import CASES, RigCase
from comparisons.total_system.facility import Facility
from surge_core.errors import InputError

__all__ = ["facility_of_case", "rig_case_of_test"]

_AMBIENT_PA = 101_325.0


def facility_of_case(case: str | RigCase) -> Facility:
    """Return the facility of a case of the simulated rig.

    Parameters
    ----------
    case : str or RigCase
        A name out of `comparisons.rig.CASES`, or a case. Only its numbers are read.

    Returns
    -------
    Facility
        The numbers.

    Raises
    ------
    InputError
        When no case has that name.
    """
    if isinstance(case, str):
        if case not in CASES:
            raise InputError("case", expected="one of " + ", ".join(CASES), found=repr(case))
        case = CASES[case]
    return Facility(
        discharge_volume_m3=case.discharge_volume_m3,
        exhaust_volume_m3=case.exhaust_volume_m3,
        inlet_volume_m3=case.inlet_volume_m3,
        face_volume_m3=case.face_volume_m3,
        inlet_inertia_per_m=case.inlet_inertia_per_m,
        inlet_loss_frac=case.inlet_loss_frac,
        supply_temperature_k=case.supply_temperature_k,
        supply_slope_kg_s_pa=case.supply_pump_kg_s_pa,
        coil_effectiveness=case.coil_effectiveness,
        coil_lag_s=case.coil_lag_s,
        exhaust_pressure_frac=case.exhaust_pressure_frac,
        ambient_pressure_pa=_AMBIENT_PA,
        throttle_area_factor=1.0,
        close_start_s=case.close_start_s,
        close_rate_per_s=case.close_rate_per_s,
        open_ratio=case.open_reference * case.open_ratio,
        open_lag_s=case.open_lag_s,
        recirculation_frac=case.recirculation_frac,
        recirculation_work=case.recirculation_work,
        recirculation_exchange=case.recirculation_exchange,
        reverse_heat_frac=case.reverse_heat_frac,
        reverse_loss=case.reverse_loss,
        recovery_phi=case.recovery_phi,
        rearm_phi=case.rearm_phi,
        stall_speed_low_frac=case.stall_speeds[0],
        stall_speed_high_frac=case.stall_speeds[1],
        stall_phi_low=case.stall_phis[0],
        stall_phi_high=case.stall_phis[1],
        stall_psi_p_low=case.stall_psi_ps[0],
        stall_psi_p_high=case.stall_psi_ps[1],
        unstalled_droop=case.unstalled_droop,
        unstalled_efficiency=case.unstalled_efficiency,
        blend_s=case.blend_s,
        work_intercept=case.work_intercept,
        work_slope_1=case.work_slopes[0],
        work_slope_2=case.work_slopes[1],
        work_slope_3=case.work_slopes[2],
        work_break_1=case.work_breaks[0],
        work_break_2=case.work_breaks[1],
    )


def rig_case_of_test(name: str) -> str | None:
    """Return the case that a test of the simulated rig names itself after, else None.

    Parameters
    ----------
    name : str
        Name of the test, as in test.toml.
    """
    found = re.fullmatch(r"simulated rig, case (\S+)", name)
    return found.group(1) if found and found.group(1) in CASES else None
