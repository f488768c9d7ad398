"""test.toml, read into a TestDescription; every mistake is answered with table and key."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from classic_ml.errors import InputError
from classic_ml.readers.test_description import (
    DEFAULT_THRESHOLD_LBM_S,
    Compressor,
    Converter,
    NearStall,
    PressureChannel,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.readers.toml_tables import Table

if TYPE_CHECKING:
    import os

__all__ = ["read_test_description"]

PLANES = (25, 31)
# Fewer counts than this between the zero and the calibrate reading and the sensitivity is
# not known to 1 %.
MINIMUM_CALIBRATE_COUNTS = 100.0
# A key has the name of the field that it fills; a channel's own name is that of its table.
PRESSURE_KEYS = ("kind", "unit", *(f.name for f in fields(PressureChannel) if f.name != "name"))
TEMPERATURE_KEYS = (
    "kind",
    "unit",
    *(f.name for f in fields(TemperatureChannel) if f.name != "name"),
)
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
    description = TestDescription(
        name=test.text("name"),
        sample_rate_hz=test.number("sample_rate_hz", above=0.0),
        rotor_speed_rpm=_speed(test, "rotor_speed_rpm"),
        design_corrected_speed_rpm=_speed(test, "design_corrected_speed_rpm"),
        compressor=_compressor(top),
        areas_m2=_areas(top),
        adc=adc,
        near_stall=_near_stall(top),
        pressures=pressures,
        temperatures=temperatures,
        threshold_lbm_s=threshold,
        hysteresis_lbm_s=hysteresis,
        window_s=_window(top),
        limits=_limits(top, tuple(channels)),
        source=str(file),
    )
    test.finish()
    top.finish()
    _check_pairs(description)
    return description


def _load(file: Path) -> Table:
    if not file.is_file():
        raise InputError(
            str(file),
            expected="the description of the test (test.toml)",
            found="a folder" if file.is_dir() else "no such file",
        )
    try:
        return Table(str(file), "", tomllib.loads(file.read_text("utf-8")))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(
            str(file), expected="a TOML file", found=str(error).strip().splitlines()[0]
        ) from None


def _speed(test: Table, key: str) -> float:
    """Return a speed of a compressor: a fan of 10 m turns above 100, a micro turbine below 2e5."""
    return test.number(
        key, least=100.0, most=2e5, unit="revolutions a minute", remedy="is it in Hz or rad/s?"
    )


def _compressor(top: Table) -> Compressor:
    # The limits are wider than any compressor and narrower than another unit: mm, ft·lbf, litres.
    table = top.table("compressor", COMPRESSOR_KEYS)
    compressor = Compressor(
        mean_radius_m=table.number(
            "mean_radius_m", least=0.02, most=2.0, unit="m", remedy="is it in mm or inches?"
        ),
        inertia_per_m=table.number("inertia_per_m", least=0.0, most=1e4, unit="1/m"),
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


def _converter(top: Table) -> Converter:
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
    return reading


def _channels(
    channels: Table, adc: Converter
) -> tuple[tuple[PressureChannel, ...], tuple[TemperatureChannel, ...]]:
    pressures: list[PressureChannel] = []
    temperatures: list[TemperatureChannel] = []
    for name in channels:
        table = channels.table(name)
        if table.choice("kind", ("pressure", "temperature")) == "pressure":
            table = channels.table(name, PRESSURE_KEYS)
            pressures.append(_pressure(name, table, adc))
        else:
            table = channels.table(name, TEMPERATURE_KEYS)
            temperatures.append(_temperature(name, table))
        table.finish()
    return tuple(pressures), tuple(temperatures)


def _pressure(name: str, table: Table, adc: Converter) -> PressureChannel:
    table.choice("unit", ("count",))
    channel = PressureChannel(
        name=name,
        plane=int(table.choice("plane", PLANES)),
        rake=table.text("rake"),
        immersion=str(table.choice("immersion", ("hub", "tip"))),
        facing=str(table.choice("facing", ("forward", "aft"))),
        probe_slope=table.number("probe_slope", above=0.0),
        probe_offset=table.number("probe_offset", least=-0.5, most=0.5),
        zoc_reference_Pa=table.number("zoc_reference_Pa", least=0.0),
        zero_count=table.number("zero_count", least=0.0, most=adc.top_code),
        calibrate_count=table.number("calibrate_count", least=0.0, most=adc.top_code),
        calibrate_pressure_Pa=table.number("calibrate_pressure_Pa"),
    )
    if abs(channel.calibrate_count - channel.zero_count) < MINIMUM_CALIBRATE_COUNTS:
        raise table.error(
            "calibrate_count",
            f"at least {MINIMUM_CALIBRATE_COUNTS:g} counts from zero_count",
            f"{channel.calibrate_count:g} beside {channel.zero_count:g}",
        )
    if channel.calibrate_pressure_Pa == 0.0:
        raise table.error("calibrate_pressure_Pa", "a pressure other than zero", "0")
    return channel


def _temperature(name: str, table: Table) -> TemperatureChannel:
    table.choice("unit", ("K",))
    return TemperatureChannel(
        name=name,
        plane=int(table.choice("plane", PLANES)),
        rake=table.text("rake"),
        recovery_factor=table.number("recovery_factor", least=0.5, most=1.1),
        time_constant_s=table.number("time_constant_s", least=0.0, most=10.0),
    )


def _segmentation(top: Table) -> tuple[float | None, float]:
    if "segmentation" not in top:
        return DEFAULT_THRESHOLD_LBM_S, 0.0
    table = top.table("segmentation", SEGMENTATION_KEYS)
    threshold = table.number_or("threshold_lbm_s", "none", default=DEFAULT_THRESHOLD_LBM_S)
    hysteresis = table.number("hysteresis_lbm_s", least=0.0, default=0.0)
    table.finish()
    if threshold is not None and threshold <= hysteresis:
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
