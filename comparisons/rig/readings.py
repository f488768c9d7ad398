"""Readings around a record: ZOC zero and calibrate, the ZOC reference, the near-stall point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comparisons.rig.cases import RigCase
from comparisons.rig.gas import PSI_PA
from comparisons.rig.plant import PLANT_RATE_HZ, PlantRun
from comparisons.rig.sensors import (
    ADC_HIGH_V,
    ADC_LOW_V,
    SensorSettings,
    counts_from_volts,
    lag,
)
from surge_core.types import FloatArray

__all__ = [
    "CALIBRATE_PA",
    "NEAR_STALL_S",
    "Transducer",
    "TransducerReading",
    "ZocReference",
    "draw_reference",
    "draw_transducer",
    "read_near_stall",
    "read_transducer",
    "remote_pressure_pa",
]


# Nominal ranges ±10 psi (plane 25) and ±110 psi (plane 31) over ±5 V; calibrate pressures 6 and
# 66 psi: as in the independent record.
_RANGE_PA = {25: 10.0 * PSI_PA, 31: 110.0 * PSI_PA}
CALIBRATE_PA = {25: 6.0 * PSI_PA, 31: 66.0 * PSI_PA}
# Facility readings average this long before the throttle closes, as in the independent record.
NEAR_STALL_S = (0.0, 0.14)


class Transducer(NamedTuple):
    """One differential transducer as it really is.

    Its sensitivity, in V/Pa, is that at the rake temperature of the calibrate reading; its
    electrical bias is in V.
    """

    sensitivity_v_pa: float
    bias_v: float


class TransducerReading(NamedTuple):
    """Mean counts of the three ZOC modes, taken one after the other before the surge.

    Sense side coupled to the reference; known pressure difference applied; normal operation.
    """

    zero_count: float
    calibrate_count: float
    operate_count: float


class ZocReference(NamedTuple):
    """The reference pressure of one plane, and what tape and facility read of it, in Pa."""

    true_pa: float
    tape_pa: float
    facility_pa: float


def draw_transducer(plane: int, settings: SensorSettings, rng: np.random.Generator) -> Transducer:
    """Draw one transducer's unknown sensitivity and bias: two numbers, whatever the spreads."""
    scatter, bias = rng.standard_normal(2)
    nominal = ADC_HIGH_V / _RANGE_PA[plane]
    return Transducer(
        nominal * (1.0 + settings.sensitivity_scatter * float(scatter)),
        settings.bias_scatter_v * float(bias),
    )


def draw_reference(
    case: RigCase, plane: int, settings: SensorSettings, rng: np.random.Generator
) -> ZocReference:
    """Return the ZOC reference of a plane with its two readings."""
    true = case.zoc_inlet_pa if plane == 25 else case.zoc_exit_pa
    tape, facility = true * (1.0 + settings.reference_error * rng.standard_normal(2))
    return ZocReference(true, float(tape), float(facility))


def read_transducer(
    transducer: Transducer,
    operate_pa: float,
    plane: int,
    settings: SensorSettings,
    rng: np.random.Generator,
) -> TransducerReading:
    """Take the zero, calibrate and operate readings of one transducer.

    Parameters
    ----------
    transducer : Transducer
        The transducer.
    operate_pa : float
        Steady pressure difference against the reference in operate mode.
    plane : int
        25 or 31; states the calibrate pressure.
    settings : SensorSettings
        Noise and length of the readings, resolution of the converter.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    TransducerReading
        Mean counts.
    """
    noise = settings.reading_noise_percent / 100.0 * 0.5 * (ADC_HIGH_V - ADC_LOW_V)
    means = []
    for difference in (0.0, CALIBRATE_PA[plane], operate_pa):
        volts = transducer.bias_v + transducer.sensitivity_v_pa * difference
        samples = volts + noise * rng.standard_normal(settings.reading_samples)
        means.append(float(np.mean(counts_from_volts(samples, settings.bits))))
    return TransducerReading(*means)


def remote_pressure_pa(
    tube_pa: FloatArray, settings: SensorSettings, *, rate_hz: float
) -> FloatArray:
    """Return what the remote transducer on the leak path of a tube reads, at rest at first.

    The leak past the high-response transducer is slow: the steady pressure passes, surge does not.
    """
    return lag(tube_pa, time_constant_s=settings.leak_lag_s, rate_hz=rate_hz)


def read_near_stall(
    run: PlantRun, settings: SensorSettings, rng: np.random.Generator
) -> dict[str, float]:
    """Take the facility's near-stall reading: means over `NEAR_STALL_S`.

    Pressures come from the slow remote transducers on the leak path of the rakes' tubes,
    temperatures from the facility's own thermocouples.

    Parameters
    ----------
    run : PlantRun
        What the plant did.
    settings : SensorSettings
        Lag of the remote transducers and errors of the readings.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    dict of str to float
        As in ``test.toml``: P25_Pa, T25_K, P31_Pa, T31_K.
    """
    last = round(NEAR_STALL_S[1] * PLANT_RATE_HZ) + 1
    errors = rng.standard_normal(4)
    reading = {}
    for name, error in zip(("P25_Pa", "T25_K", "P31_Pa", "T31_K"), errors, strict=True):
        signal = run[name.partition("_")[0]][:last]
        if name.endswith("_Pa"):
            remote = remote_pressure_pa(signal, settings, rate_hz=PLANT_RATE_HZ)
            reading[name] = float(np.mean(remote)) * (1.0 + settings.facility_error * float(error))
        else:
            off = settings.facility_temperature_error_k * float(error)
            reading[name] = float(np.mean(signal)) + off
    return reading
