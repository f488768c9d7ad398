"""The compressor of a test at the level of coefficients, and its state at instants of a record."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np
from scipy.interpolate import CubicSpline

from comparisons.rig.coefficient_signals import (
    ChannelSignal,
    FlowSignal,
    draw_flows,
    slow_amplitude,
)
from surge_core.types import FloatArray

# What is left at the start of a record of the state it was begun from: exp(-12).
LEAD_TIME_CONSTANTS = 12.0
# Facility clock from one record's start to the next, in durations: a third of the clock is pause.
_RECORD_SPACING = 1.5
# Range of the time constant.
_TAU_S = (0.06, 0.20)
_QUANTILE_POINTS = 2000


@dataclass(frozen=True)
class Plant:
    """Truth of one test without any effect: τ dψ'/dt + ψ' = Σ βᵢ φⁱ over several records.

    Parameters
    ----------
    flows : tuple of FlowSignal
        φ(t) of each record.
    temperatures, speeds : tuple of ChannelSignal
        T25 in kelvin and Nc as a fraction, of each record.
    duration_s, sample_period_s : float
        Length of each record, and time between two samples, in seconds.
    tau_s : float
        Time constant τ, in seconds.
    beta : tuple of float
        Coefficients of ψ'_QS in plain powers of φ.
    stall_phi : float
        φ below which the machine is in stall.
    """

    flows: tuple[FlowSignal, ...]
    temperatures: tuple[ChannelSignal, ...]
    speeds: tuple[ChannelSignal, ...]
    duration_s: float
    sample_period_s: float
    tau_s: float
    beta: tuple[float, ...]
    stall_phi: float

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
        return float(np.mean([s.values(s.flow.origin_s + self._clock_s) for s in self.speeds]))

    @cached_property
    def amplitudes(self) -> tuple[CubicSpline, ...]:
        """A(t) of every record, from where its integration starts."""
        first = LEAD_TIME_CONSTANTS * self.tau_s
        return tuple(
            slow_amplitude(f, f.origin_s - first, f.origin_s + self.duration_s) for f in self.flows
        )

    @cached_property
    def mean_amplitude(self) -> float:
        """Ā, the mean of A over the records."""
        pairs = zip(self.amplitudes, self.flows, strict=True)
        return float(np.mean([a(f.origin_s + self._clock_s) for a, f in pairs]))


@dataclass(frozen=True)
class Points:
    """Instants of one record, and what its flow does there.

    Parameters
    ----------
    plant : Plant
        The test.
    record : int
        Number of the record, from 0.
    time_s : ndarray of shape (n,) or (3, m)
        The instants: samples, or the starts, middles and ends of m steps of integration, none of
        which holds the beginning of a branch.
    phi : ndarray
        φ there, in the shape of `time_s`.
    phi_rate : ndarray of shape (n,) or (m,)
        dφ/dt in 1/s at the samples, or at the middles of the steps.
    """

    plant: Plant
    record: int
    time_s: FloatArray
    phi: FloatArray
    phi_rate: FloatArray

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

    Parameters
    ----------
    rng : Generator
        Source of the draw.
    n_records : int
        Number of records.
    duration_s, sample_period_s : float
        Length of each, and time between two samples, in seconds.
    degree : int
        3: the cubic of Moore and Greitzer; 2: a parabola over the same flows.

    Notes
    -----
    ψ'_QS = ψ'₀ + H (1 + 3/2 (φ/W − 1) − 1/2 (φ/W − 1)³), Moore & Greitzer (1986).
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
    flows = draw_flows(rng, origins)
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
