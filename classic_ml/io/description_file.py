"""test.toml, read into a TestDescription; all that is missing or wrong is listed at once."""

from __future__ import annotations

import os
from collections.abc import Mapping
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from classic_ml.description import (
    PLAUSIBLE_BIAS,
    PLAUSIBLE_BIAS_K,
    Compressor,
    Converter,
    FileLayout,
    NearStall,
    PressureChannel,
    ProbePair,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.units import (
    COUNT,
    kind_of_unit,
    pressure_conversion,
    quantity_in,
    temperature_conversion,
    time_conversion,
)
from surge_core.errors import InputError
from surge_core.models import Table, read_toml, validated

__all__ = ["read_test_description"]

# Fewer counts than this between the zero and the calibrate reading and the sensitivity is
# not known to 1 %.
MINIMUM_CALIBRATE_COUNTS = 100.0
# No rake is calibrated by less than a twentieth of a metre of water, nor stands in such a vacuum.
LEAST_CALIBRATE_PA, LEAST_REFERENCE_PA = 500.0, 1000.0
# Corrected speeds near stall, as shares of the design speed, and the temperature they refer to.
SPEED_SHARES, STANDARD_K = (0.1, 1.5), 288.15
IN_COUNTS, IN_PRESSURE, TEMPERATURE = "_InCounts", "_InPressure", "_Temperature"


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


class _Test(Table):
    name: Text
    sample_rate_hz: float = _key("a number above 0", gt=0.0)
    # A fan of 10 m turns above 100, a micro turbine below 2e5.
    rotor_speed_rpm: float = _key(_SPEED, "is it in Hz or rad/s?", ge=100.0, le=2e5)
    design_corrected_speed_rpm: float = _key(_SPEED, "is it in Hz or rad/s?", ge=100.0, le=2e5)


class _Compressor(Table):
    # The limits are wider than any compressor and narrower than another unit: mm, ft·lbf, litres.
    mean_radius_m: float = _key(
        "a length of 0.02 to 2 m", "is it in mm or inches?", ge=0.02, le=2.0
    )
    inertia_per_m: float = _key(
        "a number above 0, at most 10 000 1/m",
        "ReductionSettings.inertia_factor of 0 leaves its term out",
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


class _Plane(Table):
    area_m2: float = _key(
        "an area of 0.0001 to 10 m²", "is it in cm² or square inches?", ge=1e-4, le=10.0
    )


class _Planes(Table):
    inlet: _Plane = Field(alias="25", description="a table")
    exit: _Plane = Field(alias="31", description="a table")


class _Window(Table):
    from_s: float
    to_s: float

    @model_validator(mode="after")
    def _forward(self) -> _Window:
        if self.to_s <= self.from_s:
            raise InputError(
                "to_s", expected=f"a time after from_s ({self.from_s:g} s)", found=f"{self.to_s:g}"
            )
        return self


class _NearStall(_Window):
    P25_Pa: Pascal = _key(_STALL_PA, "is it in kPa or psi?", ge=1e3, le=1e8)
    T25_K: Kelvin = _key(_STALL_K, "is it in °C?", ge=100.0, le=2e3)
    P31_Pa: Pascal = _key(_STALL_PA, "is it in kPa or psi?", ge=1e3, le=1e8)
    T31_K: Kelvin = _key(_STALL_K, "is it in °C?", ge=100.0, le=2e3)

    @model_validator(mode="after")
    def _compressed(self) -> _NearStall:
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


class _Converter(Table):
    bits: int = _key("a whole number from 4 to 32", ge=4, le=32)
    low_V: float
    high_V: float

    @model_validator(mode="after")
    def _upwards(self) -> _Converter:
        if self.high_V <= self.low_V:
            raise InputError(
                "high_V", expected=f"more than low_V ({self.low_V:g} V)", found=f"{self.high_V:g}"
            )
        return self


class _File(Table):
    time: Text = "time_s"
    time_unit: Text | None = None
    group: Text | None = None
    clock: Literal["column", "from rate"] = "column"
    start_s: float | None = None
    other_columns: Literal["refuse", "ignore"] = "refuse"
    units: Literal["check", "from test.toml"] = "check"

    @model_validator(mode="after")
    def _one_clock(self) -> _File:
        if self.time_unit is not None:
            time_conversion(self.time_unit, "time_unit")
        for key in ("time", "time_unit"):
            if self.clock == "from rate" and key in self.model_fields_set:
                raise InputError(key, expected='none beside clock = "from rate"', found="one")
        return self


class _Segmentation(Table):
    threshold_lbm_s: float | Literal["none"] | None = _key(
        'a number above 0 or "none"', default=None
    )
    hysteresis_lbm_s: float = _key("a number from 0 on", default=0.0, ge=0.0)

    @model_validator(mode="after")
    def _above_the_band(self) -> _Segmentation:
        threshold = self.threshold_lbm_s
        if isinstance(threshold, float | int) and threshold <= self.hysteresis_lbm_s:
            raise InputError(
                "threshold_lbm_s",
                expected=f"more than the hysteresis ({self.hysteresis_lbm_s:g})",
                found=f"{threshold:g}",
            )
        return self


class _Channel(Table):
    column: Text = ""
    unit: Text
    plane: Literal[25, 31] = _key("25 or 31")
    rake: Text


class _Probe(_Channel):
    kind: Literal["pressure"] = _key('"pressure" or "temperature"')
    immersion: Literal["hub", "tip"]
    facing: Literal["forward", "aft"]
    probe_slope: float = _key(
        "a number from 0.2 to 5", "it is near 1; is it in per cent?", ge=0.2, le=5.0
    )
    probe_offset: float = _key("a number from -0.5 to 0.5", ge=-0.5, le=0.5)


class _InCounts(_Probe):
    zoc_reference_Pa: Pascal = _key("a pressure in Pa, 0 for vacuum", ge=0.0)
    zero_count: float = _key("a code of the converter", ge=0.0)
    calibrate_count: float = _key("a code of the converter", ge=0.0)
    calibrate_pressure_Pa: Pascal = _key("a pressure in Pa")

    @model_validator(mode="after")
    def _calibrated(self) -> _InCounts:
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


class _InPressure(_Probe):
    reference_Pa: Pascal | None = _key("an absolute pressure in Pa", default=None, ge=0.0)

    @model_validator(mode="after")
    def _absolute(self) -> _InPressure:
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


class _Temperature(_Channel):
    kind: Literal["temperature"]
    recovery_factor: float = _key("a number from 0.5 to 1.1", ge=0.5, le=1.1)
    time_constant_s: float = _key("a time of 0 to 2 s", "is it in ms?", ge=0.0, le=2.0)

    @model_validator(mode="after")
    def _in_kelvin(self) -> _Temperature:
        try:
            temperature_conversion(self.unit, "")
        except InputError as error:
            raise InputError("unit", expected=error.expected, found=error.found) from None
        return self


def _tag(channel: Any) -> str:
    """Return which of the three tables a channel is; the pressure's refuses what is neither."""
    values: Mapping[str, Any] = channel if isinstance(channel, Mapping) else {}
    if values.get("kind") == "temperature":
        return TEMPERATURE
    return IN_COUNTS if values.get("unit") in (COUNT, f"{COUNT}s") else IN_PRESSURE


_AnyChannel = Annotated[
    Annotated[_InCounts, Tag(IN_COUNTS)]
    | Annotated[_InPressure, Tag(IN_PRESSURE)]
    | Annotated[_Temperature, Tag(TEMPERATURE)],
    Discriminator(_tag),
]


def _low_to_high(ends: list[float]) -> list[float]:
    if ends[0] >= ends[1]:
        raise InputError("", expected="a range [low, high]", found=f"{ends}")
    return ends


_Range = Annotated[list[float], Field(min_length=2, max_length=2), AfterValidator(_low_to_high)]


class _Document(Table):
    test: _Test = _key("a table")
    compressor: _Compressor = _key("a table")
    planes: _Planes = _key("a table")
    near_stall: _NearStall = _key("a table")
    channels: dict[Text, _AnyChannel] = _key("a table of tables")
    adc: _Converter | None = None
    near_stall_shifts: dict[str, float] | None = None
    limits: dict[str, _Range] = Field(default_factory=dict)
    segmentation: _Segmentation = Field(default_factory=_Segmentation)
    window: _Window | None = None
    file: _File = Field(default_factory=_File)

    @model_validator(mode="after")
    def _agrees(self) -> _Document:
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
        in_counts = {n: c for n, c in self.channels.items() if isinstance(c, _InCounts)}
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


def read_test_description(path: str | os.PathLike[str]) -> TestDescription:
    """Read and check test.toml.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    TestDescription
        The checked description.

    Raises
    ------
    InputError
        Naming the file, and each table and key at fault.
    """
    source = str(path)
    values = read_toml(Path(path), "the description of the test (test.toml)")
    document = validated(_Document, _with_defaults(values, source), source)
    near_stall = NearStall(**document.near_stall.model_dump())
    channels = document.channels.items()
    pressures = tuple(
        PressureChannel(**_fields(name, channel))
        for name, channel in channels
        if isinstance(channel, _Probe)
    )
    temperatures = tuple(
        TemperatureChannel(**_fields(name, channel))
        for name, channel in channels
        if isinstance(channel, _Temperature)
    )
    window = document.window
    description = TestDescription(
        **document.test.model_dump(),
        compressor=Compressor(**document.compressor.model_dump()),
        areas_m2={25: document.planes.inlet.area_m2, 31: document.planes.exit.area_m2},
        converter=None if document.adc is None else Converter(**document.adc.model_dump()),
        near_stall=near_stall,
        pressures=pressures,
        temperatures=temperatures,
        **document.segmentation.model_dump(),
        window_s=None if window is None else (window.from_s, window.to_s),
        limits={name: (low, high) for name, (low, high) in document.limits.items()},
        near_stall_shifts=document.near_stall_shifts or {},
        file=FileLayout(**document.file.model_dump()),
        source=source,
    )
    if document.near_stall_shifts is not None:
        _check_shifts(description)
    _check_columns_apart(description)
    _check_probes(description)
    return description


def _fields(name: str, channel: _Probe | _Temperature) -> dict[str, Any]:
    values = channel.model_dump(exclude={"kind"})
    if isinstance(channel, _InCounts):
        values["unit"] = COUNT
    return {"name": name, **values}


def _with_defaults(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return the file with what ``[defaults]`` says of several channels written into each.

    A table of it is for a kind (``[defaults.pressure]``), a plane (``[defaults.25]``) or a pattern
    of names (``[defaults."P25_*"]``); the later of these three prevails, and a channel's own table
    over them all. What a channel has no use for is left out of it, as a calibration of counts
    where it is recorded as a pressure.
    """
    rest = {key: table for key, table in values.items() if key != "defaults"}
    defaults, channels = values.get("defaults", {}), values.get("channels", {})
    if not defaults or not isinstance(channels, Mapping):
        return rest
    _check_defaults(defaults, channels, source)
    filled: dict[str, Any] = {}
    for name, own in channels.items():
        if not isinstance(own, Mapping):
            filled[name] = own
            continue
        stated: dict[str, Any] = {}
        for pattern, table in defaults.items():
            if pattern not in _GROUPS and fnmatchcase(name, pattern):
                stated |= table
        known = {**stated, **own}
        for group in ("plane", "kind"):
            stated = {**defaults.get(str(known.get(group)), {}), **stated}
        keys = _MODELS[_tag({**stated, **own})].model_fields
        filled[name] = {**{k: v for k, v in stated.items() if k in keys}, **own}
    return {**rest, "channels": filled}


_GROUPS = ("pressure", "temperature", "25", "31")
_MODELS: dict[str, type[_Channel]] = {
    IN_COUNTS: _InCounts,
    IN_PRESSURE: _InPressure,
    TEMPERATURE: _Temperature,
}


def _check_defaults(defaults: Any, channels: Mapping[str, Any], source: str) -> None:
    """Refuse defaults for no channel, and keys that none has: a misspelt one would be ignored."""
    known = {key for model in _MODELS.values() for key in model.model_fields}
    for name, table in defaults.items() if isinstance(defaults, Mapping) else [("", defaults)]:
        strange = [key for key in table if key not in known] if isinstance(table, Mapping) else []
        unused = name not in _GROUPS and not any(fnmatchcase(c, name) for c in channels)
        if not isinstance(table, Mapping) or strange or unused:
            raise InputError(
                f"{source}: defaults.{name}".rstrip("."),
                expected="keys of channels, for a kind, a plane or a pattern of their names",
                found=", ".join(strange) if strange else "a pattern of no name" * unused or "none",
            )


def _check_shifts(test: TestDescription) -> None:
    """Refuse a shift near stall for what is not matched, or beyond what a match would take out."""
    most = {p.name: PLAUSIBLE_BIAS * test.near_stall.pressure_Pa(p.plane) for p in test.pressures}
    most |= {
        c.name: PLAUSIBLE_BIAS_K * test.near_stall.temperature_K(c.plane) for c in test.temperatures
    }
    aft = {probe.name for probe in test.pressures if probe.facing == "aft"}
    where = f"{test.source}: near_stall_shifts"
    if not test.near_stall_shifts:
        raise InputError(where, expected="a shift for each channel", found="none")
    for name, shift in test.near_stall_shifts.items():
        if name not in most or name in aft:
            raise InputError(
                f"{where}.{name}",
                expected="the name of a forward probe or a thermocouple",
                found="an aft probe" if name in aft else "no such channel in [channels]",
                remedy="it moves with its forward mate" if name in aft else "",
            )
        if abs(shift) > most[name]:
            raise InputError(
                f"{where}.{name}",
                expected=f"{-most[name]:g} to {most[name]:g}",
                found=f"{shift:g}",
                remedy="it is added to the calibrated reading, in Pa or K",
            )


def _check_columns_apart(test: TestDescription) -> None:
    """Refuse a column that would feed two channels: one of them would be a copy."""
    taken = {} if test.file.clock == "from rate" else {test.file.time: "the clock"}
    channels: list[PressureChannel | TemperatureChannel] = [*test.pressures, *test.temperatures]
    for channel in channels:
        if channel.file_column in taken:
            raise InputError(
                f"{test.source}: channels.{channel.name}.column",
                expected="a column of its own",
                found=f"'{channel.file_column}', which feeds {taken[channel.file_column]} too",
            )
        taken[channel.file_column] = channel.name


def _check_probes(test: TestDescription) -> None:
    """Refuse a plane without probes, probes without a mate, and pairs of two calibrations."""
    lacking = [
        f"{what} at plane {plane}"
        for plane, what, there in (
            *((p, "pressure probes", any(c.plane == p for c in test.pressures)) for p in (25, 31)),
            (25, "a thermocouple", bool(test.thermocouples(25))),
        )
        if not there
    ]
    if lacking:
        where = f"{test.source}: channels"
        raise InputError(where, expected=" and ".join(lacking), found="none")
    alone = []
    for plane, rake, immersion in sorted({(c.plane, c.rake, c.immersion) for c in test.pressures}):
        here = [
            c for c in test.pressures if (c.plane, c.rake, c.immersion) == (plane, rake, immersion)
        ]
        if sorted(c.facing for c in here) != ["aft", "forward"]:
            alone += [f"{c.name} ({c.facing})" for c in here]
    if alone:
        raise InputError(
            f"{test.source}: channels",
            expected="one forward and one aft probe at each rake and immersion",
            found=", ".join(alone),
            remedy="leave out both probes of a pair, in the table too, when one is dead",
        )
    for pair in (*test.pairs(25), *test.pairs(31)):
        _check_pair(test, pair)


def _check_pair(test: TestDescription, pair: ProbePair) -> None:
    for key in ("probe_slope", "probe_offset"):
        slopes = getattr(pair.forward, key), getattr(pair.aft, key)
        if slopes[0] != slopes[1]:
            raise InputError(
                f"{test.source}: channels.{pair.forward.name}.{key}",
                expected=f"that of its mate {pair.aft.name} (Eq 2 holds for the pair)",
                found=f"{slopes[0]:g} and {slopes[1]:g}",
            )
