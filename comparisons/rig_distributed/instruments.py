"""What the signals pass on their way to the file, and how a set of instruments is drawn.

All settings are those of one record. Its own code throughout: tube, filter and converter share
nothing with those of the lumped rig.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from comparisons.rig_distributed.plant import PLANT_HZ
from surge_core.types import FloatArray

# Spans of transducers that are made, in Pa: 35 kPa (5 psid) and upwards.
SPANS_PA = (35e3, 70e3, 100e3, 170e3, 350e3, 700e3, 1.7e6)


@dataclass(frozen=True)
class Instruments:
    """Imperfections of the instruments.

    Parameters
    ----------
    rate_hz : float
        Samples a second; `PLANT_HZ` divided by a whole number.
    bits, half_scale_v : int, float
        Converter, from −half_scale_v to +half_scale_v.
    noise_frac : float
        Standard deviation of the amplifier's noise over the half scale, white at `PLANT_HZ`.
    tube_hz, tube_damping : float
        Natural frequency and damping of the air in the tube before a transducer.
    filter_frac : float
        Corner of the anti-alias filter (Bessel, fourth order) over the sample rate.
    junction_s, junction_error, recovery_factor, junction_noise_k : float
        Thermocouples: time constant as it is stated, relative error of the statement, indicated
        over true temperature, noise of a sample.
    probe_knee : float
        Calculated Mach number below which the offset of the probes' calibration vanishes.
    gain_scatter, bias_v : float
        Spread of the transducers' sensitivity (relative) and of their zero.
    facility_frac, facility_k : float
        Error of the facility's near-stall reading: pressures (relative) and temperatures.
    """

    rate_hz: float = 1_000.0
    bits: int = 14
    half_scale_v: float = 10.0
    noise_frac: float = 0.002
    tube_hz: float = 420.0
    tube_damping: float = 0.3
    filter_frac: float = 0.45
    junction_s: float = 0.010
    junction_error: float = 0.05
    recovery_factor: float = 0.995
    junction_noise_k: float = 0.3
    probe_knee: float = 0.02
    gain_scatter: float = 0.02
    bias_v: float = 0.08
    facility_frac: float = 2e-4
    facility_k: float = 0.2


def draw_instruments(rng: np.random.Generator) -> Instruments:
    """Draw the instruments of one record."""
    return Instruments(
        rate_hz=float(rng.choice([1_000.0, 1_000.0, 2_000.0])),
        bits=int(rng.choice([12, 14, 16])),
        noise_frac=float(10.0 ** rng.uniform(-3.3, -2.5)),
        tube_hz=float(rng.uniform(300.0, 600.0)),
        tube_damping=float(rng.uniform(0.2, 0.5)),
        junction_s=float(rng.uniform(0.005, 0.015)),
        junction_error=float(rng.uniform(-0.1, 0.1)),
        recovery_factor=float(rng.uniform(0.990, 0.998)),
        probe_knee=float(rng.uniform(0.01, 0.03)),
    )


def _through(system: tuple[FloatArray, FloatArray], values: FloatArray) -> FloatArray:
    """Pass a signal through a continuous transfer function of unit gain, from rest.

    Between the samples of the plant the signal is taken as straight lines.
    """
    a, b, c, d, _ = signal.cont2discrete(signal.tf2ss(*system), 1.0 / PLANT_HZ, method="foh")
    numerator, denominator = signal.ss2tf(a, b, c, d)
    start = signal.lfilter_zi(numerator[0], denominator) * values[0]
    return np.asarray(signal.lfilter(numerator[0], denominator, values, zi=start)[0])


def transducer_pa(pressure_pa: FloatArray, fitted: Instruments) -> FloatArray:
    """Return the pressure behind the tube: p̈ + 2ζω ṗ + ω² p = ω² p_gas."""
    omega = 2.0 * np.pi * fitted.tube_hz
    system = np.array([omega**2]), np.array([1.0, 2.0 * fitted.tube_damping * omega, omega**2])
    return _through(system, pressure_pa)


def thermocouple(
    temperature_k: FloatArray, fitted: Instruments, rng: np.random.Generator
) -> FloatArray:
    """Return the readings of one thermocouple at the record's rate, from the gas at `PLANT_HZ`."""
    lag_s = fitted.junction_s * (1.0 + fitted.junction_error)
    junction = _through((np.array([1.0]), np.array([lag_s, 1.0])), temperature_k)
    samples = fitted.recovery_factor * junction[:: round(PLANT_HZ / fitted.rate_hz)]
    return np.asarray(samples + fitted.junction_noise_k * rng.standard_normal(samples.size))


def codes(volts: FloatArray, fitted: Instruments, rng: np.random.Generator) -> FloatArray:
    """Return the converter's codes at the record's rate: noise, anti-alias filter, steps, ends."""
    noisy = volts + fitted.noise_frac * fitted.half_scale_v * rng.standard_normal(volts.size)
    corner = 2.0 * np.pi * fitted.filter_frac * fitted.rate_hz
    kept = _through(signal.bessel(4, corner, analog=True, norm="mag"), noisy)
    kept = kept[:: round(PLANT_HZ / fitted.rate_hz)]
    step_v = 2.0 * fitted.half_scale_v / 2**fitted.bits
    return np.asarray(
        np.clip(np.floor(kept / step_v + 0.5) + 2 ** (fitted.bits - 1), 0, 2**fitted.bits - 1)
    )
