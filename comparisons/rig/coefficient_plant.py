"""The compressor of a test at the level of coefficients, and its state at instants of a record.

Surge is closed formulae: the true φ, T25 and Nc of a test are known at any instant.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline
from scipy.signal import butter, hilbert, sosfiltfilt

from surge_core.types import FloatArray

# What is left at the start of a record of the state it was begun from: exp(-12).
LEAD_TIME_CONSTANTS = 12.0
# Facility clock from one record's start to the next, in durations: a third of the clock is pause.
_RECORD_SPACING = 1.5
# Range of the time constant.
_TAU_S = (0.06, 0.20)
_QUANTILE_POINTS = 2000
# The amplitude of surge is what varies more slowly than this share of its frequency ...
_AMPLITUDE_BAND = 0.25
# ... taken over so many cycles before and after the record that no edge is felt inside it.
_AMPLITUDE_LEAD_CYCLES = 16
_POINTS_PER_CYCLE = 64
# Lowest and highest surge frequency in Hz; each record has its own.
_SURGE_HZ = (0.8, 1.6)
# The broadband part: number of its tones, its rms over the amplitude of surge, its highest
# frequency in Hz.
_BROADBAND_TONES, _BROADBAND, _BROADBAND_HZ = 16, 0.02, 4.0


@dataclass(frozen=True)
class FlowSignal:
    """φ(t) of one record: a modulated wave with harmonics, and a small broadband part.

    φ = mean + A a(t) Σ hₖ sin(kθ(t) + pₖ) + Σ bⱼ sin(2πfⱼt + qⱼ), a = 1 + m sin(2πfₘt + pₘ),
    θ = 2πft + p + w sin(2πf_w t + p_w), with t from the record's own start.
    """

    origin_s: float  # Start of the record on the facility clock
    surge_hz: float  # f
    mean: float
    amplitude: float  # A
    phase: float  # p in rad
    modulation: tuple[float, float, float]  # m, fₘ, pₘ
    wander: tuple[float, float, float]  # w in rad, f_w, p_w
    harmonics: FloatArray  # Rows of hₖ and pₖ, k from 1 on
    tones: FloatArray  # Rows of bⱼ, fⱼ, qⱼ

    def angle(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return θ in rad and dθ/dt in rad/s at times on the facility clock."""
        t = time_s - self.origin_s
        depth, hz, phase = self.wander
        inner = 2.0 * pi * hz * t + phase
        angle = 2.0 * pi * self.surge_hz * t + self.phase + depth * np.sin(inner)
        return angle, 2.0 * pi * (self.surge_hz + depth * hz * np.cos(inner))

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return φ and dφ/dt in 1/s at times on the facility clock."""
        angle, speed = self.angle(time_s)
        t = time_s - self.origin_s
        depth, hz, phase = self.modulation
        wave, rate = np.zeros_like(t), np.zeros_like(t)
        for k, (size, lag) in enumerate(self.harmonics, start=1):
            wave += size * np.sin(k * angle + lag)
            rate += k * size * np.cos(k * angle + lag)
        inner = 2.0 * pi * hz * t + phase
        swell = 1.0 + depth * np.sin(inner)
        rate = rate * speed * swell
        rate += wave * depth * 2.0 * pi * hz * np.cos(inner)
        rate *= self.amplitude
        wave *= self.amplitude * swell
        for size, tone_hz, lag in self.tones:
            wave += size * np.sin(2.0 * pi * tone_hz * t + lag)
            rate += size * 2.0 * pi * tone_hz * np.cos(2.0 * pi * tone_hz * t + lag)
        return self.mean + wave, rate

    def values(self, time_s: FloatArray) -> FloatArray:
        """Return φ at times on the facility clock."""
        return self.at(time_s)[0]

    def rates(self, time_s: FloatArray) -> FloatArray:
        """Return dφ/dt in 1/s at times on the facility clock."""
        return self.at(time_s)[1]


@dataclass(frozen=True)
class ChannelSignal:
    """T25 or Nc of one record: level (1 + s sin(2πf_s t + p_s) + c sin(θ + p_c))."""

    flow: FlowSignal  # Whose surge angle θ the channel follows
    level: float  # Mean, in the channel's unit
    slow: tuple[float, float, float]  # s, f_s in Hz, p_s in rad, on the facility clock
    cyclic: tuple[float, float]  # c, p_c in rad

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the channel and its rate, per second, at times on the facility clock."""
        angle, speed = self.flow.angle(time_s)
        share, hz, phase = self.slow
        swing, lag = self.cyclic
        inner = 2.0 * pi * hz * time_s + phase
        value = 1.0 + share * np.sin(inner) + swing * np.sin(angle + lag)
        rate = share * 2.0 * pi * hz * np.cos(inner) + swing * speed * np.cos(angle + lag)
        return np.asarray(self.level * value), np.asarray(self.level * rate)


