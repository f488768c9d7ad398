"""What a model of the whole system must know about the facility: as a file, and of the rig."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, TypeAlias

from pydantic import Field, model_validator

from comparisons.rig import CASES
from surge_core.errors import InputError
from surge_core.models import Table, read_toml, validated
from surge_core.record_folder import toml_text

Positive: TypeAlias = Annotated[float, Field(gt=0.0, description="a number above 0")]
NotNegative: TypeAlias = Annotated[float, Field(ge=0.0, description="a number from 0 on")]


class Volumes(Table):
    """Behind plane 31, behind the throttle, before the inlet duct, and of the gas at the face."""

    discharge_m3: Positive
    exhaust_m3: Positive
    inlet_m3: Positive
    face_m3: Positive


class Inlet(Table):
    """The duct before plane 25: ∫dx/A, and its pressure loss near stall over P25."""

    inertia_per_m: NotNegative
    loss_frac: NotNegative


class Supply(Table):
    """The refrigeration plant.

    Its temperature before the surge, the fall of its flow with the pressure of the inlet volume,
    and what share of the inlet's heating comes back with it, after what lag.
    """

    temperature_K: Positive
    slope_kg_s_Pa: NotNegative
    coil_effectiveness: NotNegative
    coil_lag_s: Positive


class Throttle(Table):
    """The throttle and what lies behind it.

    Pressure behind it near stall over P31, pressure behind the exhaust, its area over the one that
    passes the near-stall flow, start and rate of the closing that leads into stall on the facility
    clock, and its area after stall over the initial one with the lag on the way there.
    """

    exhaust_pressure_frac: Annotated[
        float, Field(gt=0.0, lt=1.0, description="a number from 0 to 1")
    ]
    ambient_pressure_Pa: Positive = 101_325.0
    area_factor: Positive = 1.0
    close_start_s: float
    close_rate_per_s: NotNegative
    open_ratio: Positive
    open_lag_s: Positive


class Heat(Table):
    """What heats the gas at the face.

    In-stall recirculation at the tips over ρ U A, the work coefficient that heats it, how many
    times as much gas it exchanges between face and inlet volume, and the share of the discharge
    temperature that reversed gas still carries.
    """

    recirculation_frac: NotNegative
    recirculation_work: NotNegative
    recirculation_exchange: NotNegative
    reverse_heat_frac: NotNegative


class Compressor(Table):
    """What is known of the compressor beforehand.

    The loss k_rev φ² in reversed flow, which acts without the lag; φ above which stall ends, and
    how far below it φ must have been first; φ and ψ' of the stall point at two corrected speeds
    (over design); ψ' lost beyond it per (φ − φ_s)²; ψ'/ψ of the unstalled branch; the time constant
    of the change between the branches; and the in-stall ψ_QS: its value at φ = 0, the slopes of
    three straight pieces, and where they meet. The two constants of the stall logic default to
    those of the notes on the rig.
    """

    reverse_loss: NotNegative
    recovery_phi: Positive
    rearm_phi: NotNegative = 0.05
    stall_speed_low_frac: NotNegative
    stall_speed_high_frac: NotNegative
    stall_phi_low: NotNegative
    stall_phi_high: NotNegative
    stall_psi_p_low: NotNegative
    stall_psi_p_high: NotNegative
    unstalled_droop: NotNegative
    unstalled_efficiency: Positive
    blend_s: Positive = 0.003
    work_intercept: float
    work_slope_1: float
    work_slope_2: float
    work_slope_3: float
    work_break_1: NotNegative
    work_break_2: NotNegative

    @model_validator(mode="after")
    def _ascending(self) -> Compressor:
        for low, high in (
            ("stall_speed_low_frac", "stall_speed_high_frac"),
            ("work_break_1", "work_break_2"),
        ):
            if not getattr(self, low) < getattr(self, high):
                raise InputError(
                    low,
                    expected=f"a number below {high}",
                    found=f"{getattr(self, low):g} and {getattr(self, high):g}",
                )
        return self


class Facility(Table):
    """The facility around the compressor, and what is known of the compressor beforehand.

    None of it is in test.toml, and the component method needs none of it. Throttle, exhaust and
    supply are sized by the near-stall reading of the test. All numbers in SI.
    """

    volumes: Volumes
    inlet: Inlet
    supply: Supply
    throttle: Throttle
    heat: Heat
    compressor: Compressor


def read_facility(path: str | Path) -> Facility:
    """Read a facility file: the tables of `Facility`, as `facility_toml` writes them.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    Facility
        The numbers.

    Raises
    ------
    InputError
        Naming the file, and every key that is missing, not possible or not known.
    """
    data = read_toml(Path(path), "a facility description (.toml)")
    return validated(Facility, data, str(path))


def facility_toml(facility: Facility) -> str:
    """Return a facility as the text that `read_facility` reads back to the same value.

    Parameters
    ----------
    facility : Facility
        The numbers.
    """
    return toml_text(facility.model_dump())


def facility_of_case(name: str) -> Facility:
    """Return the facility of a case of the simulated rig, of which only its numbers are read."""
    case = CASES[name]
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
    """Return the case that a test of the simulated rig names itself after, else None."""
    found = re.fullmatch(r"simulated rig, case (\S+)", name)
    return found.group(1) if found and found.group(1) in CASES else None
