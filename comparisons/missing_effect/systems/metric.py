"""The metric of a fit: the colour and the size of the errors of each output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from comparisons.missing_effect.autoregression import autoregression
from surge_core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Metric:
    """In which errors are white and of unit variance.

    An error that is not a number marks a row without a reading: it is not scored, and no whitened
    error looks across it, but where the stride is 0: there from reading to reading. Of each output
    sigma is the standard deviation of what is new in an error, in its unit, beside the
    autoregression, which is empty in the raw metric, and its stride in rows.
    """

    sigma: tuple[float, ...]
    ar: tuple[FloatArray, ...]
    strides: tuple[int, ...] = ()

    @property
    def lost(self) -> int:
        """Rows at the start of a run that have no whitened error."""
        strides = self.strides or (1,) * len(self.ar)
        return max((s or 1) * a.size for a, s in zip(self.ar, strides, strict=True))

    def _read(self, there: BoolArray) -> list[tuple[IntArray, BoolArray]]:
        """Return the rows read of each output, and which have the readings before in their rows."""
        out = []
        for own, a, stride in zip(
            there.T, self.ar, self.strides or (1,) * len(self.ar), strict=True
        ):
            rows, k = np.flatnonzero(own), a.size
            known = np.arange(rows.size) >= k
            if k and stride:
                known[k:] &= rows[k:] - rows[:-k] == k * stride
            known[rows < self.lost] = False
            out.append((rows, known))
        return out

    def scored(self, errors: FloatArray) -> BoolArray:
        """Return which whitened errors of one run there are, by its errors or readings."""
        out = np.zeros(errors.shape, dtype=bool)
        for j, (rows, known) in enumerate(self._read(~np.isnan(errors))):
            out[rows[known], j] = True
        return out

    def whitened(self, errors: FloatArray) -> FloatArray:
        """Return whitened errors of one run, (n, n_y), or columns of a Jacobian behind them.

        Where a row has no whitened error it is zero; not a number where a run failed.
        """
        out = np.zeros_like(errors)
        if not errors.size:
            return out
        columns = errors.reshape(*errors.shape[:2], -1)
        read = self._read(np.asarray(np.any(~np.isnan(columns), axis=2)))
        for j, (sigma, ar, (rows, known)) in enumerate(zip(self.sigma, self.ar, read, strict=True)):
            own = errors[rows, j]
            white = own.copy()
            # A run that failed is infinite.
            with np.errstate(invalid="ignore", over="ignore"):
                for lag, a in enumerate(ar, start=1):
                    white[lag:] -= a * own[:-lag]
            out[rows[known], j] = white[known] / sigma
        out[~np.isfinite(out)] = np.nan
        return out

    def log_likelihood(self, errors: Sequence[FloatArray], *, known: bool = False) -> float:
        """Return the log-likelihood of errors with the size of each output's at its best.

        Where the sizes are ``known``, none is larger than the metric says.
        """
        total = 0.0
        for sigma, rows in zip(self.sigma, self._rows(errors), strict=True):
            mean = float(np.sum(rows**2)) / max(rows.size, 1)
            beyond = max(mean - 1.0, 0.0) if known else 0.0
            total -= (
                0.5 * rows.size * float(np.log(max((mean - beyond) * sigma**2, 1e-300)) + beyond)
            )
        return total

    def with_size_of(self, errors: Sequence[FloatArray]) -> Metric:
        """Return the metric with the size of each output's errors at its best."""
        sizes = []
        for sigma, rows in zip(self.sigma, self._rows(errors), strict=True):
            size = sigma * float(np.sqrt(np.sum(rows**2) / max(rows.size, 1)))
            sizes.append(size if size > 0.0 else sigma)
        return replace(self, sigma=tuple(sizes))

    def _rows(self, errors: Sequence[FloatArray]) -> list[FloatArray]:
        """Return all whitened errors that there are, one array an output."""
        white, scored = [self.whitened(e) for e in errors], [self.scored(e) for e in errors]
        return [
            np.concatenate([w[s[:, j], j] for w, s in zip(white, scored, strict=True)])
            for j in range(len(self.sigma))
        ]


def correlations(errors: FloatArray) -> FloatArray:
    """Return the autocorrelation of each column of errors about its mean, from no lag on."""
    known = np.isfinite(errors)
    mean = np.sum(errors, axis=0, where=known) / np.maximum(known.sum(axis=0), 1)
    columns = np.where(known, errors - mean, 0.0)
    n = columns.shape[0]
    power = np.abs(np.fft.rfft(columns, 2 * n, axis=0)) ** 2
    size = np.maximum(np.sum(columns**2, axis=0), 1e-300)
    return np.asarray(np.fft.irfft(power, 2 * n, axis=0)[:n] / size)


def raw_metric(outputs: Sequence[FloatArray]) -> Metric:
    """Return the raw metric, each output in units of its own swing."""
    swing = np.nanstd(np.concatenate(list(outputs)), axis=0)
    return Metric(tuple(float(s) for s in swing), (np.zeros(0),) * swing.size)


def metric_of(errors: Sequence[FloatArray]) -> Metric:
    """Return the metric in which the errors of a model are white: one autoregression an output."""
    outputs = range(errors[0].shape[1])
    strides, ar = zip(*(autoregression([e[:, j] for e in errors]) for j in outputs), strict=True)
    return Metric((1.0,) * len(ar), ar, strides).with_size_of(errors)
