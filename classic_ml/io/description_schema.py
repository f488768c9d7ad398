"""test.toml as it may be written: each table, each key, its range, and what is expected there."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from classic_ml.units import (
    COUNT,
    kind_of_unit,
    pressure_conversion,
    quantity_in,
    temperature_conversion,
    time_conversion,
)
from surge_core.errors import InputError
from surge_core.models import Table

__all__ = ["MODELS", "Document", "InCounts", "Probe", "Temperature", "tag_of"]

# Fewer counts than this between the zero and the calibrate reading and the sensitivity is
# not known to 1 %.
MINIMUM_CALIBRATE_COUNTS = 100.0
# No rake is calibrated by less than a twentieth of a metre of water, nor stands in such a vacuum.
LEAST_CALIBRATE_PA, LEAST_REFERENCE_PA = 500.0, 1000.0
# Corrected speeds near stall, as shares of the design speed, and the temperature they refer to.
SPEED_SHARES, STANDARD_K = (0.1, 1.5), 288.15
IN_COUNTS, IN_PRESSURE, TEMPERATURE = "InCounts", "InPressure", "Temperature"


def _key(expected: str, remedy: str = "", **bounds: Any) -> Any:
    """Return the declaration of a key: what is expected, what may have happened, its range."""
    return Field(description=expected, json_schema_extra={"remedy": remedy}, **bounds)


def _with_unit(kind: str, value: Any) -> Any:
    """Return a text such as "7.98 psia" in SI, and anything else as it is."""
    return quantity_in(value, kind, "") if isinstance(value, str) else value


def _one_line(text: str) -> str:
    if not text.strip() or not text.isprintable():
        raise InputError("", expected="a text of one line", found=repr(text[:60]))
    return text


Text = Annotated[str, AfterValidator(_one_line)]
Pascal = Annotated[float, BeforeValidator(partial(_with_unit, "pressure"))]
Kelvin = Annotated[float, BeforeValidator(partial(_with_unit, "temperature"))]

_SPEED = "a speed of 100 to 200 000 revolutions a minute"
_STALL_PA = "an absolute pressure in Pa, 1000 to 10⁸"
_STALL_K = "a temperature in K, 100 to 2000"


class TestTable(Table):
    name: Text
    sample_rate_hz: float = _key("a number above 0", gt=0.0)
    # A fan of 10 m turns above 100, a micro turbine below 2e5.
    rotor_speed_rpm: float = _key(_SPEED, "is it in Hz or rad/s?", ge=100.0, le=2e5)
    design_corrected_speed_rpm: float = _key(_SPEED, "is it in Hz or rad/s?", ge=100.0, le=2e5)


class CompressorTable(Table):
    # The limits are wider than any compressor and narrower than another unit: mm, ft·lbf, litres.
    mean_radius_m: float = _key(
        "a length of 0.02 to 2 m", "is it in mm or inches?", ge=0.02, le=2.0
    )
    inertia_per_m: float = _key(
        "a number above 0, at most 10 000 1/m",
        "",
        gt=0.0,
        le=1e4,
    )
    internal_volume_m3: float = _key("a volume of 0 to 10 m³", "is it in litres?", ge=0.0, le=10.0)
    gamma: float = _key("a number between 1 and 2", gt=1.0, lt=2.0)
    gas_constant_J_kg_K: float = _key(
        "a number from 200 to 600 J/(kg K)",
        "air has 287.05; 53.35 is in ft lbf/(lbm °R)",
        ge=200.0,
        le=600.0,
    )


class Plane(Table):
    area_m2: float = _key(
        "an area of 0.0001 to 10 m²", "is it in cm² or square inches?", ge=1e-4, le=10.0
    )


class Planes(Table):
    inlet: Plane = Field(alias="25", description="a table")
    exit: Plane = Field(alias="31", description="a table")


class Window(Table):
    from_s: float
    to_s: float

    @model_validator(mode="after")
    def _forward(self) -> Window:
        if self.to_s <= self.from_s:
            raise InputError(
                "to_s", expected=f"a time after from_s ({self.from_s:g} s)", found=f"{self.to_s:g}"
            )
        return self


class NearStallTable(Window):
    P25_Pa: Pascal = _key(_STALL_PA, "is it in kPa or psi?", ge=1e3, le=1e8)
    T25_K: Kelvin = _key(_STALL_K, "is it in °C?", ge=100.0, le=2e3)
    P31_Pa: Pascal = _key(_STALL_PA, "is it in kPa or psi?", ge=1e3, le=1e8)
    T31_K: Kelvin = _key(_STALL_K, "is it in °C?", ge=100.0, le=2e3)

    @model_validator(mode="after")
    def _compressed(self) -> NearStallTable:
        for before, behind in ("P25_Pa", "P31_Pa"), ("T25_K", "T31_K"):
            low, high = getattr(self, before), getattr(self, behind)
            if high <= low:
                raise InputError(
                    behind,
                    expected=f"more than {before} ({low:g})",
                    found=f"{high:g}",
                    remedy="are the planes exchanged?",
                )
        return self


class ConverterTable(Table):
    bits: int = _key("a whole number from 4 to 32", ge=4, le=32)
    low_V: float
    high_V: float

    @model_validator(mode="after")
    def _upwards(self) -> ConverterTable:
        if self.high_V <= self.low_V:
            raise InputError(
                "high_V", expected=f"more than low_V ({self.low_V:g} V)", found=f"{self.high_V:g}"
            )
        return self


class FileTable(Table):
    time: Text = "time_s"
    time_unit: Text | None = None
    group: Text | None = None
    clock: Literal["column", "from rate"] = "column"
    start_s: float | None = None
    other_columns: Literal["refuse", "ignore"] = "refuse"
    units: Literal["check", "from test.toml"] = "check"

    @model_validator(mode="after")
    def _one_clock(self) -> FileTable:
        if self.time_unit is not None:
            time_conversion(self.time_unit, "time_unit")
        for key in ("time", "time_unit"):
            if self.clock == "from rate" and key in self.model_fields_set:
                raise InputError(key, expected='none beside clock = "from rate"', found="one")
        return self


class Segmentation(Table):
    threshold_lbm_s: float | Literal["none"] | None = _key(
        'a number above 0 or "none"', default=None
    )
    hysteresis_lbm_s: float = _key("a number from 0 on", default=0.0, ge=0.0)

    @model_validator(mode="after")
    def _above_the_band(self) -> Segmentation:
        threshold = self.threshold_lbm_s
        if isinstance(threshold, float | int) and threshold <= self.hysteresis_lbm_s:
            raise InputError(
                "threshold_lbm_s",
                expected=f"more than the hysteresis ({self.hysteresis_lbm_s:g})",
                found=f"{threshold:g}",
            )
        return self


class Channel(Table):
    column: Text = ""
    unit: Text
    plane: Literal[25, 31] = _key("25 or 31")
    rake: Text


class Probe(Channel):
    """A pressure probe, however it is recorded."""

    kind: Literal["pressure"] = _key('"pressure" or "temperature"')
    immersion: Literal["hub", "tip"]
    facing: Literal["forward", "aft"]
    probe_slope: float = _key(
        "a number from 0.2 to 5", "it is near 1; is it in per cent?", ge=0.2, le=5.0
    )
    probe_offset: float = _key("a number from -0.5 to 0.5", ge=-0.5, le=0.5)


class InCounts(Probe):
    """A probe that is recorded as codes of the converter, with its calibration."""

    zoc_reference_Pa: Pascal = _key("a pressure in Pa, 0 for vacuum", ge=0.0)
    zero_count: float = _key("a code of the converter", ge=0.0)
    calibrate_count: float = _key("a code of the converter", ge=0.0)
    calibrate_pressure_Pa: Pascal = _key("a pressure in Pa")

    @model_validator(mode="after")
    def _calibrated(self) -> InCounts:
        if abs(self.calibrate_count - self.zero_count) < MINIMUM_CALIBRATE_COUNTS:
            raise InputError(
                "calibrate_count",
                expected=f"at least {MINIMUM_CALIBRATE_COUNTS:g} counts from zero_count",
                found=f"{self.calibrate_count:g} beside {self.zero_count:g}",
            )
        step_Pa, reference_Pa = abs(self.calibrate_pressure_Pa), self.zoc_reference_Pa
        for key, value, least in (
            ("calibrate_pressure_Pa", step_Pa, LEAST_CALIBRATE_PA),
            # A transducer against vacuum has a reference of zero.
            ("zoc_reference_Pa", reference_Pa or LEAST_REFERENCE_PA, LEAST_REFERENCE_PA),
        ):
            if value < least:
                raise InputError(
                    key,
                    expected=f"a pressure in Pa, {least:g} and more",
                    found=f"{value:g}",
                    remedy="is it in kPa or psi?",
                )
        return self


class InPressure(Probe):
    reference_Pa: Pascal | None = _key("an absolute pressure in Pa", default=None, ge=0.0)

    @model_validator(mode="after")
    def _absolute(self) -> InPressure:
        if kind_of_unit(self.unit) != "pressure":
            raise InputError(
                "unit", expected=f'"{COUNT}", or a unit of pressure', found=f'"{self.unit}"'
            )
        try:
            pressure_conversion(self.unit, "", self.reference_Pa)
        except InputError as error:
            raise InputError(
                "reference_Pa", expected=error.expected, found=error.found, remedy=error.remedy
            ) from None
        return self


class Temperature(Channel):
    """A thermocouple."""

    kind: Literal["temperature"]
    recovery_factor: float = _key("a number from 0.5 to 1.1", ge=0.5, le=1.1)
    time_constant_s: float = _key("a time of 0 to 2 s", "is it in ms?", ge=0.0, le=2.0)

    @model_validator(mode="after")
    def _in_kelvin(self) -> Temperature:
        try:
            temperature_conversion(self.unit, "")
        except InputError as error:
            raise InputError("unit", expected=error.expected, found=error.found) from None
        return self


def tag_of(channel: Any) -> str:
    """Return which of the three tables a channel is; the pressure's refuses what is neither."""
    values: Mapping[str, Any] = channel if isinstance(channel, Mapping) else {}
    if values.get("kind") == "temperature":
        return TEMPERATURE
    return IN_COUNTS if values.get("unit") in (COUNT, f"{COUNT}s") else IN_PRESSURE


