"""What was tested, where each channel sits and how it was calibrated: the tables of test.toml.

Each table is a pydantic model that declares its keys once: type, range and, in words, what is
expected there; ``docs/test_toml.md`` says what each is for. What no single table shows is checked
by :mod:`classic_ml.io.description_file`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from math import nan, pi
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from classic_ml.units import COMMON_UNITS, COUNT, Conversion, conversion_to_si, kind_of_unit
from surge_core.errors import InputError
from surge_core.models import Table

# The match takes out the drift of an amplifier. A reading that is off by more has another unit,
# or its zero and calibrate readings belong to another channel.
PLAUSIBLE_BIAS = 0.2
# No thermocouple is off by an eighth; 698 K written in °F is off by a seventh.
PLAUSIBLE_BIAS_K = 0.12
# What belongs to a channel in counts alone.
COUNT_KEYS = ("zoc_reference_Pa", "zero_count", "calibrate_count", "calibrate_pressure_Pa")


def key(expected: str, remedy: str = "", **bounds: Any) -> Any:
    """Return the declaration of a key: what is expected, what may have happened, its range."""
    return Field(description=expected, json_schema_extra={"remedy": remedy}, **bounds)


def _with_unit(kind: str, value: Any) -> Any:
    """Return a text such as "7.98 psia" or "-0.67 degF" in SI, and anything else as it is."""
    if not isinstance(value, str):
        return value
    number, _, unit = value.strip().partition(" ")
    try:
        return float(conversion_to_si(unit, kind, "").to_si(np.asarray(float(number))))
    except ValueError:
        example = '"7.98 psia"' if kind == "pressure" else '"-0.67 degF"'
        an = "an absolute" if kind == "pressure" else "a"
        expected = f"a number, or {an} {kind} with its unit as in {example}"
        raise InputError("", expected=expected, found=repr(value)) from None


def _one_line(text: str) -> str:
    if not text.strip() or not text.isprintable():
        raise InputError("", expected="a text of one line", found=repr(text[:60]))
    return text


Text = Annotated[str, AfterValidator(_one_line)]
Pascal = Annotated[float, BeforeValidator(partial(_with_unit, "pressure"))]
Kelvin = Annotated[float, BeforeValidator(partial(_with_unit, "temperature"))]

_STALL_PA = "an absolute pressure in Pa, 1000 to 10⁸"
_STALL_K = "a temperature in K, 100 to 2000"


class Compressor(Table):
    """``[compressor]``: constants of the machine that the reduction needs."""

    # The limits are wider than any compressor and narrower than another unit: mm, ft·lbf, litres.
    mean_radius_m: float = key("a length of 0.02 to 2 m", "is it in mm or inches?", ge=0.02, le=2.0)
    inertia_per_m: float = key("a number above 0, at most 10 000 1/m", gt=0.0, le=1e4)
    internal_volume_m3: float = key("a volume of 0 to 10 m³", "is it in litres?", ge=0.0, le=10.0)
    gamma: float = key("a number between 1 and 2", gt=1.0, lt=2.0)
    gas_constant_J_kg_K: float = key(
        "a number from 200 to 600 J/(kg K)",
        "air has 287.05; 53.35 is in ft lbf/(lbm °R)",
        ge=200.0,
        le=600.0,
    )

    @property
    def specific_heat_J_kg_K(self) -> float:
        """Specific heat at constant pressure, γR/(γ−1)."""
        return self.gamma * self.gas_constant_J_kg_K / (self.gamma - 1.0)


class Converter(Table):
    """``[adc]``: the analogue-to-digital converter."""

    bits: int = key("a whole number from 4 to 32", ge=4, le=32)
    low_V: float = key("a voltage in V")
    high_V: float = key("a voltage in V")

    @model_validator(mode="after")
    def _upwards(self) -> Converter:
        _check_above("high_V", self.high_V, "low_V", self.low_V)
        return self

    @property
    def top_code(self) -> int:
        """Highest code, where the converter clips."""
        return int(2**self.bits - 1)

    @property
    def volts_per_count(self) -> float:
        """Step of one code."""
        return float((self.high_V - self.low_V) / 2**self.bits)


class Window(Table):
    """A part of the record, in s of the facility clock, from ``from_s`` to ``to_s``."""

    from_s: float
    to_s: float

    @model_validator(mode="after")
    def _forward(self) -> Window:
        _check_above("to_s", self.to_s, "from_s", self.from_s)
        return self


class NearStall(Window):
    """``[near_stall]``: the facility's steady reading before the surge.

    The plane averages of pressure and temperature, and when the record shows the same state.
    """

    P25_Pa: Pascal = key(_STALL_PA, "is it in kPa or psi?", ge=1e3, le=1e8)
    T25_K: Kelvin = key(_STALL_K, "is it in °C?", ge=100.0, le=2e3)
    P31_Pa: Pascal = key(_STALL_PA, "is it in kPa or psi?", ge=1e3, le=1e8)
    T31_K: Kelvin = key(_STALL_K, "is it in °C?", ge=100.0, le=2e3)

    @model_validator(mode="after")
    def _compresses(self) -> NearStall:
        _check_above("P31_Pa", self.P31_Pa, "P25_Pa", self.P25_Pa)
        return self

    def pressure_Pa(self, plane: int) -> float:
        """Return the facility's total pressure at a plane."""
        return {25: self.P25_Pa, 31: self.P31_Pa}[plane]

    def temperature_K(self, plane: int) -> float:
        """Return the facility's total temperature at a plane."""
        return {25: self.T25_K, 31: self.T31_K}[plane]


