"""What the errors of the best model look like: colour, tails, size; and the metric they ask for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.autoregression import autoregression
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.metric import FlowNoise, Metric
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray

# Noise on φ is believed only when it beats every autoregression by this much.
FLOW_RELUCTANCE = 5.0
# Huber's bound: beyond so many standard deviations an error counts in proportion, not in square.
HUBER = 3.0
# Share of errors beyond Huber's bound from which on the tails are called heavy (normal: 0.27 %).
HEAVY_SHARE = 0.006


@dataclass(frozen=True)
class NoiseModel:
    """Noise of the measured coefficient, as the errors of a model show it.

    ``sigma`` is the deviation of one error, ``innovation`` that of what is new in it; ``ar`` is
    empty where the errors are white; ``heavy_share`` lies beyond three robust deviations. Noise on
    φ is there where it describes the errors better than an autoregression, by so many log-units;
    its error is that of the curvature of the likelihood.
    """

    sigma: float
    innovation: float
    ar: tuple[float, ...]
    heavy_share: float
    flow: FlowNoise | None = None
    flow_gain: float = 0.0
    flow_stderr: float = 0.0

    @property
    def coloured(self) -> bool:
        """Whether the errors depend on each other."""
        return bool(self.ar) or self.flow is not None

    @property
    def flow_sigma(self) -> float:
        """Standard deviation of the noise on φ; 0 where none is seen."""
        return 0.0 if self.flow is None else self.innovation * float(np.sqrt(self.flow.ratio))

    @property
    def heavy_tailed(self) -> bool:
        """Whether more errors are large than the normal law has."""
        return self.heavy_share > HEAVY_SHARE

    def metric(self, weight: FloatArray | None = None) -> Metric:
        """Return the metric in which errors of this noise are white and of unit variance."""
        return Metric(self.innovation, np.array(self.ar), weight, self.flow)


def noise_of(
    errors: FloatArray,
    scored: NDArray[np.bool_],
    data: LagData,
    slope: FloatArray | None = None,
    tau_s: float = 0.0,
) -> NoiseModel:
    """Describe the noise by the errors of a model: measured minus simulated, starts taken off.

    Noise on φ is looked for where the slope of the characteristic at each sample is given.
    """
    rows = scored & (data.weight > 0.0)
    robust = _scale(errors[rows])
    bounded = np.clip(errors, -HUBER * robust, HUBER * robust)
    there = np.where(rows, bounded, np.nan)
    _, ar = autoregression([there[run] for run in data.slices])
    metric = Metric(1.0, ar)
    white = metric.whitened(errors, data)
    valid = rows & (metric.rows(data) > 0.0)
    innovation = _scale(white[valid])
    heavy = float(np.mean(np.abs(white[valid]) > HUBER * innovation))
    if heavy <= HEAVY_SHARE:
        innovation = float(np.sqrt(np.mean(white[valid] ** 2)))
        robust = float(np.sqrt(np.mean(errors[rows] ** 2)))
    plain = NoiseModel(robust, innovation, tuple(ar.tolist()), heavy)
    if slope is None or heavy > HEAVY_SHARE:
        return plain
    return _with_flow_noise(plain, errors, rows, data, slope, tau_s)


def _with_flow_noise(
    plain: NoiseModel,
    errors: FloatArray,
    rows: NDArray[np.bool_],
    data: LagData,
    slope: FloatArray,
    tau_s: float,
) -> NoiseModel:
    """Return noise on φ beside white noise where it beats the autoregression by BIC."""
    from scipy.optimize import minimize_scalar

    lag = FirstOrderLag(tau_s, data.sample_period_s, "first")
    weight = np.ascontiguousarray(rows.astype(np.float64))
    n = int(np.count_nonzero(rows))
    column = np.ascontiguousarray(errors[:, None])

    def cost(log_ratio: float) -> tuple[float, float]:
        noise = FlowNoise(lag.a, lag.gain_now, lag.gain_before, slope, float(np.exp(log_ratio)))
        white, half_log = noise.whitened(column, weight, data.runs)
        variance = float(np.sum(white**2)) / n
        return 0.5 * n * float(np.log(variance)) + half_log, variance

    # What noise on φ adds is the slope times the lag's share: from a hundredth of the noise on
    # the coefficient to a hundred times it.
    scale = -2.0 * float(np.log(max(np.sqrt(np.mean(slope**2)) * np.sqrt(1.0 - lag.a), 1e-12)))
    grid = scale + 2.0 * np.log(10.0) * np.linspace(-2.0, 2.0, 9)
    best = grid[int(np.argmin([cost(at)[0] for at in grid]))]
    found = minimize_scalar(
        lambda at: cost(at)[0],
        bounds=(best - 1.2, best + 1.2),
        method="bounded",
        options={"xatol": 0.02},
    )
    value, variance = cost(float(found.x))
    price = 0.5 * float(np.log(n))
    metric = Metric(1.0, np.array(plain.ar))
    white = metric.whitened(errors, data)[rows & (metric.rows(data) > 0.0)]
    rival = 0.5 * n * float(np.log(np.mean(white**2))) + price * len(plain.ar)
    gain = rival - value - price
    if gain < FLOW_RELUCTANCE:
        return plain
    flow = FlowNoise(lag.a, lag.gain_now, lag.gain_before, slope, float(np.exp(found.x)))
    step = 0.3
    bend = (cost(found.x + step)[0] - 2.0 * value + cost(found.x - step)[0]) / step**2
    stderr = 0.5 * float(np.sqrt(variance * np.exp(found.x) / max(bend, 1e-6)))
    return NoiseModel(
        plain.sigma, float(np.sqrt(variance)), (), plain.heavy_share, flow, gain, stderr
    )


def weights_of(errors: FloatArray, noise: NoiseModel, data: LagData) -> FloatArray | None:
    """Return the factors that let large errors count in proportion; None where none are needed."""
    if not noise.heavy_tailed:
        return None
    z = np.abs(noise.metric().whitened(errors, data))
    # Huber's ψ function at 1.345 keeps 95 % of the efficiency on normal errors.
    return np.sqrt(np.minimum(1.0, 1.345 / np.maximum(z, 1e-12)))


def _scale(errors: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(errors - np.median(errors)))) if errors.size else 1.0
