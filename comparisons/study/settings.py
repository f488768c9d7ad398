"""What a study may vary: the settings of records, of their reduction and of the fits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, cast

from classic_ml.errors import InputError

__all__ = ["SOURCES", "TABLES", "Setting"]

NONE = "none"


@dataclass(frozen=True)
class Setting:
    """One setting of a study.

    Parameters
    ----------
    kind : type
        float, int, str or bool.
    says : str
        What it is, with its unit.
    optional : bool
        Whether the text "none" stands for nothing.
    required : bool
        Whether a study must give it.
    """

    kind: type
    says: str
    optional: bool = False
    required: bool = False

    def checked(self, value: Any, where: str) -> float | int | str | bool | None:
        """Return a value of the right kind.

        Parameters
        ----------
        value : object
            As TOML has it.
        where : str
            What the error names.

        Raises
        ------
        InputError
            For another kind of value.
        """
        if self.optional and value == NONE:
            return None
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if self.kind is float and is_number and math.isfinite(value):
            return float(value)
        if self.kind is not float and type(value) is self.kind:
            return cast("float | int | str | bool", value)
        words = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
        either = " or 'none'" if self.optional else ""
        raise InputError(
            where, expected=f"{self.says}: {words[self.kind]}{either}", found=repr(value)
        )


def _sensors() -> dict[str, Setting]:
    """Return the imperfections of the rig's instruments; each is a number or nothing."""
    from comparisons.rig import SensorSettings

    out = {}
    for field in fields(SensorSettings):
        kind = {"int": int, "bool": bool}.get(str(field.type).split(" ")[0], float)
        optional = "None" in str(field.type)
        out[f"sensors.{field.name}"] = Setting(kind, f"sensor setting {field.name}", optional)
    return out


def _factors() -> dict[str, Setting]:
    """Return the dimensions of the rig that may be multiplied by a factor."""
    names = ("discharge_volume_m3", "inertia_per_m", "inlet_volume_m3", "exhaust_volume_m3")
    return {f"factors.{name}": Setting(float, f"factor on {name}") for name in names}


_HIDE = Setting(str, "name of a hidden effect", optional=True)
SOURCES: Mapping[str, Mapping[str, Setting]] = {
    "coefficients": {
        "hide": _HIDE,
        "strength": Setting(float, "strength of the hidden effect, in sigma"),
        "noise": Setting(str, "kind of noise"),
        "noise_percent": Setting(float, "sigma in percent of the deviation of psi_p"),
        "duration_s": Setting(float, "length of each record in s"),
        "sample_period_s": Setting(float, "time between rows in s"),
        "n_records": Setting(int, "number of records fitted together"),
        "degree": Setting(int, "degree of the true characteristic, 2 or 3"),
        "gaps": Setting(bool, "whether records fall into segments"),
    },
    "rig": {
        "case": Setting(str, "rig case"),
        "hide": _HIDE,
        "hide_size": Setting(float, "size of the hidden effect", optional=True),
        "duration_s": Setting(float, "length of the record in s"),
        "noise_percent": Setting(float, "noise of tape and readings in percent of full scale"),
        **_sensors(),
        **_factors(),
    },
    "files": {
        "path": Setting(str, "a series file, or a folder with raw.csv and test.toml", required=True)
    },
}
TABLES: Mapping[str, Mapping[str, Setting]] = {
    "record": {},
    "reduction": {
        "filter_order": Setting(int, "order of the low-pass"),
        "cutoff_hz": Setting(float, "corner of the low-pass in Hz"),
        "phase": Setting(str, "zero, causal or none"),
        "probes": Setting(str, "all, tip or hub"),
        "threshold_lbm_s": Setting(float, "segmentation threshold in lbm/s", optional=True),
        "hysteresis_lbm_s": Setting(float, "half width of its band in lbm/s", optional=True),
        "stall_rule": Setting(str, "threshold or hub-tip"),
        "inertia_factor": Setting(float, "factor on the duct's inertia"),
        "thermocouple_inversion": Setting(bool, "undo the thermocouples' lag"),
        "near_stall_match": Setting(str, "pair, forward or none"),
    },
    "series": {
        "keep_every": Setting(int, "keep every n-th row"),
        "first_s": Setting(float, "keep so many seconds of each record"),
        "rows_only": Setting(bool, "drop the unfiltered signals, so that all fit the same rows"),
    },
    "fit": {
        "degree": Setting(int, "degree of the classical characteristic"),
        "hold": Setting(str, "zero or first"),
    },
}