class FileLayout(Table):
    """``[file]``: how the raw record lies in its file, whatever the format."""

    time: Text = "time_s"
    time_unit: Text | None = None
    group: Text | None = None
    clock: Literal["column", "from rate"] = "column"
    other_columns: Literal["refuse", "ignore"] = "refuse"
    units: Literal["check", "from test.toml"] = "check"


class _Channel(Table):
    """What every channel has: its name, its column in the file, and its place."""

    name: str = ""
    column: Text = ""
    unit: Text = key('"count", or a unit such as psia or degF')
    plane: Literal[25, 31] = key("25 or 31")
    rake: Text = key('the name of a rake, such as "A"')
    kind: Literal["pressure", "temperature"]

    @property
    def file_column(self) -> str:
        """Column of the file."""
        return self.column or self.name

    @property
    def si_unit(self) -> str:
        """``"Pa"`` or ``"K"``."""
        return {"pressure": "Pa", "temperature": "K"}[self.kind]

    @property
    def record_unit(self) -> str:
        """Unit in a record as read: ``"count"``, or the one of SI."""
        return COUNT if isinstance(self, CountChannel) else self.si_unit

    @property
    def conversion(self) -> Conversion:
        """From the unit of the file to that of the record."""
        kind = COUNT if isinstance(self, CountChannel) else self.kind
        return conversion_to_si(self.unit, kind, "", getattr(self, "reference_Pa", None))


class PressureChannel(_Channel):
    """One pressure probe: its place and its calibration.

    This one is recorded in a unit of pressure, and has no calibration of counts (``nan``).
    """

    kind: Literal["pressure"] = key('"pressure" or "temperature"')
    immersion: Text = key('an immersion of its plane, such as "hub" or "tip"')
    facing: Literal["forward", "aft"] = key('"forward" or "aft"')
    probe_slope: float = key(
        "a number from 0.2 to 5", "it is near 1; is it in per cent?", ge=0.2, le=5.0
    )
    probe_offset: float = key("a number from -0.5 to 0.5", ge=-0.5, le=0.5)
    reference_Pa: Pascal | None = key("an absolute pressure in Pa", default=None, ge=0.0)
    zoc_reference_Pa: Pascal = Field(default=nan)
    zero_count: float = Field(default=nan)
    calibrate_count: float = Field(default=nan)
    calibrate_pressure_Pa: Pascal = Field(default=nan)

    @model_validator(mode="after")
    def _in_its_unit(self) -> PressureChannel:
        kind = kind_of_unit(self.unit)
        stated = [name for name in COUNT_KEYS if name in self.model_fields_set]
        if kind == COUNT and self.reference_Pa is not None:
            raise InputError("reference_Pa", expected=f'none beside "{COUNT}"', found="one")
        if kind == "pressure" and not stated:
            _ = self.conversion
        elif not kind:
            expected = f'"{COUNT}" or a unit of pressure, such as {COMMON_UNITS["pressure"]}'
            raise InputError("unit", expected=expected, found=f'"{self.unit}"')
        elif kind != COUNT:
            beside = f" beside {', '.join(stated)}" if stated else " or a unit of pressure"
            raise InputError("unit", expected=f'"{COUNT}"{beside}', found=f'"{self.unit}"')
        return self


class CountChannel(PressureChannel):
    """A pressure probe that is recorded as codes of the converter, with its calibration."""

    unit: Annotated[str, AfterValidator(lambda _: COUNT)]
    zoc_reference_Pa: Pascal = key("a pressure in Pa, 0 for vacuum", ge=0.0)
    zero_count: float = key("a code of the converter", ge=0.0)
    calibrate_count: float = key("a code of the converter", ge=0.0)
    calibrate_pressure_Pa: Pascal = key("a pressure in Pa")

    @model_validator(mode="after")
    def _calibrated(self) -> CountChannel:
        counts = abs(self.calibrate_count - self.zero_count)
        step_Pa, reference_Pa = abs(self.calibrate_pressure_Pa), self.zoc_reference_Pa
        in_pascal = "500 Pa to 1 GPa (is it in kPa or psi?)"
        for name, good, expected in (
            # With fewer counts the sensitivity is not known to 1 %.
            ("calibrate_count", counts >= 100.0, "at least 100 counts from zero_count"),
            # No rake is calibrated by less than a twentieth of a metre of water, nor stands in
            # such a vacuum; a transducer against vacuum has a reference of zero. The strongest
            # pressure cells read 1 GPa.
            ("calibrate_pressure_Pa", 500.0 <= step_Pa <= 1e9, in_pascal),
            ("zoc_reference_Pa", reference_Pa == 0.0 or 500.0 <= reference_Pa <= 1e9, in_pascal),
        ):
            if not good:
                raise InputError(name, expected=expected, found=f"{getattr(self, name):g}")
        return self


