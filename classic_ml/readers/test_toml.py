"""test.toml, read into a TestDescription; every mistake is answered with table and key."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from classic_ml.readers.test_description import (
    PLAUSIBLE_BIAS,
    PLAUSIBLE_BIAS_K,
    Compressor,
    Converter,
    FileLayout,
    NearStall,
    PressureChannel,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.readers.toml_file import load_toml
from classic_ml.readers.toml_tables import Table
from classic_ml.units import (
    COUNT,
    kind_of_unit,
    pressure_conversion,
    temperature_conversion,
    time_conversion,
)
from surge_core.errors import InputError

if TYPE_CHECKING:
    import os

__all__ = ["read_test_description"]

PLANES = (25, 31)
# Fewer counts than this between the zero and the calibrate reading and the sensitivity is
# not known to 1 %.
MINIMUM_CALIBRATE_COUNTS = 100.0
# No rake is calibrated by less than a twentieth of a metre of water, nor stands in such a vacuum.
LEAST_CALIBRATE_PA, LEAST_REFERENCE_PA = 500.0, 1000.0
# Corrected speeds near stall, as shares of the design speed, and the temperature they refer to.
SPEED_SHARES, STANDARD_K = (0.1, 1.5), 288.15
# A key has the name of the field that it fills; a channel's own name is that of its table.
PRESSURE_KEYS = ("kind", *(f.name for f in fields(PressureChannel) if f.name != "name"))
TEMPERATURE_KEYS = ("kind", *(f.name for f in fields(TemperatureChannel) if f.name != "name"))
# What a channel in counts is calibrated by; one that is recorded as a pressure has none of it.
COUNT_KEYS = ("zoc_reference_Pa", "zero_count", "calibrate_count", "calibrate_pressure_Pa")
FILE_KEYS = tuple(f.name for f in fields(FileLayout))
COMPRESSOR_KEYS = tuple(f.name for f in fields(Compressor))
NEAR_STALL_KEYS = tuple(f.name for f in fields(NearStall))
SEGMENTATION_KEYS = ("threshold_lbm_s", "hysteresis_lbm_s")


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
        Naming the file, the table and the key at fault.
    """
    file = Path(path)
    top = _load(file)
    test = top.table("test")
    adc = _converter(top)
    channels = top.table("channels")
    pressures, temperatures = _channels(channels, adc)
    threshold, hysteresis = _segmentation(top)
    near_stall = _near_stall(top)
    description = TestDescription(
        name=test.text("name"),
        sample_rate_hz=test.number("sample_rate_hz", above=0.0),
        rotor_speed_rpm=_speed(test, "rotor_speed_rpm"),
        design_corrected_speed_rpm=_speed(test, "design_corrected_speed_rpm"),
        compressor=_compressor(top),
        areas_m2=_areas(top),
        converter=adc,
        near_stall=near_stall,
        pressures=pressures,
        temperatures=temperatures,
        threshold_lbm_s=threshold,
        hysteresis_lbm_s=hysteresis,
        window_s=_window(top),
        limits=_limits(top, tuple(channels)),
        near_stall_shifts=_near_stall_shifts(top, near_stall, pressures, temperatures),
        file=_file(top),
        source=str(file),
    )
    _check_speed(test, description)
    test.finish()
    top.finish()
    _check_columns_apart(description)
    _check_pairs(description)
    return description


def _load(file: Path) -> Table:
    return Table(str(file), "", load_toml(file, "the description of the test (test.toml)"))


def _speed(test: Table, key: str) -> float:
    """Return a speed of a compressor: a fan of 10 m turns above 100, a micro turbine below 2e5."""
    return test.number(
        key, least=100.0, most=2e5, unit="revolutions a minute", remedy="is it in Hz or rad/s?"
    )


def _check_speed(test: Table, description: TestDescription) -> None:
    """Refuse a design speed that the test comes nowhere near."""
    inlet_K = description.near_stall.T25_K
    corrected_rpm = description.rotor_speed_rpm * (STANDARD_K / inlet_K) ** 0.5
    share = corrected_rpm / description.design_corrected_speed_rpm
    if not SPEED_SHARES[0] <= share <= SPEED_SHARES[1]:
        raise test.error(
            "design_corrected_speed_rpm",
            f"a speed in revolutions a minute of which {corrected_rpm:.4g}, the corrected speed of "
            f"the test, is {SPEED_SHARES[0]:g} to {SPEED_SHARES[1]:g} times",
            f"{description.design_corrected_speed_rpm:g}",
            "is it in Hz or rad/s?",
        )


