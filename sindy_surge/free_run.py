"""Exact discrete free run of the first-order lag, segment by segment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surge_core.errors import InputError
from surge_core.types import FloatArray, IndexArray

__all__ = [
    "Hold",
    "HoldCoefficients",
    "LagTaps",
    "Segments",
    "hold_coefficients",
    "hold_sensitivities",
    "lag_taps",
    "run_lag",
    "simulate",
    "tap_sensitivities",
]

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

    starts: IndexArray
    stops: IndexArray

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
    def lengths(self) -> IndexArray:
        """Number of rows in each segment."""
        return self.stops - self.starts

    @property
    def n_rows(self) -> int:
        """Number of rows in all segments together."""
        return int(self.stops[-1]) if self.stops.size else 0

    @property
    def later(self) -> IndexArray:
        """Rows that have a predecessor in their own segment: one equation each."""
        keep = np.ones(self.n_rows, dtype=bool)
        keep[self.starts] = False
        return np.flatnonzero(keep)

    def slices(self) -> list[slice]:
        """Return the rows of each segment."""
        return [slice(int(a), int(b)) for a, b in zip(self.starts, self.stops, strict=True)]

    def offsets(self) -> IndexArray:
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


@dataclass(frozen=True)
class LagTaps:
    """Coefficients of x[k] = pole x[k-1] + Σ_i taps[i] f[k - shift - i], exact for the hold.

    Parameters
    ----------
    pole : float
        exp(-h/τ).
    shift : int
        Whole samples of the dead time; negative if the input comes late.
    taps : ndarray of shape (2,) or (3,)
        Weights of the input; three where the dead time is no whole number of samples.
    """

    pole: float
    shift: int
    taps: FloatArray

    def drive(self, values: FloatArray, rows: IndexArray) -> FloatArray:
        """Apply the input side: Σ_i taps[i] values[row - shift - i].

        Parameters
        ----------
        values : ndarray of shape (n_rows,) or (n_rows, n_columns)
            Inputs over the record.
        rows : ndarray of int of shape (n,)
            Rows k of the record.

        Returns
        -------
        ndarray of shape (n,) or (n, n_columns)
            The drive of each row.
        """
        result: FloatArray = self.taps[0] * values[rows - self.shift]
        for number, tap in enumerate(self.taps[1:], start=1):
            result += tap * values[rows - self.shift - number]
        return result


def lag_taps(
    time_constant_s: float,
    sample_period_s: float,
    hold: Hold,
    dead_time_s: float = 0.0,
    shift: int | None = None,
) -> LagTaps:
    """Discretise τ x'(t) + x(t) = f(t - d) exactly for an input held in the given way.

    With d = (m + θ) h, 0 ≤ θ < 1, a sample period falls into two parts, θ h and (1 - θ) h, on
    each of which the held input is a straight line (hold "first") or constant (hold "zero").

    Parameters
    ----------
    time_constant_s : float
        τ > 0 in seconds.
    sample_period_s : float
        h > 0 in seconds.
    hold : {"first", "zero"}
        How the input runs between two samples.
    dead_time_s : float
        d in seconds; negative if the input was measured late.
    shift : int or None
        m, where d lies on the edge of two samples and the caller has decided; None finds it, and
        gives two taps when θ = 0.

    Returns
    -------
    LagTaps
        The coefficients; the taps sum to 1 - pole.
    """
    samples = dead_time_s / sample_period_s
    whole = int(np.floor(samples + 1e-12)) if shift is None else shift
    part = samples - whole
    pole = float(np.exp(-sample_period_s / time_constant_s))
    if abs(part) <= 1e-12:
        _, now, before = hold_coefficients(time_constant_s, sample_period_s, hold)
        taps = [now, before] if shift is None else [now, before, 0.0]
        return LagTaps(pole, whole, np.array(taps))
    _, now_1, before_1 = hold_coefficients(time_constant_s, part * sample_period_s, hold)
    rest_s = (1 - part) * sample_period_s
    pole_2, now_2, before_2 = (
        hold_coefficients(time_constant_s, rest_s, hold) if rest_s else HoldCoefficients(1, 0, 0)
    )
    if hold == "zero":
        return LagTaps(pole, whole, np.array([0.0, before_2, pole_2 * before_1]))
    # First part: θ f[k-2] + (1-θ) f[k-1] to f[k-1]; second: from there to θ f[k-1] + (1-θ) f[k].
    middle = before_2 + now_2 * part + pole_2 * (now_1 + before_1 * (1 - part))
    return LagTaps(pole, whole, np.array([now_2 * (1 - part), middle, pole_2 * before_1 * part]))


def tap_sensitivities(
    time_constant_s: float,
    sample_period_s: float,
    hold: Hold,
    dead_time_s: float,
    shift: int | None,
) -> tuple[LagTaps, LagTaps]:
    """Return the derivatives of `lag_taps` with respect to τ and to the dead time, in 1/s.

    Parameters
    ----------
    time_constant_s, sample_period_s, hold, dead_time_s, shift
        See `lag_taps`; the derivative with respect to d is from the right at θ = 0, and
        zero where `shift` is None.

    Returns
    -------
    by_tau, by_dead_time : LagTaps
        Derivatives of the pole and of the taps.
    """
    now = lag_taps(time_constant_s, sample_period_s, hold, dead_time_s, shift)
    if now.taps.size == 2:
        pole, first, before = hold_sensitivities(time_constant_s, sample_period_s, hold)
        return (
            LagTaps(pole, now.shift, np.array([first, before])),
            LagTaps(0.0, now.shift, np.zeros(2)),
        )

    def taps(tau: float, dead: float) -> LagTaps:
        return lag_taps(tau, sample_period_s, hold, dead, now.shift)

    step = 1e-5 * time_constant_s
    above, below = (
        taps(time_constant_s + step, dead_time_s),
        taps(time_constant_s - step, dead_time_s),
    )
    by_tau = LagTaps(
        (above.pole - below.pole) / (2 * step), now.shift, (above.taps - below.taps) / (2 * step)
    )
    # One-sided towards the inside of the sample, so that the layout of the taps stays the same.
    inside = dead_time_s / sample_period_s - now.shift < 0.5
    move = (1e-5 if inside else -1e-5) * sample_period_s
    near, far = (
        taps(time_constant_s, dead_time_s + move),
        taps(time_constant_s, dead_time_s + 2 * move),
    )
    slope = (4 * near.taps - 3 * now.taps - far.taps) / (2 * move)
    return by_tau, LagTaps(0.0, now.shift, slope)


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
    pole : float
        exp(-h/τ).
    initial : ndarray of shape (n_segments,) or None
        State at the first row of each segment; None starts every run at zero.

    Returns
    -------
    ndarray
        The states, in the shape of `drive`.
    """
    from scipy.signal import lfilter

    states = np.empty_like(drive)
    for number, rows in enumerate(segments.slices()):
        start = 0.0 if initial is None else float(initial[number])
        states[rows.start] = start
        if rows.stop - rows.start < 2:
            continue
        memory = np.full((1, *drive.shape[1:]), pole * start)
        states[rows.start + 1 : rows.stop], _ = lfilter(
            [1.0], [1.0, -pole], drive[rows.start + 1 : rows.stop], axis=0, zi=memory
        )
    return states


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
    pole, now, before = coefficients
    drive = now * forcing
    drive[1:] += before * forcing[:-1]
    return run_lag(drive, segments, pole, initial)
