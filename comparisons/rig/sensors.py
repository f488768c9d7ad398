"""The sensors between the gas and the tape: tubes, thermocouples, transducers, converter."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, tan
from typing import Any

import numpy as np
from scipy.signal import bilinear, butter, lfilter, lfilter_zi, sosfilt, sosfilt_zi

from comparisons.rig.plant import PLANT_RATE_HZ
from surge_core.types import FloatArray

# The paper names 12 bits; the range is that of the independent record.
ADC_BITS = 12
ADC_LOW_V = -5.0
ADC_HIGH_V = 5.0

# Rakes at plane 25 are held by oil at 100 °F, transducers at plane 31 below 110 °F by water.
_OIL_K = 310.93
_WATER_K = 305.0
_WATER_LIMIT_K = 316.48
# What is zero in a sensor that hides nothing.
_OFF = (
    "noise_percent", "thermocouple_lag_s", "thermocouple_noise_k", "cells", "hub_tip",
    "probe_offset", "sensitivity_scatter", "bias_scatter_v", "sensitivity_per_k",
    "reading_noise_percent", "reference_error", "facility_error", "facility_temperature_error_k",
    "leak_lag_s",
)  # fmt: skip


@dataclass(frozen=True)
class SensorSettings:
    """Every imperfection of the instrumentation as one number that can be set to nothing.

    Parameters
    ----------
    noise_percent : float
        Standard deviation of the tape noise, in percent of full scale (half the converter's range),
        white at 10 kHz before the anti-alias filter.
    bits : int or None
        Resolution of the converter; None: no rounding and no clipping.
    tube_frequency_hz, tube_damping : float or None, float
        Second-order response of tube and transducer; None: none.
    anti_alias_hz : float or None
        Corner of a fourth-order Butterworth filter before sampling; None: none (the paper names
        none).
    thermocouple_lag_s, thermocouple_noise_k, recovery_factor : float
        Lag, noise of a sample, and T_indicated/T of the thermocouples.
    cells, hub_tip : float
        Factors on the amplitude of the stall cells and on the hub/tip shift.
    probe_offset : float
        Factor on b of Eq 2; 0 takes the dead band of the probe pairs away.
    probe_ramp : float
        Calculated Mach number below which b falls to nothing; 0: Eq 2 holds down to zero flow.
    hub_tip_bend : float
        How much more of the hub/tip shift there is per unit of flow above the mean of the record.
    sample_rate_hz : float
        Of the converter; 10 kHz divided by a whole number.
    sensitivity_scatter, bias_scatter_v : float
        Spread of the transducers' sensitivity (relative) and electrical bias (V).
    sensitivity_per_k, rake_coupling, rake_lag_s : float
        Relative change of sensitivity per kelvin of rake temperature, the share of the gas
        temperature's change that reaches the cooled rake, and how slowly.
    reading_noise_percent, reading_samples : float, int
        Noise of one sample of a zero, calibrate or operate reading in percent of full scale, and
        the number of samples averaged.
    reference_error : float
        Relative error of the facility's (and of the tape's) reading of the ZOC reference.
    facility_error, facility_temperature_error_k : float
        Error of the facility's near-stall reading: pressures (relative) and temperatures (K).
    leak_lag_s : float
        Time constant of the remote transducers on the tubes' leak path, which give the facility's
        steady pressures.
    acquisition_limits : bool
        Whether T31 readings clip at the range of the case.
    """

    noise_percent: float = 0.2
    bits: int | None = ADC_BITS
    tube_frequency_hz: float | None = 400.0
    tube_damping: float = 0.25
    anti_alias_hz: float | None = 450.0
    thermocouple_lag_s: float = 0.010
    # Scatter of the independent record's thermocouples before the surge.
    thermocouple_noise_k: float = 0.41
    recovery_factor: float = 0.994
    cells: float = 1.0
    hub_tip: float = 1.0
    probe_offset: float = 1.0
    probe_ramp: float = 0.0
    hub_tip_bend: float = 0.0
    sample_rate_hz: float = 1_000.0
    # Spread of the zero and calibrate readings in the independent record.
    sensitivity_scatter: float = 0.02
    bias_scatter_v: float = 0.05
    # 1 % in 100 °F is usual for a strain-gauge transducer; a few kelvin reach the cooled rake.
    sensitivity_per_k: float = 1.8e-4
    rake_coupling: float = 0.02
    rake_lag_s: float = 1.0
    reading_noise_percent: float = 0.2
    reading_samples: int = 400
    reference_error: float = 5e-5
    facility_error: float = 2e-4
    facility_temperature_error_k: float = 0.2
    leak_lag_s: float = 0.5
    acquisition_limits: bool = True

    @property
    def step(self) -> int:
        """Rows of the plant from one sample to the next."""
        return round(PLANT_RATE_HZ / self.sample_rate_hz)

    @classmethod
    def ideal(cls) -> SensorSettings:
        """Return sensors that hide nothing: reduction of their record must give the truth."""
        nothing: dict[str, Any] = dict.fromkeys(_OFF, 0.0)
        return cls(
            bits=None,
            tube_frequency_hz=None,
            anti_alias_hz=None,
            acquisition_limits=False,
            **nothing,
        )


def tube(signal: FloatArray, *, frequency_hz: float | None, damping: float) -> FloatArray:
    """Return the pressure behind a tube: a second-order response that starts at rest.

    Equation: p̈ + 2ζω ṗ + ω² p = ω² p_gas, by the bilinear map with its warping undone at ω. Without
    a frequency it is the signal.
    """
    if frequency_hz is None:
        return signal
    omega = 2.0 * PLANT_RATE_HZ * tan(pi * frequency_hz / PLANT_RATE_HZ)
    b, a = bilinear([omega**2], [1.0, 2.0 * damping * omega, omega**2], PLANT_RATE_HZ)
    out, _ = lfilter(b, a, signal, zi=lfilter_zi(b, a) * signal[0])
    return np.asarray(out, dtype=np.float64)


def lag(
    signal: FloatArray, *, time_constant_s: float, rate_hz: float = PLANT_RATE_HZ
) -> FloatArray:
    """Return a signal, straight lines between samples, behind a lag that starts at rest."""
    if time_constant_s == 0.0:
        return signal
    x = 1.0 / (rate_hz * time_constant_s)
    a = np.exp(-x)
    # First-order hold: exact for a signal made of straight lines.
    late = (1.0 - a) / x - a
    soon = 1.0 - (1.0 - a) / x
    start = np.array([late * signal[0] + a * signal[0]])
    out, _ = lfilter([soon, late], [1.0, -a], signal, zi=start)
    return np.asarray(out, dtype=np.float64)


def anti_alias(signal: FloatArray, *, corner_hz: float | None) -> FloatArray:
    """Return a signal behind a causal fourth-order Butterworth low-pass that starts at rest."""
    if corner_hz is None:
        return signal
    sos = butter(4, corner_hz, fs=PLANT_RATE_HZ, output="sos")
    out, _ = sosfilt(sos, signal, zi=sosfilt_zi(sos) * signal[0])
    return np.asarray(out, dtype=np.float64)


def rake_temperature_k(
    plane: int,
    gas_temperature_k: FloatArray,
    settings: SensorSettings,
    *,
    rate_hz: float = PLANT_RATE_HZ,
) -> FloatArray:
    """Return the temperature of the transducers in a cooled rake from that of the gas.

    At plane 25 oil keeps them at 100 °F, at plane 31 water below 110 °F.
    """
    change = settings.rake_coupling * (gas_temperature_k - gas_temperature_k[0])
    change = lag(change, time_constant_s=settings.rake_lag_s, rate_hz=rate_hz)
    if plane == 25:
        return _OIL_K + change
    return np.minimum(_WATER_K + change, _WATER_LIMIT_K)


def counts_from_volts(volts: FloatArray, bits: int | None) -> FloatArray:
    """Return converter codes, 0 … 2^bits − 1 as floats; without bits exact, of a 12-bit code."""
    scale = 2.0 ** (ADC_BITS if bits is None else bits) / (ADC_HIGH_V - ADC_LOW_V)
    codes = (volts - ADC_LOW_V) * scale
    if bits is None:
        return np.asarray(codes)
    return np.clip(np.round(codes), 0.0, 2.0**bits - 1.0)
