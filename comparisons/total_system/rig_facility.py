"""The facility numbers of the simulated rig: what its test engineer would hand over."""

from __future__ import annotations

import re

from comparisons.rig import CASES
from comparisons.rig.cases import find_case
from comparisons.total_system.facility import (
    Compressor,
    Facility,
    Heat,
    Inlet,
    Supply,
    Throttle,
    Volumes,
)

__all__ = ["facility_of_case", "rig_case_of_test"]


def facility_of_case(name: str) -> Facility:
    """Return the facility of a case of the simulated rig.

    Parameters
    ----------
    name : str
        A name out of `comparisons.rig.CASES`. Only its numbers are read.

    Returns
    -------
    Facility
        The numbers.

    Raises
    ------
    InputError
        When no case has that name.
    """
    case = find_case(name)
    return Facility(
        volumes=Volumes(
            discharge_m3=case.discharge_volume_m3,
            exhaust_m3=case.exhaust_volume_m3,
            inlet_m3=case.inlet_volume_m3,
            face_m3=case.face_volume_m3,
        ),
        inlet=Inlet(inertia_per_m=case.inlet_inertia_per_m, loss_frac=case.inlet_loss_frac),
        supply=Supply(
            temperature_K=case.supply_temperature_k,
            slope_kg_s_Pa=case.supply_pump_kg_s_pa,
            coil_effectiveness=case.coil_effectiveness,
            coil_lag_s=case.coil_lag_s,
        ),
        throttle=Throttle(
            exhaust_pressure_frac=case.exhaust_pressure_frac,
            close_start_s=case.close_start_s,
            close_rate_per_s=case.close_rate_per_s,
            open_ratio=case.open_reference * case.open_ratio,
            open_lag_s=case.open_lag_s,
        ),
        heat=Heat(
            recirculation_frac=case.recirculation_frac,
            recirculation_work=case.recirculation_work,
            recirculation_exchange=case.recirculation_exchange,
            reverse_heat_frac=case.reverse_heat_frac,
        ),
        compressor=Compressor(
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
        ),
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
