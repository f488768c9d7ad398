"""Exact discrete free run of the first-order lag, segment by segment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sindy_surge.errors import InputError

__all__ = ["Hold", "HoldCoefficients", "Segments", "hold_coefficients", "simulate"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
Hold = Literal["first", "zero"]


@dataclass(frozen=True)
class Segments:
    """Contiguous runs of rows, between which no equation is formed.

    Parameters
    ----------
    starts : ndarray of shape (n_segments,)
        First row of each segment.
    stops : ndarray of shape (n_segments,)
        One past the last row of each segment.
    """

    starts: IntArray
    stops: IntArray

    @classmethod
    def from_labels(cls, labels: ArrayLike | None, n_rows: int) -> Segments:
        """Cut the rows wherever the label changes.

        Parameters
        ----------
        labels : array-like of shape (n_rows,) or None
            Integer label of each row; None makes all rows one segment.
        n_rows : int
            Number of rows.

        Returns
        -------
        Segments
            One segment for each contiguous run of equal labels.

        Raises
        ------
        InputError
            If the labels are not one integer a row.
        """
        if labels is None:
            return cls(np.array([0], dtype=np.intp), np.array([n_rows], dtype=np.intp))
        values = np.asarray(labels)
        if values.shape != (n_rows,):
            raise InputError(
                "segments",
                expected=f"one label for each of the {n_rows} rows",
                found=f"an array of shape {values.shape}",
            )
        whole = np.issubdtype(values.dtype, np.integer) or (
            np.issubdtype(values.dtype, np.floating)
            and bool(np.all(np.isfinite(values)))
            and bool(np.all(values == np.round(values)))
        )
        if not whole:
            raise InputError(
                "segments",
                expected="integer labels",
                found=f"values of type {values.dtype}",
                remedy="number the intervals 1, 2, …",
            )
        cuts = np.flatnonzero(values[1:] != values[:-1]) + 1
        return cls(
            np.concatenate(([0], cuts)).astype(np.intp),
            np.concatenate((cuts, [n_rows])).astype(np.intp),
        )

    @property
    def lengths(self) -> IntArray:
        """Number of rows in each segment."""
        return self.stops - self.starts

    @property
    def n_rows(self) -> int:
        """Number of rows in all segments together."""
        return int(self.stops[-1])

    @property
    def later(self) -> IntArray:
        """Rows that have a predecessor in their own segment: one equation each."""
        keep = np.ones(self.n_rows, dtype=bool)
        keep[self.starts] = False
        return np.flatnonzero(keep)

    def slices(self) -> list[slice]:
        """Return the rows of each segment."""
        return [slice(int(a), int(b)) for a, b in zip(self.starts, self.stops, strict=True)]

    def offsets(self) -> IntArray:
        """Return the number of samples since the start of the row's own segment."""
        return np.arange(self.n_rows) - np.repeat(self.starts, self.lengths)


class HoldCoefficients(NamedTuple):
    """Coefficients of x[k] = pole x[k-1] + now f[k] + before f[k-1]."""

    pole: float
    now: float
    before: float


def hold_coefficients(
    time_constant_s: float, sample_period_s: float, hold: Hold
) -> HoldCoefficients:
    """Discretise τ x' + x = f exactly for an input held in the given way.

    With a = exp(-h/τ), "zero" (f[k-1] acts until k, Eq 9-11 of the paper) gives (a, 0, 1 - a);
    "first" (f joined by straight lines) gives (a, 1 - r, r - a) with r = (1 - a) τ/h.

    Parameters
    ----------
    time_constant_s : float
        τ > 0 in seconds.
    sample_period_s : float
        h > 0 in seconds.
    hold : {"first", "zero"}
        How the input runs between two samples.

    Returns
    -------
    HoldCoefficients
        Pole and the two input coefficients; they sum to one.
    """
    z = sample_period_s / time_constant_s
    pole = float(np.exp(-z))
    if hold == "zero":
        return HoldCoefficients(pole, 0.0, float(-np.expm1(-z)))
    # 1 - r loses its digits to cancellation for z << 1, where the series is exact to rounding.
    now = z / 2 - z**2 / 6 + z**3 / 24 - z**4 / 120 if z < 1e-3 else 1 + float(np.expm1(-z)) / z
    return HoldCoefficients(pole, now, 1 - pole - now)


def hold_sensitivities(
    time_constant_s: float, sample_period_s: float, hold: Hold
) -> HoldCoefficients:
    """Return the derivatives of `hold_coefficients` with respect to τ, in 1/s."""
    z = sample_period_s / time_constant_s
    pole = float(np.exp(-z))
    d_pole = pole * z / time_constant_s
    if hold == "zero":
        return HoldCoefficients(d_pole, 0.0, -d_pole)
    # d(now)/dz of 1 - (1 - e^-z)/z, then the chain rule with dz/dτ = -z/τ.
    slope = (
        0.5 - z / 3 + z**2 / 8 - z**3 / 30 if z < 1e-3 else (-float(np.expm1(-z)) - z * pole) / z**2
    )
    d_now = -slope * z / time_constant_s
    return HoldCoefficients(d_pole, d_now, -d_pole - d_now)


def simulate(
    forcing: FloatArray,
    segments: Segments,
    coefficients: HoldCoefficients,
    initial: FloatArray | None = None,
) -> FloatArray:
    """Run the lag through every segment from that segment's own initial state.

    Parameters
    ----------
    forcing : ndarray of shape (n_rows,) or (n_rows, n_columns)
        ψ'_QS at the samples, or the basis functions, each run alone.
    segments : Segments
        The runs of rows.
    coefficients : HoldCoefficients
        From `hold_coefficients`.
    initial : ndarray of shape (n_segments,) or None
        State at the first row of each segment; None starts every run at zero.

    Returns
    -------
    ndarray
        The states, in the shape of `forcing`.
    """
    from scipy.signal import lfilter

    pole, now, before = coefficients
    states = np.empty_like(forcing)
    for number, rows in enumerate(segments.slices()):
        start = 0.0 if initial is None else float(initial[number])
        states[rows.start] = start
        if rows.stop - rows.start < 2:
            continue
        drive = now * forcing[rows.start + 1 : rows.stop]
        drive += before * forcing[rows.start : rows.stop - 1]
        memory = np.full((1, *forcing.shape[1:]), pole * start)
        states[rows.start + 1 : rows.stop], _ = lfilter(
            [1.0], [1.0, -pole], drive, axis=0, zi=memory
        )
    return states
