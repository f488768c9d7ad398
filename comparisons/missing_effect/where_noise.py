"""The floor's noise as a law: what a sum or a power of it may be by chance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray, IntArray

__all__ = [
    "FloorNoise",
    "SlowPart",
    "floor_noise",
    "held_back",
    "power_bound",
    "power_z",
    "tolerant",
]

# The floor's power is itself an estimate, and so is the shape of an autoregression's spectrum.
FLOOR_UNCERTAINTY = 0.05
OUTLIER_SCALES = 4.0
# A normal variable lies within 0.6745 of its standard deviation half of the time.
MAD_TO_SIGMA = 1.4826
MEMORY_LEFT = 1e-4
LONGEST_MEMORY = 10_000
NEAREST_POLE = 0.999


@dataclass(frozen=True)
class FloorNoise:
    """Stationary noise, white or of an autoregression, over rows that come in runs.

    Parameters
    ----------
    coefficients : ndarray of shape (p,)
        e[k] = Σ aᵢ e[k−i] + u[k].
    innovation_rms : float
        rms of the white u.
    effective_share : float
        Independent rows in the mean of many over one row, γ₀/Σγ.
    memory : int
        Rows after which an innovation is forgotten.
    place : ndarray of int, shape (n,)
        Where each row stands once the memory's length is left free before each run; −1 for
        rows in no run.
    """

    coefficients: FloatArray
    innovation_rms: float
    effective_share: float
    memory: int
    place: IntArray

    def innovations(self, values: FloatArray, known: BoolArray) -> tuple[FloatArray, BoolArray]:
        """Return what the autoregression leaves, and the rows where all that it needs is known.

        Parameters
        ----------
        values : ndarray of shape (n,)
            The signal.
        known : ndarray of bool, shape (n,)
            Rows in which it is known.
        """
        left, whole = values.copy(), known.copy()
        for lag, coefficient in enumerate(self.coefficients.tolist(), start=1):
            left[lag:] -= coefficient * values[:-lag]
            whole[lag:] &= known[:-lag] & (self.place[lag:] - self.place[:-lag] == lag)
            whole[:lag] = False
        return np.where(whole, left, 0.0), whole

    def sum_variance(self, weights: FloatArray) -> float:
        """Return the variance of Σ w e, wᵀ Γ w, as the power of w run backwards through 1/A.

        Parameters
        ----------
        weights : ndarray of shape (n,)
            Weights, 0 outside the runs.
        """
        if self.coefficients.size == 0:
            return self.innovation_rms**2 * float(weights @ weights)
        from scipy.signal import lfilter

        used = np.flatnonzero(weights)
        if used.size == 0:
            return 0.0
        place = self.place[used]
        spread = np.zeros(int(place[-1] - place[0]) + 1 + self.memory)
        spread[place[-1] - place] = weights[used]
        filtered = np.asarray(lfilter([1.0], np.r_[1.0, -self.coefficients], spread))
        return self.innovation_rms**2 * float(filtered @ filtered)


def floor_noise(
    rms: float, whitening: ArrayLike | None, runs: tuple[slice, ...], n_rows: int
) -> FloorNoise:
    """Return the law of the floor's noise.

    Parameters
    ----------
    rms : float
        Its rms.
    whitening : array-like of shape (p,), optional
        Coefficients of the autoregression; white without.
    runs : tuple of slice
        Runs, in order.
    n_rows : int
        Rows of the data.

    Raises
    ------
    InputError
        When the autoregression is not stationary.
    """
    coefficients = np.zeros(0) if whitening is None else np.asarray(whitening, dtype=np.float64)
    if coefficients.ndim != 1 or not np.all(np.isfinite(coefficients)):
        raise InputError(
            "whitening",
            expected="one finite coefficient a lag",
            found=f"shape {coefficients.shape}"
            if coefficients.ndim != 1
            else "a value that is not finite",
        )
    response = np.ones(1)
    if np.any(coefficients):
        from scipy.signal import lfilter

        pole = float(np.max(np.abs(np.roots(np.r_[1.0, -coefficients]))))
        if pole > NEAREST_POLE:
            raise InputError(
                "whitening",
                expected=f"a stationary autoregression (poles within {NEAREST_POLE:g})",
                found=f"a pole at {pole:.4g}",
                remedy="fit it again to a residual without drift",
            )
        impulse = np.zeros(LONGEST_MEMORY)
        impulse[0] = 1.0
        response = np.asarray(lfilter([1.0], np.r_[1.0, -coefficients], impulse))
        kept = np.flatnonzero(np.abs(response) > MEMORY_LEFT * np.max(np.abs(response)))
        response = response[: int(kept[-1]) + 1]
    power = float(response @ response)
    place = np.full(n_rows, -1, dtype=np.int64)
    for number, run in enumerate(runs):
        place[run] = np.arange(run.start, run.stop) + (number + 1) * response.size
    return FloorNoise(
        coefficients if np.any(coefficients) else np.zeros(0),
        rms / math.sqrt(power),
        power / max(float(np.sum(response)) ** 2, np.finfo(np.float64).tiny),
        response.size,
        place,
    )


@dataclass(frozen=True)
class SlowPart:
    """What of a signal is slower than its blocks: their means, joined by straight lines.

    Parameters
    ----------
    rows : ndarray of int, shape (m,)
        The scored rows.
    block : ndarray of int, shape (m,)
        Block of each.
    left, right : ndarray of int, shape (m,)
        Blocks between whose centres each row lies, or that it lies beyond.
    share : ndarray of shape (m,)
        Weight of the right one.
    counts : ndarray of shape (n_blocks,)
        Rows of each block.
    """

    rows: IntArray
    block: IntArray
    left: IntArray
    right: IntArray
    share: FloatArray
    counts: FloatArray

    @classmethod
    def over(
        cls, rows: IntArray, block: IntArray, time_s: FloatArray, record_of_block: IntArray
    ) -> SlowPart:
        """Return the operator for rows that are in blocks numbered in the order of time.

        Parameters
        ----------
        rows, block : ndarray of int, shape (m,)
            The scored rows and their blocks.
        time_s : ndarray of shape (m,)
            Clock of these rows.
        record_of_block : ndarray of int, shape (n_blocks,)
            No line joins two records.
        """
        counts = np.bincount(block, minlength=record_of_block.size).astype(np.float64)
        centres = np.bincount(block, time_s, record_of_block.size) / counts
        left, right, share = block.copy(), block.copy(), np.zeros(block.size)
        for record in np.unique(record_of_block).tolist():
            own = np.flatnonzero(record_of_block == record)
            if own.size < 2:
                continue
            mine = np.flatnonzero(record_of_block[block] == record)
            at = np.searchsorted(centres[own], time_s[mine]) - 1
            left[mine] = own[np.clip(at, 0, own.size - 2)]
            right[mine] = left[mine] + 1
            span = centres[right[mine]] - centres[left[mine]]
            share[mine] = (time_s[mine] - centres[left[mine]]) / span
        return cls(rows, block, left, right, share, counts)

    def without(self, values: FloatArray) -> FloatArray:
        """Return a signal without its slow part, 0 in the rows that are not scored."""
        own = values[self.rows]
        means = np.bincount(self.block, own, self.counts.size) / self.counts
        out = np.zeros(values.size)
        slow = means[self.left] * (1.0 - self.share) + means[self.right] * self.share
        out[self.rows] = own - slow
        return out

    def weights(self, weights: FloatArray) -> FloatArray:
        """Return v for which v·e is w·e after the slow part of e is taken out (the adjoint)."""
        own, size = weights[self.rows], self.counts.size
        drawn = np.bincount(self.left, own * (1.0 - self.share), size)
        drawn += np.bincount(self.right, own * self.share, size)
        out = np.zeros(weights.size)
        out[self.rows] = own - (drawn / self.counts)[self.block]
        return out


def held_back(values: FloatArray, known: BoolArray, rms: float) -> FloatArray:
    """Return a signal whose outliers are held at four scales, 0 where it is not known.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The signal.
    known : ndarray of bool, shape (n,)
        Rows in which it is known.
    rms : float
        The noise's; the scale is that or the signal's own (by its median size) if larger, so
        that structure is not taken for outliers.
    """
    own = MAD_TO_SIGMA * float(np.median(np.abs(values[known]))) if known.any() else 0.0
    limit = OUTLIER_SCALES * max(rms, own)
    return np.where(known, np.clip(values, -limit, limit), 0.0)


def power_z(ratio: float, freedom: float) -> float:
    """Return z of a mean power over its expectation, χ²_ν/ν, by Wilson and Hilferty (1931).

    Parameters
    ----------
    ratio : float
        Power over what is expected.
    freedom : float
        Degrees of freedom ν.
    """
    width = 2.0 / (9.0 * freedom)
    return (math.cbrt(max(ratio, 0.0)) - (1.0 - width)) / math.sqrt(width)


def power_bound(z: float, freedom: float) -> float:
    """Return the ratio whose z is the one given.

    Parameters
    ----------
    z : float
        Standard normal quantile.
    freedom : float
        Degrees of freedom ν.
    """
    width = 2.0 / (9.0 * freedom)
    root = max(1.0 - width + z * math.sqrt(width), 0.0)
    return root * root * root


def tolerant(freedom: float) -> float:
    """Return the degrees of freedom of a power over a floor that is known to 5 % only.

    Parameters
    ----------
    freedom : float
        Degrees of freedom over a floor that is known exactly.
    """
    return 1.0 / (1.0 / freedom + 0.5 * FLOOR_UNCERTAINTY**2)
