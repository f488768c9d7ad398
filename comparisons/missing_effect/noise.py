"""What the errors of the best model look like: colour, tails, size; and the metric they ask for."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.autoregression import autoregression
from comparisons.missing_effect.kernels import flow_noise_whiten, whiten
from comparisons.missing_effect.lag_data import LagData
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray

# Noise on φ is believed only when it beats every autoregression by this much.
FLOW_RELUCTANCE = 5.0
# Huber's bound: beyond so many standard deviations an error counts in proportion, not in square.
HUBER = 3.0
# Share of errors beyond Huber's bound from which on the tails are called heavy (normal: 0.27 %).
HEAVY_SHARE = 0.006
Index = NDArray[np.int64]


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

    def noise_at(log_ratio: float) -> FlowNoise:
        return FlowNoise(lag.a, lag.gain_now, lag.gain_before, slope, float(np.exp(log_ratio)))

    def cost(log_ratio: float) -> tuple[float, float]:
        white, half_log = noise_at(log_ratio).whitened(column, weight, data.runs)
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
    flow, innovation = noise_at(found.x), float(np.sqrt(variance))
    step = 0.3
    bend = (cost(found.x + step)[0] - 2.0 * value + cost(found.x - step)[0]) / step**2
    stderr = 0.5 * float(np.sqrt(variance * np.exp(found.x) / max(bend, 1e-6)))
    noisy = NoiseModel(plain.sigma, innovation, (), plain.heavy_share, flow, gain, stderr)
    # Colour that is another's is not put on a φ whose own readings are steadier: 0.0017 and 0.0053
    # were read where φ had none.
    held = white_part(data.sampled(data["phi"]))
    return noisy if noisy.flow_sigma - 3.0 * stderr <= held else plain


def white_part(values: FloatArray) -> float:
    """Return the largest deviation that white noise on a signal can have, by fourth differences."""
    # Their variance is 70 times that of the noise.
    return 1.4826 * float(np.median(np.abs(np.diff(values, 4)))) / float(np.sqrt(70.0))


def weights_of(errors: FloatArray, noise: NoiseModel, data: LagData) -> FloatArray | None:
    """Return the factors that let large errors count in proportion; None where none are needed."""
    if not noise.heavy_tailed:
        return None
    z = np.abs(noise.metric().whitened(errors, data))
    # Huber's ψ function at 1.345 keeps 95 % of the efficiency on normal errors.
    return np.sqrt(np.minimum(1.0, 1.345 / np.maximum(z, 1e-12)))


def _scale(errors: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(errors - np.median(errors)))) if errors.size else 1.0


@dataclass(frozen=True)
class FlowNoise:
    """White noise on φ, as the discrete lag (a, now, before) passes it on into the errors.

    ``slope`` is that of the characteristic at each sample, ``ratio`` the variance of the noise on φ
    over that of the noise on the coefficient.
    """

    a: float
    now: float
    before: float
    slope: FloatArray
    ratio: float

    def whitened(
        self, columns: FloatArray, weight: FloatArray, runs: Index
    ) -> tuple[FloatArray, float]:
        """Return columns as innovations of unit variance, and half the logarithm of the rest."""
        columns, slope = map(np.ascontiguousarray, (columns, self.slope))
        lag = self.a, self.now, self.before
        out, half_log = flow_noise_whiten(columns, *lag, slope, self.ratio, weight, runs)
        return out, float(half_log)


@dataclass(frozen=True)
class Metric:
    """Errors e become w (e - Σ a_i e[k-i]) / σ: white, of unit variance, outliers held down.

    The autoregression is empty for white noise and for noise on φ; ``weight`` is a factor of each
    row beside that of the data.
    """

    sigma: float = 1.0
    ar: FloatArray = field(default_factory=lambda: np.zeros(0))
    weight: FloatArray | None = None
    flow: FlowNoise | None = None

    def on(self, rows: Index) -> Metric:
        """Return the metric of some of the rows."""
        weight = None if self.weight is None else self.weight[rows]
        flow = self.flow and replace(self.flow, slope=self.flow.slope[rows])
        return replace(self, weight=weight, flow=flow)

    def rows(self, data: LagData) -> FloatArray:
        """Return the factor of each sample: 0 where it or one before it is not scored."""
        factor = data.weight if self.weight is None else data.weight * self.weight
        if self.ar.size == 0:
            return np.ascontiguousarray(factor)
        known = np.ones(factor.size)
        for run in data.slices:
            weight = data.weight[run]
            for back in range(1, self.ar.size + 1):
                known[run.start + back : run.stop] *= weight[:-back] > 0.0
        return factor * known

    def whitened(self, columns: FloatArray, data: LagData) -> FloatArray:
        """Return columns in this metric, without their starts taken off; zero where not scored."""
        values = columns if columns.ndim == 2 else columns[:, None]
        factor = self.rows(data) / self.sigma
        if self.flow is not None:
            out = self.flow.whitened(values, factor, data.runs)[0]
        elif self.ar.size == 0:
            out = values * factor[:, None]
        else:
            out = whiten(np.ascontiguousarray(values), self.ar, factor, data.runs)
        return out if columns.ndim == 2 else out[:, 0]

    def seen(self, columns: FloatArray, decay: FloatArray, data: LagData) -> FloatArray:
        """Return columns in this metric, with the unknown start of each run projected out.

        ``decay`` is what a start that is off by one leaves at each sample.
        """
        return projected(self.whitened(columns, data), self.whitened(decay, data), data)


def projected(columns: FloatArray, decay: FloatArray, data: LagData) -> FloatArray:
    """Return columns with the decay of each run projected out."""
    out = columns.copy()
    for run in data.slices:
        d = decay[run]
        norm = float(d @ d)
        if norm > 1e-12:
            out[run] -= np.multiply.outer(d, (d @ columns[run]) / norm)
    return out