@dataclass(frozen=True)
class Plant:
    """Truth of one test without any effect: τ dψ'/dt + ψ' = Σ βᵢ φⁱ over several records."""

    flows: tuple[FlowSignal, ...]
    temperatures: tuple[ChannelSignal, ...]  # T25 in kelvin of each record
    speeds: tuple[ChannelSignal, ...]  # Nc as a fraction
    duration_s: float  # Of each record
    sample_period_s: float
    tau_s: float
    beta: tuple[float, ...]
    stall_phi: float  # φ below which the machine is in stall

    def quasi_steady(self, phi: FloatArray) -> FloatArray:
        """Return ψ'_QS(φ)."""
        return np.asarray(np.polynomial.polynomial.polyval(phi, np.array(self.beta)))

    @cached_property
    def _clock_s(self) -> FloatArray:
        return np.linspace(0.0, self.duration_s, _QUANTILE_POINTS)

    @cached_property
    def all_phi(self) -> FloatArray:
        """φ of all records, sorted: its quantiles place thresholds."""
        return np.sort(np.concatenate([f.values(f.origin_s + self._clock_s) for f in self.flows]))

    def phi_at(self, share: float) -> float:
        """Return the φ below which this share of the time is spent."""
        return float(np.quantile(self.all_phi, share))

    @cached_property
    def psi_std(self) -> float:
        """Standard deviation of ψ'_QS over all records: the scale of what an effect may do."""
        return float(np.std(self.quasi_steady(self.all_phi)))

    @cached_property
    def psi_mean(self) -> float:
        """Mean of ψ'_QS over all records."""
        return float(np.mean(self.quasi_steady(self.all_phi)))

    @cached_property
    def mean_speed(self) -> float:
        """Mean Nc over all records: the reference of the droop."""
        return float(np.mean([s.at(s.flow.origin_s + self._clock_s)[0] for s in self.speeds]))

    @cached_property
    def amplitudes(self) -> tuple[CubicSpline, ...]:
        """A(t) of every record, from where its integration starts."""
        first = LEAD_TIME_CONSTANTS * self.tau_s
        return tuple(
            _slow_amplitude(f, f.origin_s - first, f.origin_s + self.duration_s) for f in self.flows
        )

    @cached_property
    def mean_amplitude(self) -> float:
        """Ā, the mean of A over the records."""
        pairs = zip(self.amplitudes, self.flows, strict=True)
        return float(np.mean([a(f.origin_s + self._clock_s) for a, f in pairs]))


@dataclass(frozen=True)
class Points:
    """Instants of one record, and what its flow does there.

    They are n samples, or in rows of m the starts, middles and ends of steps of integration, none
    of which holds the beginning of a branch.
    """

    plant: Plant
    record: int  # From 0
    time_s: FloatArray
    phi: FloatArray  # In the shape of the instants
    phi_rate: FloatArray  # dφ/dt in 1/s at the samples, or at the middles of the steps

    @property
    def branch_phi(self) -> FloatArray:
        """φ by which a branch is chosen: one for the whole of a step."""
        return self.phi[1] if self.phi.ndim == 2 else self.phi


