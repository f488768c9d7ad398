"""The facility numbers of the simulated rig: what its test engineer would hand over."""

from __future__ import annotations

import re

from comparisons.rig import CASES
from comparisons.rig.cases import find_case
from comparisons.total_system.facility import Facility


def facility_of_case(name: str) -> Facility:
    """Return the facility of a case of the simulated rig.

    Parameters
    ----------
    name : str
        A name out of `comparisons.rig.CASES`. Only its numbers are read.

    Raises
    ------
    InputError
        When no case has that name.
    """
    case = find_case(name)
    # Numbers that have another name in the rig, or stand in a tuple there.
    own = {
        "temperature_K": case.supply_temperature_k,
        "slope_kg_s_Pa": case.supply_pump_kg_s_pa,
        "inertia_per_m": case.inlet_inertia_per_m,
        "loss_frac": case.inlet_loss_frac,
        "open_ratio": case.open_reference * case.open_ratio,
    }
    for volume in ("discharge", "exhaust", "inlet", "face"):
        own[f"{volume}_m3"] = getattr(case, f"{volume}_volume_m3")
    for i, end in enumerate(("low", "high")):
        own[f"stall_speed_{end}_frac"] = case.stall_speeds[i]
        own[f"stall_phi_{end}"] = case.stall_phis[i]
        own[f"stall_psi_p_{end}"] = case.stall_psi_ps[i]
        own[f"work_break_{i + 1}"] = case.work_breaks[i]
    own |= {f"work_slope_{i}": slope for i, slope in enumerate(case.work_slopes, start=1)}
    tables: dict[str, dict[str, float]] = {}
    for table, field in Facility.model_fields.items():
        keys = field.annotation.model_fields  # type: ignore[union-attr]
        numbers = {key: own.get(key, getattr(case, key, None)) for key in keys}
        tables[table] = {key: value for key, value in numbers.items() if value is not None}
    return Facility.model_validate(tables)


def rig_case_of_test(name: str) -> str | None:
    """Return the case that a test of the simulated rig names itself after, else None.

    Parameters
    ----------
    name : str
        Name of the test, as in test.toml.
    """
    found = re.fullmatch(r"simulated rig, case (\S+)", name)
    return found.group(1) if found and found.group(1) in CASES else None