def _compressor(top: Table) -> Compressor:
    # The limits are wider than any compressor and narrower than another unit: mm, ft·lbf, litres.
    table = top.table("compressor", COMPRESSOR_KEYS)
    compressor = Compressor(
        mean_radius_m=table.number(
            "mean_radius_m", least=0.02, most=2.0, unit="m", remedy="is it in mm or inches?"
        ),
        inertia_per_m=table.number(
            "inertia_per_m",
            above=0.0,
            most=1e4,
            unit="1/m",
            remedy="it is ∫dx/A; ReductionSettings.inertia_factor of 0 leaves its term out",
        ),
        internal_volume_m3=table.number(
            "internal_volume_m3", least=0.0, most=10.0, unit="m³", remedy="is it in litres?"
        ),
        gamma=table.number("gamma", above=1.0, below=2.0),
        gas_constant_J_kg_K=table.number(
            "gas_constant_J_kg_K",
            least=200.0,
            most=600.0,
            unit="J/(kg K)",
            remedy="air has 287.05; 53.35 is in ft lbf/(lbm °R)",
        ),
    )
    table.finish()
    return compressor


def _converter(top: Table) -> Converter | None:
    if "adc" not in top:
        return None
    table = top.table("adc")
    converter = Converter(
        bits=table.whole("bits", least=4, most=32),
        low_V=table.number("low_V"),
        high_V=table.number("high_V"),
    )
    table.finish()
    if converter.high_V <= converter.low_V:
        raise table.error(
            "high_V", f"more than low_V ({converter.low_V:g} V)", f"{converter.high_V:g}"
        )
    return converter


def _areas(top: Table) -> dict[int, float]:
    planes = top.table("planes")
    areas = {}
    for plane in PLANES:
        table = planes.table(str(plane))
        areas[plane] = table.number(
            "area_m2", least=1e-4, most=10.0, unit="m²", remedy="is it in cm² or square inches?"
        )
        table.finish()
    planes.finish()
    return areas


def _near_stall(top: Table) -> NearStall:
    table = top.table("near_stall", NEAR_STALL_KEYS)
    kilo, absolute = "is it in kPa or psi?", "is it in °C?"
    reading = NearStall(
        from_s=table.number("from_s"),
        to_s=table.number("to_s"),
        P25_Pa=table.number("P25_Pa", least=1e3, most=1e8, unit="Pa", remedy=kilo),
        T25_K=table.number("T25_K", least=100.0, most=2e3, unit="K", remedy=absolute),
        P31_Pa=table.number("P31_Pa", least=1e3, most=1e8, unit="Pa", remedy=kilo),
        T31_K=table.number("T31_K", least=100.0, most=2e3, unit="K", remedy=absolute),
    )
    table.finish()
    if reading.to_s <= reading.from_s:
        raise table.error("to_s", f"a time after from_s ({reading.from_s:g} s)", f"{reading.to_s}")
    for kind in ("P25_Pa", "P31_Pa"), ("T25_K", "T31_K"):
        before, behind = (getattr(reading, key) for key in kind)
        if behind <= before:
            raise table.error(
                kind[1],
                f"more than {kind[0]} ({before:g})",
                f"{behind:g}",
                "are the planes exchanged?",
            )
    return reading


def _channels(
    channels: Table, adc: Converter | None
) -> tuple[tuple[PressureChannel, ...], tuple[TemperatureChannel, ...]]:
    pressures: list[PressureChannel] = []
    temperatures: list[TemperatureChannel] = []
    for name in channels:
        if not name.isprintable():
            raise channels.error(name, "a name without control characters", "some")
        table = channels.table(name)
        if table.choice("kind", ("pressure", "temperature")) == "pressure":
            table = channels.table(name, PRESSURE_KEYS)
            pressures.append(_pressure(name, table, adc))
        else:
            table = channels.table(name, TEMPERATURE_KEYS)
            temperatures.append(_temperature(name, table))
        table.finish()
    return tuple(pressures), tuple(temperatures)


def _pressure(name: str, table: Table, adc: Converter | None) -> PressureChannel:
    unit = table.text("unit")
    unit = COUNT if unit == f"{COUNT}s" else unit
    channel = PressureChannel(
        name=name,
        plane=int(table.choice("plane", PLANES)),
        rake=table.text("rake"),
        immersion=str(table.choice("immersion", ("hub", "tip"))),
        facing=str(table.choice("facing", ("forward", "aft"))),
        probe_slope=table.number(
            "probe_slope", least=0.2, most=5.0, remedy="it is near 1; is it in per cent?"
        ),
        probe_offset=table.number("probe_offset", least=-0.5, most=0.5),
        unit=unit,
        column=table.text("column") if "column" in table else "",
    )
    return _in_counts(channel, table, adc) if unit == COUNT else _in_pressure(channel, table)


