"""What a study may vary: the settings of records, of their reduction and of the fits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, cast

from comparisons.rig import CASES, HIDEABLE, SensorSettings
from comparisons.rig.coefficient_tests import EFFECTS, NOISES, OUTSIDE
from surge_core.errors import InputError

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
    least, above : float, optional
        The value is this or more; or more than this.
    choices : tuple of str
        What it may be; empty for anything.
    """

    kind: type
    says: str
    optional: bool = False
    required: bool = False
    least: float | None = None
    above: float | None = None
    choices: tuple[str, ...] = ()

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
        if self.kind is float and is_number and math.isfinite(value) and self._within(value):
            return float(value)
        if self.kind is not float and type(value) is self.kind and self._within(value):
            return cast("float | int | str | bool", value)
        words = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
        limits = "" if self.least is None else f" from {self.least:g} on"
        limits += "" if self.above is None else f" above {self.above:g}"
        kind = f"one of {', '.join(self.choices)}" if self.choices else words[self.kind] + limits
        either = " or 'none'" if self.optional else ""
        raise InputError(where, expected=f"{self.says}: {kind}{either}", found=repr(value))

    def _within(self, value: Any) -> bool:
        """Tell whether a value is within the limits or among the choices."""
        if self.choices:
            return value in self.choices
        return (self.least is None or value >= self.least) and (
            self.above is None or value > self.above
        )


def _sensors() -> dict[str, Setting]:
    """Return the imperfections of the rig's instruments; each is a number or nothing."""
    out = {}
    for field in fields(SensorSettings):
        kind = {"int": int, "bool": bool}.get(str(field.type).split(" ")[0], float)
        optional = "None" in str(field.type)
        out[f"sensors.{field.name}"] = Setting(kind, f"sensor setting {field.name}", optional)
    return out


def _factors() -> dict[str, Setting]:
    """Return the dimensions of the rig that may be multiplied by a factor."""
    names = ("discharge_volume_m3", "inertia_per_m", "inlet_volume_m3", "exhaust_volume_m3")
    return {f"factors.{name}": Setting(float, f"factor on {name}", above=0.0) for name in names}


_DURATION = Setting(float, "length of each record in s", above=0.0)
SOURCES: Mapping[str, Mapping[str, Setting]] = {
    "coefficients": {
        "hide": Setting(str, "a hidden effect", optional=True, choices=(*EFFECTS, *OUTSIDE)),
        "strength": Setting(float, "strength of the hidden effect, in sigma", least=0.0),
        "noise": Setting(str, "kind of noise", choices=NOISES),
        "noise_percent": Setting(float, "sigma in percent of the deviation of psi_p", least=0.0),
        "duration_s": _DURATION,
        "sample_period_s": Setting(float, "time between rows in s", above=0.0),
        "n_records": Setting(int, "number of records fitted together", least=1),
        "degree": Setting(int, "degree of the true characteristic, 2 or 3", least=2),
        "gaps": Setting(bool, "whether records fall into segments"),
    },
    "rig": {
        "case": Setting(str, "rig case", choices=tuple(CASES)),
        "hide": Setting(str, "a hidden effect", optional=True, choices=tuple(HIDEABLE)),
        "hide_size": Setting(float, "size of the hidden effect", optional=True),
        "duration_s": _DURATION,
        "noise_percent": Setting(
            float, "noise of tape and readings in percent of full scale", least=0.0
        ),
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
        "cutoff_hz": Setting(float, "corner of the low-pass in Hz", above=0.0),
        "phase": Setting(str, "phase of the low-pass", choices=("zero", "causal", "none")),
        "probes": Setting(str, "probes averaged", choices=("all", "tip", "hub")),
        "threshold_lbm_s": Setting(float, "segmentation threshold in lbm/s", optional=True),
        "hysteresis_lbm_s": Setting(float, "half width of its band in lbm/s", optional=True),
        "stall_rule": Setting(str, "stall rule", choices=("threshold", "hub-tip")),
        "inertia_factor": Setting(float, "factor on the duct's inertia"),
        "thermocouple_inversion": Setting(bool, "undo the thermocouples' lag"),
        "near_stall_match": Setting(
            str, "what the near-stall match moves", choices=("pair", "forward", "none")
        ),
    },
    "series": {
        "keep_every": Setting(int, "keep every n-th row", least=1),
        "first_s": Setting(float, "keep so many seconds of each record", above=0.0),
        "rows_only": Setting(bool, "drop the unfiltered signals, so that all fit the same rows"),
    },
    "fit": {
        "degree": Setting(int, "degree of the classical characteristic", least=1),
        "hold": Setting(str, "how φ acts between samples", choices=("zero", "first")),
    },
}
