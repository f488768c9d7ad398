"""What a model of the whole system must be told about the facility, as a file and as a value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import isfinite
from pathlib import Path
from typing import Any

from pydantic import Field, create_model

from surge_core.errors import InputError
from surge_core.models import Table, read_toml, validated

__all__ = ["Facility", "facility_toml", "read_facility"]


@dataclass(frozen=True)
class Facility:
    """The facility around the compressor, and what is known of the compressor beforehand.

    None of it is in test.toml, and the component method needs none of it. Throttle, exhaust and
    supply are sized by the near-stall reading of the test; see `read_facility` for the file.

    Parameters
    ----------
    discharge_volume_m3, exhaust_volume_m3, inlet_volume_m3, face_volume_m3 : float
        Volumes behind plane 31, behind the throttle, before the inlet duct, and of the gas at the
        compressor's face that reversed flow heats.
    inlet_inertia_per_m : float
        ∫dx/A of the duct before plane 25.
    inlet_loss_frac : float
        Pressure loss of that duct near stall, over P25.
    supply_temperature_k : float
        Temperature of the supply before the surge.
    supply_slope_kg_s_pa : float
        Fall of the supply flow with the pressure of the inlet volume.
    coil_effectiveness, coil_lag_s : float
        Share of the inlet's heating that comes back with the supply, and its lag.
    exhaust_pressure_frac : float
        Pressure behind the throttle near stall, over P31.
    ambient_pressure_pa : float
        Pressure behind the exhaust.
    throttle_area_factor : float
        Effective area of the throttle over the one that passes the near-stall flow.
    close_start_s, close_rate_per_s : float
        Start and rate of the closing that leads into stall, on the facility clock.
    open_ratio, open_lag_s : float
        Area after stall over the initial one, and the lag on the way there.
    recirculation_frac, recirculation_work, recirculation_exchange : float
        In-stall recirculation at the tips over ρ U A, the work coefficient that heats it, and how
        many times as much gas it exchanges between face and inlet volume.
    reverse_heat_frac : float
        Share of the discharge temperature that reversed gas still carries to the face.
    reverse_loss : float
        Loss k_rev φ² in reversed flow, which acts without the lag.
    recovery_phi, rearm_phi : float
        φ above which stall ends, and how far below it φ must have been first.
    stall_speed_low_frac, stall_speed_high_frac : float
        Two corrected speeds, over design, at which the stall point is known.
    stall_phi_low, stall_phi_high, stall_psi_p_low, stall_psi_p_high : float
        φ and ψ' of the stall point there.
    unstalled_droop : float
        ψ' lost beyond the stall point, per unit of (φ − φ_s)².
    unstalled_efficiency : float
        ψ'/ψ of the unstalled branch.
    blend_s : float
        Time constant of the change between the branches.
    work_intercept, work_slope_1, work_slope_2, work_slope_3 : float
        In-stall work coefficient ψ_QS at φ = 0, and the slopes of its three straight pieces.
    work_break_1, work_break_2 : float
        Where the pieces meet.

    Raises
    ------
    InputError
        Naming the number at fault.
    """

    discharge_volume_m3: float
    exhaust_volume_m3: float
    inlet_volume_m3: float
    face_volume_m3: float
    inlet_inertia_per_m: float
    inlet_loss_frac: float
    supply_temperature_k: float
    supply_slope_kg_s_pa: float
    coil_effectiveness: float
    coil_lag_s: float
    exhaust_pressure_frac: float
    ambient_pressure_pa: float
    throttle_area_factor: float
    close_start_s: float
    close_rate_per_s: float
    open_ratio: float
    open_lag_s: float
    recirculation_frac: float
    recirculation_work: float
    recirculation_exchange: float
    reverse_heat_frac: float
    reverse_loss: float
    recovery_phi: float
    rearm_phi: float
    stall_speed_low_frac: float
    stall_speed_high_frac: float
    stall_phi_low: float
    stall_phi_high: float
    stall_psi_p_low: float
    stall_psi_p_high: float
    unstalled_droop: float
    unstalled_efficiency: float
    blend_s: float
    work_intercept: float
    work_slope_1: float
    work_slope_2: float
    work_slope_3: float
    work_break_1: float
    work_break_2: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            positive = field.name in _POSITIVE
            if not isinstance(value, int | float) or isinstance(value, bool) or not isfinite(value):
                raise _refused(field.name, "a finite number", value)
            if (value < 0.0 and field.name not in _ANY_SIGN) or (value == 0.0 and positive):
                raise _refused(field.name, "a number " + ("above 0" if positive else "≥ 0"), value)
        for low, high in _ASCENDING:
            if not getattr(self, low) < getattr(self, high):
                found = f"{getattr(self, low):g} and {getattr(self, high):g}"
                raise _refused(f"{low} and {high}", "the smaller first", found)
        if not self.exhaust_pressure_frac < 1.0:
            raise _refused("exhaust_pressure_frac", "below 1", self.exhaust_pressure_frac)


def _refused(name: str, expected: str, found: object) -> InputError:
    return InputError(f"Facility.{name}", expected=expected, found=f"{found}")


_ANY_SIGN = frozenset(
    {"close_start_s", "work_intercept", "work_slope_1", "work_slope_2", "work_slope_3"}
)
_POSITIVE = frozenset(
    {
        "discharge_volume_m3",
        "exhaust_volume_m3",
        "inlet_volume_m3",
        "face_volume_m3",
        "supply_temperature_k",
        "coil_lag_s",
        "exhaust_pressure_frac",
        "ambient_pressure_pa",
        "throttle_area_factor",
        "open_ratio",
        "open_lag_s",
        "recovery_phi",
        "unstalled_efficiency",
        "blend_s",
    }
)
_ASCENDING = (
    ("stall_speed_low_frac", "stall_speed_high_frac"),
    ("work_break_1", "work_break_2"),
)

# Table of the file -> key in it -> (field, unit).
_SCHEMA: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "volumes": {
        "discharge_m3": ("discharge_volume_m3", "m³"),
        "exhaust_m3": ("exhaust_volume_m3", "m³"),
        "inlet_m3": ("inlet_volume_m3", "m³"),
        "face_m3": ("face_volume_m3", "m³"),
    },
    "inlet": {
        "inertia_per_m": ("inlet_inertia_per_m", "1/m"),
        "loss_frac": ("inlet_loss_frac", ""),
    },
    "supply": {
        "temperature_K": ("supply_temperature_k", "K"),
        "slope_kg_s_Pa": ("supply_slope_kg_s_pa", "kg/s/Pa"),
        "coil_effectiveness": ("coil_effectiveness", ""),
        "coil_lag_s": ("coil_lag_s", "s"),
    },
    "throttle": {
        "exhaust_pressure_frac": ("exhaust_pressure_frac", ""),
        "ambient_pressure_Pa": ("ambient_pressure_pa", "Pa"),
        "area_factor": ("throttle_area_factor", ""),
        "close_start_s": ("close_start_s", "s"),
        "close_rate_per_s": ("close_rate_per_s", "1/s"),
        "open_ratio": ("open_ratio", ""),
        "open_lag_s": ("open_lag_s", "s"),
    },
    "heat": {
        name: (name, "")
        for name in (
            "recirculation_frac",
            "recirculation_work",
            "recirculation_exchange",
            "reverse_heat_frac",
        )
    },
    "compressor": {
        name: (name, unit)
        for name, unit in (
            ("reverse_loss", ""),
            ("recovery_phi", ""),
            ("rearm_phi", ""),
            ("stall_speed_low_frac", ""),
            ("stall_speed_high_frac", ""),
            ("stall_phi_low", ""),
            ("stall_phi_high", ""),
            ("stall_psi_p_low", ""),
            ("stall_psi_p_high", ""),
            ("unstalled_droop", ""),
            ("unstalled_efficiency", ""),
            ("blend_s", "s"),
            ("work_intercept", ""),
            ("work_slope_1", ""),
            ("work_slope_2", ""),
            ("work_slope_3", ""),
            ("work_break_1", ""),
            ("work_break_2", ""),
        )
    },
}
# Standard atmosphere; an area as sized by the near-stall flow; the two constants of the stall
# logic as in the notes on the rig, section 5.
_DEFAULTS = {
    "ambient_pressure_pa": 101_325.0,
    "throttle_area_factor": 1.0,
    "rearm_phi": 0.05,
    "blend_s": 0.003,
}


def read_facility(path: str | Path) -> Facility:
    """Read a facility file.

    The tables are ``[volumes]``, ``[inlet]``, ``[supply]``, ``[throttle]``, ``[heat]`` and
    ``[compressor]``, all numbers in SI; `facility_toml` writes one with every key.

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
        Naming file, table and key when the file is missing, no TOML, lacks a number, holds one
        that is not possible, or holds a key that nobody reads.
    """
    file = Path(path)
    values = read_toml(file, "a facility description (.toml)")
    tables: dict[str, Any] = {}
    for section, keys in _SCHEMA.items():
        declared: dict[str, Any] = dict(map(_declared, keys.items()))
        tables[section] = (create_model(section, __base__=Table, **declared), ...)
    document = create_model("Facility", __base__=Table, **tables)
    read = validated(document, values, str(file)).model_dump()
    numbers = {
        name: float(read[section][key])
        for section, keys in _SCHEMA.items()
        for key, (name, _) in keys.items()
    }
    try:
        return Facility(**numbers)
    except InputError as error:
        where = f"{file}: {error.where.removeprefix('Facility.')}"
        raise InputError(where, expected=error.expected, found=error.found) from None


def _declared(item: tuple[str, tuple[str, str]]) -> tuple[str, Any]:
    """Return a key of the file with the type, the range and the default of its field."""
    key, (name, unit) = item
    bounds: dict[str, Any] = {} if name in _ANY_SIGN else {"ge": 0.0}
    if name in _POSITIVE:
        bounds = {"gt": 0.0}
    words = {"ge": "a number from 0 on", "gt": "a number above 0"}
    expected = f"{words.get(next(iter(bounds), ''), 'a number')} {unit}".strip()
    default: Any = _DEFAULTS.get(name, ...)
    return key, (float, Field(default, description=expected, **bounds))


def facility_toml(facility: Facility) -> str:
    """Return a facility as the text that `read_facility` reads back to the same value.

    Parameters
    ----------
    facility : Facility
        The numbers.
    """
    lines: list[str] = []
    for section, keys in _SCHEMA.items():
        lines += [f"[{section}]"]
        lines += [f"{key} = {float(getattr(facility, name))!r}" for key, (name, _) in keys.items()]
        lines += [""]
    return "\n".join(lines)