def _in_counts(channel: PressureChannel, table: Table, adc: Converter | None) -> PressureChannel:
    """Add the calibration of a channel in counts."""
    if adc is None:
        raise InputError(
            table.file,
            expected=f"a table [adc], since {channel.name} is in counts",
            found="none",
        )
    if "reference_Pa" in table:
        raise table.error(
            "reference_Pa", "none for a channel in counts", "one", "it has zoc_reference_Pa"
        )
    channel = replace(
        channel,
        zoc_reference_Pa=table.number("zoc_reference_Pa", least=0.0, unit="Pa"),
        zero_count=table.number("zero_count", least=0.0, most=adc.top_code),
        calibrate_count=table.number("calibrate_count", least=0.0, most=adc.top_code),
        calibrate_pressure_Pa=table.number("calibrate_pressure_Pa", unit="Pa"),
    )
    if abs(channel.calibrate_count - channel.zero_count) < MINIMUM_CALIBRATE_COUNTS:
        raise table.error(
            "calibrate_count",
            f"at least {MINIMUM_CALIBRATE_COUNTS:g} counts from zero_count",
            f"{channel.calibrate_count:g} beside {channel.zero_count:g}",
        )
    _check_pascal(channel, table)
    return channel


def _check_pascal(channel: PressureChannel, table: Table) -> None:
    """Refuse a reference or a calibrate pressure that nobody has, but in another unit."""
    step_Pa, reference_Pa = channel.calibrate_pressure_Pa, channel.zoc_reference_Pa
    if step_Pa == 0.0:
        raise table.error("calibrate_pressure_Pa", "a pressure other than zero", "0")
    for key, value, least in (
        ("calibrate_pressure_Pa", step_Pa, LEAST_CALIBRATE_PA),
        ("zoc_reference_Pa", reference_Pa, LEAST_REFERENCE_PA),
    ):
        # A transducer against vacuum has a reference of zero.
        if value and abs(value) < least:
            raise table.error(
                key, f"a pressure in Pa, {least:g} and more", f"{value:g}", "is it in kPa or psi?"
            )


def _in_pressure(channel: PressureChannel, table: Table) -> PressureChannel:
    """Check the unit of a channel that is recorded as a pressure, and add its reference."""
    if kind_of_unit(channel.unit) != "pressure":
        try:
            pressure_conversion(channel.unit, table.where, 0.0)
        except InputError as error:
            expected = f'"{COUNT}", or {error.expected}'
            raise table.error("unit", expected, error.found, error.remedy) from None
    for key in COUNT_KEYS:
        if key in table:
            raise table.error(
                key,
                f'none for a channel in "{channel.unit}"',
                "one",
                'it belongs to a channel whose unit is "count"',
            )
    reference_Pa = (
        table.number("reference_Pa", least=0.0, unit="Pa") if "reference_Pa" in table else None
    )
    pressure_conversion(channel.unit, table.where, reference_Pa)
    return replace(channel, reference_Pa=reference_Pa)


def _temperature(name: str, table: Table) -> TemperatureChannel:
    unit = table.text("unit")
    temperature_conversion(unit, table.where)
    return TemperatureChannel(
        name=name,
        plane=int(table.choice("plane", PLANES)),
        rake=table.text("rake"),
        recovery_factor=table.number("recovery_factor", least=0.5, most=1.1),
        time_constant_s=table.number(
            "time_constant_s", least=0.0, most=2.0, unit="s", remedy="is it in ms?"
        ),
        unit=unit,
        column=table.text("column") if "column" in table else "",
    )


def _file(top: Table) -> FileLayout:
    if "file" not in top:
        return FileLayout()
    table = top.table("file", FILE_KEYS)
    usual = FileLayout()
    layout = FileLayout(
        time=table.text("time") if "time" in table else usual.time,
        time_unit=table.text("time_unit") if "time_unit" in table else None,
        group=table.text("group") if "group" in table else None,
        clock=_choice_or(table, "clock", ("column", "from rate"), usual.clock),
        start_s=table.number("start_s") if "start_s" in table else None,
        other_columns=_choice_or(table, "other_columns", ("refuse", "ignore"), usual.other_columns),
        units=_choice_or(table, "units", ("check", "from test.toml"), usual.units),
    )
    table.finish()
    if layout.time_unit is not None:
        time_conversion(layout.time_unit, f"{table.where} time_unit")
    if layout.clock == "from rate":
        for key in ("time", "time_unit"):
            if key in table:
                raise table.error(key, 'none beside clock = "from rate"', "one")
    return layout


def _choice_or(table: Table, key: str, choices: tuple[str, ...], default: str) -> str:
    return str(table.choice(key, choices)) if key in table else default


