"""The plant seen through its sensors: the twenty channels of a raw record, and their tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from comparisons.rig.cases import RigCase
from comparisons.rig.cells import IMMERSIONS, RAKES, local_flow
from comparisons.rig.gas import probe_pressures_pa
from comparisons.rig.hidden import UNTOUCHED, WAKE_TIME_S, Alteration
from comparisons.rig.plant import PLANT_RATE_HZ, PlantRun
from comparisons.rig.readings import (
    CALIBRATE_PA,
    Transducer,
    ZocReference,
    draw_reference,
    draw_transducer,
    read_transducer,
)
from comparisons.rig.sensors import (
    ADC_HIGH_V,
    ADC_LOW_V,
    SensorSettings,
    anti_alias,
    counts_from_volts,
    lag,
    late,
    rake_temperature_k,
    tube,
)
from surge_core.types import FloatArray

__all__ = ["PLANES", "PROBES", "RAW_RATE_HZ", "Instrumented", "instrument"]


RAW_RATE_HZ = 1_000.0
PLANES = (25, 31)
# Constants (a, b) of Eq 2, a pair each: as in the independent record. The aft hole reads slightly
# above static, so that M_calc < M_true and a > 1.
PROBES: Mapping[tuple[int, str], tuple[float, float]] = {
    (25, "tip"): (1.10, 0.012),
    (25, "hub"): (1.08, 0.010),
    (31, "tip"): (1.09, 0.011),
    (31, "hub"): (1.07, 0.010),
}
_FACINGS = ("forward", "aft")
_STEP = round(PLANT_RATE_HZ / RAW_RATE_HZ)


@dataclass(frozen=True)
class Instrumented:
    """The channels of one record in the order of the file.

    Parameters
    ----------
    values : mapping of str to ndarray
        Counts or kelvin, one array a channel.
    channels : mapping of str to mapping
        The table of each channel in ``test.toml``.
    truth : mapping of str to mapping
        What no reduction may know: each transducer's sensitivity and bias, operate readings, and
        the reference as it is and as the tape reads it.
    """

    values: Mapping[str, FloatArray]
    channels: Mapping[str, Mapping[str, Any]]
    truth: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class _Bench:
    """What every channel of one record shares."""

    case: RigCase
    run: PlantRun
    settings: SensorSettings
    rng: np.random.Generator
    references: Mapping[int, ZocReference]
    rake_k: Mapping[int, FloatArray]
    altered: Alteration
    # A stream of its own: what is drawn for the wakes leaves every other number as it was.
    wakes: np.random.Generator


def instrument(
    case: RigCase,
    run: PlantRun,
    settings: SensorSettings,
    rng: np.random.Generator,
    altered: Alteration = UNTOUCHED,
) -> Instrumented:
    """Pass a plant run through every sensor.

    The random numbers drawn do not depend on the settings' sizes, so that switching one
    imperfection off leaves the others as they were.

    Parameters
    ----------
    case, run : RigCase, PlantRun
        The plant and what it did.
    settings : SensorSettings
        The imperfections.
    rng : numpy.random.Generator
        Source of all randomness.
    altered : Alteration
        What is hidden in the sensors; by default nothing.

    Returns
    -------
    Instrumented
        Channels, their descriptions and the sensors' truth.
    """
    bench = _Bench(
        case,
        run,
        settings,
        rng,
        {plane: draw_reference(case, plane, settings, rng) for plane in PLANES},
        {
            plane: rake_temperature_k(plane, run[f"T{plane}"], settings, rate_hz=PLANT_RATE_HZ)
            for plane in PLANES
        },
        altered,
        rng.spawn(1)[0],
    )
    values: dict[str, FloatArray] = {}
    channels: dict[str, Mapping[str, Any]] = {}
    truth: dict[str, Mapping[str, float]] = {}
    for plane in PLANES:
        for rake in RAKES:
            for immersion in IMMERSIONS:
                _add_pair(bench, plane, rake, immersion, values, channels, truth)
            name = f"T{plane}_{rake}"
            values[name] = _thermocouple(bench, plane)
            channels[name] = {
                "kind": "temperature",
                "unit": "K",
                "plane": plane,
                "rake": rake,
                "recovery_factor": settings.recovery_factor,
                "time_constant_s": settings.thermocouple_lag_s,
            }
        reference = bench.references[plane]
        truth[f"zoc_{plane}"] = {"true_Pa": reference.true_pa, "tape_Pa": reference.tape_pa}
    return Instrumented(values, channels, truth)


def _add_pair(
    bench: _Bench,
    plane: int,
    rake: str,
    immersion: str,
    values: dict[str, FloatArray],
    channels: dict[str, Mapping[str, Any]],
    truth: dict[str, Mapping[str, float]],
) -> None:
    """Add the forward and the aft channel of one probe pair."""
    case, settings = bench.case, bench.settings
    slope, offset = PROBES[plane, immersion]
    offset *= settings.probe_offset
    spot = local_flow(
        case,
        bench.run,
        settings,
        plane=plane,
        rake=rake,
        immersion=immersion,
        altered=bench.altered,
    )
    pressures = probe_pressures_pa(
        spot.corrected_kg_s,
        spot.total_pressure_pa,
        area_m2=case.inlet_area_m2 if plane == 25 else case.exit_area_m2,
        slope=slope,
        offset=offset,
    )
    if plane == 25 and bench.altered.wake_noise:
        pressures = _with_wake_noise(bench, *pressures)
    reference = bench.references[plane]
    for facing, pressure in zip(_FACINGS, pressures, strict=True):
        transducer = draw_transducer(plane, settings, bench.rng)
        reading = read_transducer(
            transducer, float(pressure[0]) - reference.true_pa, plane, settings, bench.rng
        )
        name = f"P{plane}_{rake}_{immersion}_{facing}"
        values[name] = _pressure_counts(bench, plane, pressure, transducer)
        channels[name] = {
            "kind": "pressure",
            "unit": "count",
            "plane": plane,
            "rake": rake,
            "immersion": immersion,
            "facing": facing,
            "probe_slope": slope,
            "probe_offset": offset,
            "zoc_reference_Pa": reference.facility_pa,
            "zero_count": reading.zero_count,
            "calibrate_count": reading.calibrate_count,
            "calibrate_pressure_Pa": CALIBRATE_PA[plane],
        }
        truth[name] = {
            "sensitivity_V_Pa": transducer.sensitivity_v_pa,
            "bias_V": transducer.bias_v,
            "operate_count": reading.operate_count,
        }


def _with_wake_noise(
    bench: _Bench, forward_pa: FloatArray, aft_pa: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Shake the hole of a pair that lies downstream, in the wake of the probe's own support."""
    white = bench.wakes.standard_normal(forward_pa.size)
    eddies = lag(white, time_constant_s=WAKE_TIME_S, rate_hz=PLANT_RATE_HZ)
    shake = bench.altered.wake_noise * eddies / np.std(eddies) * np.abs(forward_pa - aft_pa)
    forward_flow = forward_pa >= aft_pa
    return (
        np.where(forward_flow, forward_pa, forward_pa + shake),
        np.where(forward_flow, aft_pa + shake, aft_pa),
    )