AnyChannel = Annotated[
    Annotated[InCounts, Tag(IN_COUNTS)]
    | Annotated[InPressure, Tag(IN_PRESSURE)]
    | Annotated[Temperature, Tag(TEMPERATURE)],
    Discriminator(tag_of),
]


def _low_to_high(ends: list[float]) -> list[float]:
    if ends[0] >= ends[1]:
        raise InputError("", expected="a range [low, high]", found=f"{ends}")
    return ends


_Range = Annotated[list[float], Field(min_length=2, max_length=2), AfterValidator(_low_to_high)]


class Document(Table):
    """The whole file, with ``[defaults]`` written into the channels."""

    test: TestTable = _key("a table")
    compressor: CompressorTable = _key("a table")
    planes: Planes = _key("a table")
    near_stall: NearStallTable = _key("a table")
    channels: dict[Text, AnyChannel] = _key("a table of tables")
    adc: ConverterTable | None = None
    near_stall_shifts: dict[str, float] | None = None
    limits: dict[str, _Range] = Field(default_factory=dict)
    segmentation: Segmentation = Field(default_factory=Segmentation)
    window: Window | None = None
    file: FileTable = Field(default_factory=FileTable)

    @model_validator(mode="after")
    def _agrees(self) -> Document:
        """Refuse what no table shows for itself."""
        corrected_rpm = self.test.rotor_speed_rpm * (STANDARD_K / self.near_stall.T25_K) ** 0.5
        share = corrected_rpm / self.test.design_corrected_speed_rpm
        if not SPEED_SHARES[0] <= share <= SPEED_SHARES[1]:
            raise InputError(
                "test.design_corrected_speed_rpm",
                expected="a speed in revolutions a minute of which the corrected speed of the "
                f"test, {corrected_rpm:.4g}, is {SPEED_SHARES[0]:g} to {SPEED_SHARES[1]:g} times",
                found=f"{self.test.design_corrected_speed_rpm:g}",
                remedy="is it in Hz or rad/s?",
            )
        in_counts = {n: c for n, c in self.channels.items() if isinstance(c, InCounts)}
        if in_counts and self.adc is None:
            first = next(iter(in_counts))
            raise InputError("adc", expected=f"a table, since {first} is in counts", found="none")
        for name, channel in in_counts.items():
            for key in ("zero_count", "calibrate_count"):
                if self.adc is not None and getattr(channel, key) >= 2**self.adc.bits:
                    raise InputError(
                        f"channels.{name}.{key}",
                        expected=f"a code of a converter of {self.adc.bits} bits",
                        found=f"{getattr(channel, key):g}",
                    )
        for name in self.limits:
            if name not in self.channels:
                raise InputError(
                    f"limits.{name}", expected="the name of a channel", found="no such channel"
                )
        return self


# The three tables that a channel may be, by their tag.
MODELS: dict[str, type[Channel]] = {
    IN_COUNTS: InCounts,
    IN_PRESSURE: InPressure,
    TEMPERATURE: Temperature,
}