class TemperatureChannel(_Channel):
    """One aspirated thermocouple."""

    kind: Literal["temperature"]
    recovery_factor: float = key("a number from 0.5 to 1.1", ge=0.5, le=1.1)
    time_constant_s: float = key("a time of 0 to 2 s", "is it in ms?", ge=0.0, le=2.0)

    @model_validator(mode="after")
    def _in_kelvin(self) -> TemperatureChannel:
        _ = self.conversion
        return self


AnyChannel = PressureChannel | TemperatureChannel


def _check_above(name: str, high: float, other: str, low: float) -> None:
    if high <= low:
        raise InputError(name, expected=f"more than {other} ({low:g})", found=f"{high:g}")


@dataclass(frozen=True)
class ProbePair:
    """The forward and the aft probe of one rake at one immersion."""

    forward: PressureChannel
    aft: PressureChannel

    @property
    def name(self) -> str:
        """Plane, rake and immersion, e.g. ``"25_A_tip"``."""
        return f"{self.forward.plane}_{self.forward.rake}_{self.forward.immersion}"

    @property
    def immersion(self) -> str:
        """``"hub"``, ``"tip"``, or the name of one between."""
        return self.forward.immersion


@dataclass(frozen=True)
class TestDescription:
    """Everything that test.toml says.

    Parameters
    ----------
    name : str
        Name of the test.
    sample_rate_hz : float
        Samples a second of every channel.
    rotor_speed_rpm : float
        Physical rotor speed N, constant through the test.
    design_corrected_speed_rpm : float
        100 % corrected speed.
    compressor : Compressor
        The machine.
    areas_m2 : mapping of int to float
        Flow area of planes 25 and 31.
    converter : Converter or None
        The converter behind the pressure channels; None where none of them is in counts.
    near_stall : NearStall
        The facility reading before the surge.
    pressures : tuple of PressureChannel
        Pressure channels in file order.
    temperatures : tuple of TemperatureChannel
        Thermocouples in file order.
    threshold_lbm_s : float, "none" or None
        Corrected inlet flow that splits in-stall from unstalled, in lbm/s; ``"none"`` for a record
        without an unstalled regime; None where test.toml does not say.
    hysteresis_lbm_s : float
        Half width of the band around the threshold.
    window_s : tuple of float, optional
        Quasi-steady cycles, on the facility clock; None when they are to be found.
    limits : mapping of str to tuple of float
        By channel, the readings that count, in Pa or K whatever the unit of the column.
    near_stall_shifts : mapping of str to float
        By forward probe and thermocouple, what the near-stall match adds, in Pa and K, for a record
        that does not hold the near-stall reading itself; empty where the match is to be found.
    file : FileLayout
        How the record lies in its file.
    source : str
        The file.
    """

    # The name starts with "Test" because it describes one; test runners are to leave it alone.
    __test__ = False

    name: str
    sample_rate_hz: float
    rotor_speed_rpm: float
    design_corrected_speed_rpm: float
    compressor: Compressor
    areas_m2: Mapping[int, float]
    converter: Converter | None
    near_stall: NearStall
    pressures: tuple[PressureChannel, ...]
    temperatures: tuple[TemperatureChannel, ...]
    threshold_lbm_s: float | Literal["none"] | None = None
    hysteresis_lbm_s: float = 0.0
    window_s: tuple[float, float] | None = None
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    near_stall_shifts: Mapping[str, float] = field(default_factory=dict)
    file: FileLayout = field(default_factory=FileLayout)
    source: str = "test.toml"

    @property
    def adc(self) -> Converter:
        """The converter behind the channels that are in counts; refused where there is none."""
        if self.converter is None:
            raise InputError(
                f"{self.source}: [adc]", expected="the converter of the counts", found="none"
            )
        return self.converter

    @property
    def rotor_velocity_m_s(self) -> float:
        """Mean rotor velocity U = 2π N r, from the physical speed."""
        return 2.0 * pi * self.rotor_speed_rpm / 60.0 * self.compressor.mean_radius_m

    @property
    def channels(self) -> tuple[AnyChannel, ...]:
        """All channels: pressures, then temperatures."""
        return (*self.pressures, *self.temperatures)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of all channels: pressures, then temperatures."""
        return tuple(channel.name for channel in self.channels)

    def pairs(self, plane: int) -> tuple[ProbePair, ...]:
        """Return the probe pairs of a plane, in file order."""
        here = [probe for probe in self.pressures if probe.plane == plane]
        aft = {(c.rake, c.immersion): c for c in here if c.facing == "aft"}
        forward = (c for c in here if c.facing == "forward")
        return tuple(ProbePair(c, aft[c.rake, c.immersion]) for c in forward)

    def thermocouples(self, plane: int) -> tuple[TemperatureChannel, ...]:
        """Return the thermocouples of a plane, in file order."""
        return tuple(c for c in self.temperatures if c.plane == plane)
