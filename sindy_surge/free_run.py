"""Free run of the lag through every segment, with a dead time of either sign."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sindy_surge.segments import Segments
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray, IndexArray

__all__ = ["DelayedLag", "run_lag", "simulate"]


# Part of a sample of dead time that is rounding.
_WHOLE = 1e-9


@dataclass(frozen=True)
class DelayedLag:
    """x[k] = pole x[k-1] + Σ_i weights[0, i] f[k - shift - i]: τ x' + x = f(t - d), exactly.

    Parameters
    ----------
    pole : float
        exp(-h/τ).
    pole_slope : float
        Its derivative with respect to τ, in 1/s.
    shift : int
        Whole samples of the dead time; negative if the input comes late.
    weights : ndarray of shape (3, 2) or (3, 3)
        Weights of the input, and their derivatives with respect to τ and to the dead time in 1/s;
        three taps where the dead time may be a fraction of a sample.
    """

    pole: float
    pole_slope: float
    shift: int
    weights: FloatArray

    @classmethod
    def of(cls, lag: FirstOrderLag, fitted: bool = False) -> DelayedLag:
        """Discretise a lag with a dead time of either sign; three taps always where it is fitted.

        A negative dead time d is that of m whole samples ahead and a positive part of one.
        """
        samples = lag.dead_time_s / lag.sample_period_s
        whole = int(np.floor(samples + _WHOLE))
        part = max(samples - whole, 0.0)
        inside = replace(lag, dead_time_s=part * lag.sample_period_s)
        weights = inside.taps / np.array([[1.0], [lag.tau_s], [lag.sample_period_s]])
        taps = 3 if fitted or part > _WHOLE else 2
        slope = lag.d_a / lag.tau_s
        return cls(lag.a, slope, whole, weights[:, :taps])

    def drive(self, values: FloatArray, rows: IndexArray, by: int = 0) -> FloatArray:
        """Return Σ_i weights[by, i] values[row - shift - i] for rows of the record."""
        result: FloatArray = self.weights[by, 0] * values[rows - self.shift]
        for number, weight in enumerate(self.weights[by, 1:], start=1):
            result += weight * values[rows - self.shift - number]
        return result


def run_lag(
    drive: FloatArray, segments: Segments, pole: float, initial: FloatArray | None = None
) -> FloatArray:
    """Run x[k] = pole x[k-1] + drive[k] through every segment from its own initial state.

    Parameters
    ----------
    drive : ndarray of shape (n_rows,) or (n_rows, n_columns)
        Drive of each row; that of a segment's first row is not used.
    segments : Segments
        The runs of rows.
    initial : ndarray of shape (n_segments,) or None
        State at the first row of each segment; None starts every run at zero.
    """
    from scipy.signal import lfilter

    states = drive.copy()
    states[segments.starts] = 0.0
    if initial is not None:
        states[segments.starts] = np.reshape(initial, (-1, *(1,) * (drive.ndim - 1)))
    for rows in segments.slices():
        states[rows] = lfilter([1.0], [1.0, -pole], states[rows], axis=0)
    return states


def simulate(
    forcing: FloatArray, segments: Segments, lag: FirstOrderLag, initial: FloatArray | None = None
) -> FloatArray:
    """Run the lag through every segment from that segment's own initial state.

    Parameters
    ----------
    forcing : ndarray of shape (n_rows,) or (n_rows, n_columns)
        ψ'_QS at the samples, or the basis functions, each run alone.
    segments : Segments
        The runs of rows.
    initial : ndarray of shape (n_segments,) or None
        State at the first row of each segment; None starts every run at zero.
    """
    drive = lag.gain_now * forcing
    drive[1:] += lag.gain_before * forcing[:-1]
    return run_lag(drive, segments, lag.a, initial)