def draw_plant(
    rng: np.random.Generator,
    *,
    n_records: int,
    duration_s: float,
    sample_period_s: float,
    degree: int,
) -> Plant:
    """Draw a compressor and the records of its test.

    Of degree 3 the characteristic is ψ'₀ + H (1 + 3/2 (φ/W − 1) − 1/2 (φ/W − 1)³), Moore & Greitzer
    (1986); of degree 2 it is a parabola over the same flows.
    """
    tau = float(np.exp(rng.uniform(*np.log(_TAU_S))))
    base, height, width = rng.uniform(0.2, 0.4), rng.uniform(0.12, 0.20), rng.uniform(0.21, 0.26)
    powers = np.polynomial.Polynomial([-1.0, 1.0 / width])
    if degree == 3:
        curve = base + height * (1.0 + 1.5 * powers - 0.5 * powers**3)
    else:
        # Its top at 1.5 W, as high as the cubic's.
        curve = base + 2.0 * height - 0.9 * height * (powers - 0.5) ** 2
    origins = np.asarray(_RECORD_SPACING * duration_s * np.arange(n_records), dtype=np.float64)
    flows = _draw_flows(rng, origins)
    temperature_k, speed = rng.uniform(255.0, 300.0), rng.uniform(0.90, 1.0)
    slow_k = (rng.uniform(0.01, 0.02), rng.uniform(0.02, 0.06), rng.uniform(-pi, pi))
    slow_n = (rng.uniform(0.006, 0.012), rng.uniform(0.015, 0.05), rng.uniform(-pi, pi))
    cyclic_k = (rng.uniform(0.004, 0.010), rng.uniform(-pi, pi))
    cyclic_n = (rng.uniform(0.002, 0.005), rng.uniform(-pi, pi))
    return Plant(
        flows=flows,
        temperatures=tuple(ChannelSignal(f, temperature_k, slow_k, cyclic_k) for f in flows),
        speeds=tuple(ChannelSignal(f, speed, slow_n, cyclic_n) for f in flows),
        duration_s=duration_s,
        sample_period_s=sample_period_s,
        tau_s=tau,
        beta=tuple(float(b) for b in curve.convert().coef),
        stall_phi=float(rng.uniform(0.75, 1.15) * width),
    )


def _draw_flows(rng: np.random.Generator, origins_s: FloatArray) -> tuple[FlowSignal, ...]:
    """Draw the flow of each record, begun at these times on the facility clock, in seconds.

    No two surge at the same frequency, amplitude and mean flow.
    """
    n = origins_s.size
    low, high = _SURGE_HZ
    # One frequency out of each of n equal parts of the range, in any order.
    shares = (rng.permutation(n) + rng.uniform(0.1, 0.9, n)) / n
    sizes = np.array([1.0, rng.uniform(0.12, 0.25), rng.uniform(0.03, 0.08)])
    lags = rng.uniform(-pi, pi, 3)
    tone = np.full(_BROADBAND_TONES, np.sqrt(2.0 / _BROADBAND_TONES))
    flows = []
    for origin, share in zip(origins_s, shares, strict=True):
        amplitude = rng.uniform(0.20, 0.28)
        # A relaxation wave keeps its shape from record to record but for a little.
        harmonics = np.column_stack((sizes, lags + rng.uniform(-0.2, 0.2, 3)))
        modulation = rng.uniform(0.12, 0.22)
        wander = rng.uniform(0.2, 0.5)
        size = tone * (amplitude * _BROADBAND)
        tone_hz = rng.uniform(0.2, _BROADBAND_HZ, _BROADBAND_TONES)
        tones = np.column_stack((size, tone_hz, rng.uniform(-pi, pi, _BROADBAND_TONES)))
        flows.append(
            FlowSignal(
                origin_s=float(origin),
                surge_hz=float(low + share * (high - low)),
                mean=rng.uniform(0.17, 0.25),
                amplitude=amplitude,
                phase=rng.uniform(-pi, pi),
                modulation=(modulation, rng.uniform(0.04, 0.09), rng.uniform(-pi, pi)),
                wander=(wander, rng.uniform(0.03, 0.08), rng.uniform(-pi, pi)),
                harmonics=harmonics,
                tones=tones,
            )
        )
    return tuple(flows)


def _slow_amplitude(flow: FlowSignal, first_s: float, last_s: float) -> CubicSpline:
    """Return the amplitude A(t) of surge over an interval of the facility clock.

    It is the modulus of φ's analytic signal, low-passed without lag at a quarter of the surge
    frequency. φ is known before and after the interval, so that neither the analytic signal nor the
    filter feels an edge; from the record alone this can only be approached.
    """
    lead_s = _AMPLITUDE_LEAD_CYCLES / flow.surge_hz
    rate_hz = _POINTS_PER_CYCLE * flow.surge_hz
    n = next_fast_len(int(np.ceil((last_s - first_s + 2.0 * lead_s) * rate_hz)) + 1)
    time_s = first_s - lead_s + np.arange(n) / rate_hz
    modulus = np.abs(hilbert(flow.values(time_s) - flow.mean))
    low_pass = butter(4, _AMPLITUDE_BAND * flow.surge_hz, fs=rate_hz, output="sos")
    return CubicSpline(time_s, sosfiltfilt(low_pass, modulus))