def _segmentation(top: Table) -> tuple[float | str | None, float]:
    if "segmentation" not in top:
        return None, 0.0
    table = top.table("segmentation", SEGMENTATION_KEYS)
    threshold: float | str | None = None
    if "threshold_lbm_s" in table:
        threshold = table.number_or("threshold_lbm_s", "none", default=0.0)
        threshold = "none" if threshold is None else threshold
    hysteresis = table.number("hysteresis_lbm_s", least=0.0, default=0.0)
    table.finish()
    if isinstance(threshold, float) and threshold <= hysteresis:
        raise table.error(
            "threshold_lbm_s", f"more than the hysteresis ({hysteresis:g})", f"{threshold:g}"
        )
    return threshold, hysteresis


def _window(top: Table) -> tuple[float, float] | None:
    if "window" not in top:
        return None
    table = top.table("window", ("from_s", "to_s"))
    window = (table.number("from_s"), table.number("to_s"))
    table.finish()
    if window[1] <= window[0]:
        raise table.error("to_s", f"a time after from_s ({window[0]:g} s)", f"{window[1]:g}")
    return window


def _limits(top: Table, channels: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    if "limits" not in top:
        return {}
    table = top.table("limits")
    for name in table:
        if name not in channels:
            raise table.error(name, "the name of a channel", "no such channel in [channels]")
    return {name: table.interval(name) for name in table}


def _near_stall_shifts(
    top: Table,
    reading: NearStall,
    pressures: tuple[PressureChannel, ...],
    temperatures: tuple[TemperatureChannel, ...],
) -> dict[str, float]:
    """Return by how much each channel is off near stall, where the record does not show it."""
    if "near_stall_shifts" not in top:
        return {}
    table = top.table("near_stall_shifts")
    most = {p.name: PLAUSIBLE_BIAS * reading.pressure_Pa(p.plane) for p in pressures}
    most |= {c.name: PLAUSIBLE_BIAS_K * reading.temperature_K(c.plane) for c in temperatures}
    aft = {probe.name for probe in pressures if probe.facing == "aft"}
    shifts = {}
    for name in table:
        if name not in most or name in aft:
            found = "an aft probe" if name in aft else "no such channel in [channels]"
            remedy = "it moves with its forward mate" if name in aft else ""
            expected = "the name of a forward probe or a thermocouple"
            raise table.error(name, expected, found, remedy)
        # A difference: a text with a unit that has a zero of its own would be none.
        remedy = "it is added to the calibrated reading, in Pa or K"
        shifts[name] = table.number(name, least=-most[name], most=most[name], remedy=remedy)
    if not shifts:
        raise InputError(table.where, expected="a shift for each channel", found="none")
    return shifts


def _check_columns_apart(test: TestDescription) -> None:
    """Refuse a column that would feed two channels: one of them would be a copy."""
    taken = {} if test.file.clock == "from rate" else {test.file.time: "the clock"}
    channels: list[PressureChannel | TemperatureChannel] = [*test.pressures, *test.temperatures]
    for channel in channels:
        if channel.file_column in taken:
            raise InputError(
                f"{test.source}: [channels.{channel.name}] column",
                expected="a column of its own",
                found=f"'{channel.file_column}', which feeds {taken[channel.file_column]} too",
            )
        taken[channel.file_column] = channel.name


def _check_pairs(test: TestDescription) -> None:
    for plane in PLANES:
        probes = [c for c in test.pressures if c.plane == plane]
        if not probes:
            raise InputError(
                f"{test.source}: [channels]",
                expected=f"pressure probes at plane {plane}",
                found="none",
            )
        for place in sorted({(c.rake, c.immersion) for c in probes}):
            _check_pair(test, [c for c in probes if (c.rake, c.immersion) == place])
    if not test.thermocouples(25):
        raise InputError(
            f"{test.source}: [channels]", expected="a thermocouple at plane 25", found="none"
        )


def _check_pair(test: TestDescription, probes: list[PressureChannel]) -> None:
    where = f"{test.source}: [channels.{probes[0].name}]"
    place = f"rake {probes[0].rake} {probes[0].immersion} of plane {probes[0].plane}"
    if sorted(c.facing for c in probes) != ["aft", "forward"]:
        raise InputError(
            where,
            expected=f"one forward and one aft probe at {place}",
            found=", ".join(f"{c.name} ({c.facing})" for c in probes),
            remedy="leave out both probes of a pair, in the table too, when one is dead",
        )
    for key in ("probe_slope", "probe_offset"):
        if getattr(probes[0], key) != getattr(probes[1], key):
            raise InputError(
                f"{where} {key}",
                expected=f"the same {key} for both probes at {place} (Eq 2 holds for the pair)",
                found=f"{getattr(probes[0], key):g} and {getattr(probes[1], key):g}",
            )
