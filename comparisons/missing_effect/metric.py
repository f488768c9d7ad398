"""The metric of a fit: how errors are whitened and weighted, and which rows count."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.kernels import flow_noise_whiten, whiten
from comparisons.missing_effect.lag_data import LagData
from surge_core.types import FloatArray

Index = NDArray[np.int64]


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

    def on(self, rows: Index) -> FlowNoise:
        """Return the same for some of the rows."""
        return replace(self, slope=self.slope[rows])

    def whitened(
        self, columns: FloatArray, weight: FloatArray, runs: Index
    ) -> tuple[FloatArray, float]:
        """Return columns as innovations of unit variance, and half the logarithm of the rest."""
        out, half_log = flow_noise_whiten(
            np.ascontiguousarray(columns),
            self.a,
            self.now,
            self.before,
            np.ascontiguousarray(self.slope),
            self.ratio,
            weight,
            runs,
        )
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
        return Metric(
            self.sigma,
            self.ar,
            None if self.weight is None else self.weight[rows],
            None if self.flow is None else self.flow.on(rows),
        )

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