def _pressure_counts(
    bench: _Bench, plane: int, pressure_pa: FloatArray, transducer: Transducer
) -> FloatArray:
    """Return the converter's counts: tube, transducer, tape, anti-alias filter, converter."""
    settings, altered = bench.settings, bench.altered
    if plane == 31:
        pressure_pa = lag(pressure_pa, time_constant_s=altered.exit_cavity_s, rate_hz=PLANT_RATE_HZ)
        pressure_pa = late(pressure_pa, delay_s=altered.exit_late_s, rate_hz=PLANT_RATE_HZ)
    felt = tube(
        pressure_pa,
        frequency_hz=settings.tube_frequency_hz,
        damping=settings.tube_damping,
        rate_hz=PLANT_RATE_HZ,
    )
    warmth = bench.rake_k[plane] - bench.rake_k[plane][0]
    sensitivity = transducer.sensitivity_v_pa * (1.0 + settings.sensitivity_per_k * warmth)
    bias_v: float | FloatArray = transducer.bias_v
    if plane == 31:
        time_s = np.arange(felt.size) / PLANT_RATE_HZ
        sensitivity = sensitivity * (1.0 + altered.exit_gain_per_s * time_s)
        bias_v = bias_v + altered.exit_zero_v_s * time_s
    noise = settings.noise_percent / 100.0 * 0.5 * (ADC_HIGH_V - ADC_LOW_V)
    tape = (
        bias_v
        + sensitivity * (felt - bench.references[plane].true_pa)
        + noise * bench.rng.standard_normal(felt.size)
    )
    volts = anti_alias(tape, corner_hz=settings.anti_alias_hz, rate_hz=PLANT_RATE_HZ)[::_STEP]
    return counts_from_volts(volts, settings.bits)


def _thermocouple(bench: _Bench, plane: int) -> FloatArray:
    """Return one thermocouple's reading in K: recovery, lag, noise, and the range's limit."""
    settings = bench.settings
    unstated_s = bench.altered.thermocouple_lag_s if plane == 25 else 0.0
    junction = lag(
        settings.recovery_factor * bench.run[f"T{plane}"],
        time_constant_s=settings.thermocouple_lag_s + unstated_s,
        rate_hz=PLANT_RATE_HZ,
    )[::_STEP]
    reading = junction + settings.thermocouple_noise_k * bench.rng.standard_normal(junction.size)
    limit = bench.case.t31_limit_k
    if plane == 31 and settings.acquisition_limits and limit is not None:
        reading = np.clip(reading, *limit)
    return np.asarray(reading, dtype=np.float64)
