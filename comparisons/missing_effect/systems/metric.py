"""The metric of a fit: the colour and the size of the errors of each output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from comparisons.missing_effect.autoregression import autoregression
from surge_core.types import FloatArray

__all__ = ["MOST_LAGS", "Metric", "metric_of", "raw_metric"]

MOST_LAGS = 4


@dataclass(frozen=True)
class Metric:
    """In which errors are white and of unit variance.

    Parameters
    ----------
    sigma : tuple of float
        Standard deviation of what is new in an error of each output, in its unit.
    ar : tuple of ndarray
        Autoregression of each output's errors; empty arrays for the raw metric.
    """

    sigma: tuple[float, ...]
    ar: tuple[FloatArray, ...]

    @property
    def lost(self) -> int:
        """Rows at the start of a run that have no whitened error."""
        return max(a.size for a in self.ar)

    def whitened(self, errors: FloatArray) -> FloatArray:
        """Return whitened errors of one run, or columns of a Jacobian.

        Parameters
        ----------
        errors : ndarray of shape (n, n_y) or (n, n_y, c)
            Rows at the start that have no whitened error become zero.
        """
        out = np.empty_like(errors)
        for j, (sigma, ar) in enumerate(zip(self.sigma, self.ar, strict=True)):
            white = errors[:, j].copy()
            for lag, a in enumerate(ar, start=1):
                white[lag:] -= a * errors[:-lag, j]
            out[:, j] = white / sigma
        out[: self.lost] = 0.0
        return out

    def log_likelihood(self, errors: Sequence[FloatArray]) -> float:
        """Return the log-likelihood of errors with the size of each output's at its best."""
        total = 0.0
        for j in range(len(self.sigma)):
            rows = np.concatenate([self.whitened(e)[self.lost :, j] for e in errors])
            mean = float(np.mean(rows**2)) * self.sigma[j] ** 2
            total -= 0.5 * rows.size * float(np.log(max(mean, 1e-300)))
        return total

    def with_size_of(self, errors: Sequence[FloatArray]) -> Metric:
        """Return the metric with the size of each output's errors at its best."""
        sizes = []
        for j, sigma in enumerate(self.sigma):
            rows = np.concatenate([self.whitened(e)[self.lost :, j] for e in errors])
            size = sigma * float(np.sqrt(np.mean(rows**2)))
            sizes.append(size if size > 0.0 else sigma)
        return Metric(tuple(sizes), self.ar)


def raw_metric(outputs: Sequence[FloatArray]) -> Metric:
    """Return the raw metric, each output in units of its own swing.

    Parameters
    ----------
    outputs : sequence of ndarray of shape (n, n_y)
        Measured outputs of the runs.
    """
    swing = np.std(np.concatenate(list(outputs)), axis=0)
    return Metric(tuple(float(s) for s in swing), (np.zeros(0),) * swing.size)


def metric_of(errors: Sequence[FloatArray]) -> Metric:
    """Return the metric in which the errors of a model are white: one autoregression an output.

    Parameters
    ----------
    errors : sequence of ndarray of shape (n, n_y)
        Of the runs.
    """
    n_y = errors[0].shape[1]
    ar = tuple(autoregression([e[:, j] for e in errors], MOST_LAGS) for j in range(n_y))
    return Metric((1.0,) * n_y, ar).with_size_of(errors)
