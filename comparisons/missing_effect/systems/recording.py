"""A filter through which all channels were recorded alike: an all-pass of second order.

Inputs and outputs that went through the same anti-alias filter look right to any linear model,
whose filter cancels. A nonlinear model does not commute with it: harmonics come late. What was
recorded is F u and F y, so the system is driven by F⁻¹ of the input and F is laid over its answer.
F(s) = (1 − α s + β s²) / (1 + α s + β s²), s in radians a sample; a common delay cannot be seen.
"""

from __future__ import annotations

import numpy as np

from surge_core.types import FloatArray

# Rows by which a record is prolonged, point-symmetric about its ends, before it is transformed.
PADDING = 400
LEAST_BRIDGE = 100


def all_pass(values: FloatArray, alpha: float, beta: float, *, inverse: bool = False) -> FloatArray:
    """Return channels behind the all-pass, or before it.

    Parameters
    ----------
    values : ndarray of shape (n, ...)
        Channels along the first axis.
    alpha, beta : float
        Coefficients, per sample; α = 0 leaves everything as it is.
    inverse : bool
        Undo the filter instead.
    """
    if alpha == 0.0:
        return values
    from scipy.fft import irfft, next_fast_len, rfft

    n = values.shape[0]
    pad = min(PADDING, n - 1)
    before = 2.0 * values[:1] - values[pad:0:-1]
    after = 2.0 * values[-1:] - values[-2 : -pad - 2 : -1]
    joined = np.concatenate([before, values, after])
    size = next_fast_len(joined.shape[0] + LEAST_BRIDGE, real=True)
    # The gap to the next fast length is bridged, so that the ends do not meet with a step.
    bridge = np.linspace(0.0, 1.0, size - joined.shape[0] + 2)[1:-1]
    bridge = bridge.reshape(-1, *(1,) * (values.ndim - 1))
    joined = np.concatenate([joined, joined[-1:] * (1.0 - bridge) + joined[:1] * bridge])
    omega = 2.0 * np.pi * np.arange(size // 2 + 1) / size
    phase = -2.0 * np.arctan2(alpha * omega, 1.0 - beta * omega**2)
    turn = np.exp((-1j if inverse else 1j) * phase).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(irfft(rfft(joined, axis=0) * turn, n=size, axis=0)[pad : pad + n])
