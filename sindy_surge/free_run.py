"""Free run of the lag through every segment, with a dead time of either sign."""

from __future__ import annotations

import numpy as np

from sindy_surge.segments import Segments
from surge_core.lag import FirstOrderLag
from surge_core.types import FloatArray, IndexArray

__all__ = ["driven", "run_lag", "simulate", "solve_recursion"]


def driven(lag: FirstOrderLag, values: FloatArray, rows: IndexArray, by: int = 0) -> FloatArray:
    """Return Σ_i taps[by, i] values[row - m - i] for rows of the record.

    Parameters
    ----------
    values : ndarray of shape (n_rows,) or (n_rows, n_columns)
        Forcing at the samples.
    rows : ndarray of int
        Rows whose inputs, the dead time of m samples and a fraction earlier, are in the record.
    by : {0, 1, 2}
        The drive itself, or its derivative with respect to log τ or to the dead time in samples.
    """
    at = rows - lag.whole_samples
    taps = lag.taps[by]
    result: FloatArray = taps[0] * values[at] + taps[1] * values[at - 1]
    return result + taps[2] * values[at - 2] if taps[2] else result


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
    """Run the lag without dead time over its forcing; see `run_lag`."""
    drive = lag.gain_now * forcing
    drive[1:] += lag.gain_before * forcing[:-1]
    return run_lag(drive, segments, lag.a, initial)


def solve_recursion(
    ahead: FloatArray, behind: FloatArray, target: FloatArray, segments: Segments
) -> FloatArray:
    """Solve ahead[k] x[k] - behind[k] x[k-1] = target[k]; each segment's first x is its target.

    Parameters
    ----------
    ahead, behind : ndarray of shape (n_equations,)
        At the rows `segments.later`.
    target : ndarray of shape (n_rows,)
    """
    from scipy.linalg import solve_banded

    band = np.zeros((2, target.size))
    band[0] = 1.0
    band[0, segments.later] = ahead
    band[1, segments.later - 1] = -behind
    return np.asarray(solve_banded((1, 0), band, target))
