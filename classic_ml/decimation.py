"""Fewer samples a second for data that a low-pass has emptied above its corner.

A noise model that whitens divides by the spectrum of the errors. Where a low-pass has left next
to nothing above 48 Hz of a record of 1 kHz, it divides by nothing and fits the skirt of the
filter. Decimation takes the empty band away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surge_core.errors import InputError
from surge_core.segments import runs_of
from surge_core.types import FloatArray
from surge_core.validation import positive, whole_number

__all__ = ["Decimated", "decimate", "emptied_above_hz", "needed_factor"]

LONGEST_PIECE = 2048
SHORTEST_PIECE = 32
# Half the width, as a share of the frequency, of the running median that takes out lines such as
# the stall cells'.
MEDIAN_SHARE = 0.15
FEWEST_BINS = 2
# A Butterworth filter of order 3, the paper's lowest, falls by the sixth power of frequency; white
# noise does not fall, and a lag on white noise falls by the second.
STEEPNESS = 5.0
ALLOWANCE = 3.0
# In log f: a quarter of an octave and a bit, twice the width of the median.
BEFORE_CORNER = 0.3
# The skirt's first octave is kept: there whitening still divides by something.
KEPT_OCTAVES = 1.0
MOST_FACTOR = 10
# The transition of a windowed sinc takes two zeros of the sinc to either side.
HALF_WIDTH_FACTORS = 2


@dataclass(frozen=True)
class Decimated:
    """A record with fewer rows.

    Parameters
    ----------
    terms : ndarray of shape (m, q)
        Inputs s_i, filtered and decimated.
    y : ndarray of shape (m,)
        ψ', filtered and decimated alike.
    segments : ndarray of int, shape (m,)
        Label of each row, as it was given; 0 without labels.
    sample_weight : ndarray of shape (m,)
        Mean weight of the rows behind each; 0 where one of them had weight 0.
    rows : ndarray of int, shape (m,)
        Row of the original record at the centre of each.
    sample_period_s : float
        The new sample period, in seconds.
    factor : int
        Old rows a new one.
    """

    terms: FloatArray
    y: FloatArray
    segments: NDArray[np.int64]
    sample_weight: FloatArray
    rows: NDArray[np.int64]
    sample_period_s: float
    factor: int


def decimate(
    terms: ArrayLike,
    y: ArrayLike,
    segments: ArrayLike | None = None,
    *,
    factor: int,
    sample_period_s: float,
    cutoff_hz: float | None = None,
    sample_weight: ArrayLike | None = None,
) -> Decimated:
    """Low-pass ψ' and each s_i with one linear-phase filter and keep every ``factor``-th row.

    Parameters
    ----------
    terms : array-like of shape (n, q)
        The inputs s_i(φ) at each sample, not φ: φ² of a filtered φ is not a filtered φ².
    y : array-like of shape (n,)
        ψ'.
    segments : array-like of int, shape (n,), optional
        Labels. Each segment is filtered by itself, and only rows whose filter lies wholly in it
        are kept, so that nothing leaks across a joint.
    factor : int
        Rows that become one; 1 leaves the record as it is.
    sample_period_s : float
        Sample period, in seconds.
    cutoff_hz : float, optional
        Frequency of half gain; the new Nyquist frequency without it, so that the new record's
        own band is not emptied in turn.
    sample_weight : array-like of shape (n,), optional
        Weights. A filter cannot leave a row out: a new row that one of weight 0 enters gets
        weight 0.

    Returns
    -------
    Decimated
        To be fitted with the terms as they are, e.g. with
        ``LagRegressor(d.sample_period_s, basis=FunctionTransformer())``; the characteristic is
        then the original terms at φ times its ``coef_``.

    Raises
    ------
    InputError
        When no segment is longer than the filter, or the cut-off lies beyond half the sample rate.

    Notes
    -----
    A Hamming-windowed sinc of 4 ``factor`` + 1 taps. Its delay is a whole number of rows and is
    taken out; a lag commutes with any such filter that ψ' and the s_i share.
    """
    columns = np.asarray(terms, dtype=np.float64)
    target = np.asarray(y, dtype=np.float64)
    whole_number("factor", factor, 1, 10_000)
    positive("sample_period_s", sample_period_s)
    if columns.ndim != 2 or columns.shape[0] != target.size:
        raise InputError(
            "terms", expected=f"a table of {target.size} rows", found=f"shape {columns.shape}"
        )
    weight = (
        np.ones(target.size) if sample_weight is None else np.asarray(sample_weight, np.float64)
    )
    labels = np.zeros(target.size, np.int64) if segments is None else np.asarray(segments)
    taps = _taps(factor, sample_period_s, cutoff_hz)
    half = taps.size // 2
    long_enough = [r for r in runs_of(segments, target.size) if r.stop - r.start >= taps.size]
    if not long_enough:
        raise InputError(
            "decimate",
            expected=f"a segment of at least {taps.size} rows for a factor of {factor}",
            found="shorter ones",
            remedy="take a smaller factor, or output error on the record as it is",
        )
    rows = np.concatenate(
        [np.arange(run.start + half, run.stop - half, factor) for run in long_enough]
    ).astype(np.int64)
    both = np.column_stack([target, columns])
    filtered = np.concatenate([_filtered(both[run], taps)[::factor] for run in long_enough])
    return Decimated(
        filtered[:, 1:],
        filtered[:, 0],
        labels[rows].astype(np.int64),
        _weights(weight, half, rows),
        rows,
        factor * float(sample_period_s),
        factor,
    )


def needed_factor(
    y: ArrayLike, segments: ArrayLike | None = None, *, sample_period_s: float
) -> int:
    """Return the factor by which a record should be decimated before a whitening noise model.

    Parameters
    ----------
    y : array-like of shape (n,)
        ψ'.
    segments : array-like of int, shape (n,), optional
        Labels.
    sample_period_s : float
        Sample period, in seconds.

    Returns
    -------
    int
        1 where the spectrum has not been emptied, else the largest factor, up to 10, that keeps
        an octave above the corner.
    """
    corner = emptied_above_hz(y, segments, sample_period_s=sample_period_s)
    if corner is None:
        return 1
    nyquist_hz = 0.5 / sample_period_s
    return int(np.clip(nyquist_hz / (corner * 2.0**KEPT_OCTAVES), 1, MOST_FACTOR))


def emptied_above_hz(
    values: ArrayLike, segments: ArrayLike | None = None, *, sample_period_s: float
) -> float | None:
    """Return the corner above which a low-pass has emptied a signal, if one has.

    Parameters
    ----------
    values : array-like of shape (n,)
        The signal.
    segments : array-like of int, shape (n,), optional
        Labels.
    sample_period_s : float
        Sample period, in seconds.

    Returns
    -------
    float or None
        In hertz: a frequency from which on the spectrum falls at least as fast as its fifth
        power all the way to half the sample rate, the highest that has a flatter stretch before
        it; None where there is none below an eighth of the sample rate. A signal
        without any noise is empty by itself and cannot be told from a filtered one.
    """
    signal = np.asarray(values, dtype=np.float64)
    found = _spectrum(signal, runs_of(segments, signal.size), float(sample_period_s))
    if found is None:
        return None
    frequency, density = found
    tiny = np.finfo(np.float64).tiny
    log_f, log_s = np.log(frequency), np.log(np.maximum(_without_lines(frequency, density), tiny))
    # Whitened by f⁵, a skirt falls, and everything after its corner lies below it.
    level = log_s + STEEPNESS * log_f
    highest_after = np.maximum.accumulate(level[::-1])[::-1]
    limit = 0.25 * frequency[-1]
    falls = (highest_after <= level + np.log(ALLOWANCE)) & (frequency <= limit)
    if not falls.any():
        return None
    # A signal of low frequency has a skirt of its own: the corner is where the noise between the
    # two ends.
    below = np.interp(log_f - BEFORE_CORNER, log_f, log_s)
    flat = falls & (log_s - below > -0.5 * STEEPNESS * BEFORE_CORNER)
    return float(frequency[np.flatnonzero(flat)[-1] if flat.any() else np.argmax(falls)])


def _spectrum(
    signal: FloatArray, runs: list[slice], sample_period_s: float
) -> tuple[FloatArray, FloatArray] | None:
    from scipy.signal import welch

    lengths = np.sort([run.stop - run.start for run in runs])
    # Three quarters of the segments reach this length; the others do not count.
    rows = min(int(lengths[lengths.size // 4]), LONGEST_PIECE)
    if rows < SHORTEST_PIECE:
        return None
    # A few pieces at least, so that the estimate does not scatter by more than a factor of two.
    while lengths[lengths >= rows].sum() < 4 * rows and rows >= 2 * SHORTEST_PIECE:
        rows //= 2
    total, n = np.zeros(rows // 2 + 1), 0
    for run in runs:
        length = run.stop - run.start
        if length < rows:
            continue
        pieces = 1 + 2 * (length - rows) // rows
        frequency, density = welch(
            signal[run],
            fs=1.0 / sample_period_s,
            # Its side lobes lie at -92 dB: Hann's would fill an emptied band with leakage.
            window="blackmanharris",
            nperseg=rows,
            # The stubs know of "literal" only; the documentation and the code, of "linear".
            detrend="linear",  # type: ignore[call-overload]
        )
        total += pieces * density
        n += pieces
    # The first bins hold what detrending left, the last has half the power.
    return np.asarray(frequency[1:-1]), np.asarray(total[1:-1] / n)


def _without_lines(frequency: FloatArray, density: FloatArray) -> FloatArray:
    """Return the running median over a share of each frequency."""
    width = frequency[0]
    smooth = np.empty_like(density)
    for i, f in enumerate(frequency):
        side = max(int(MEDIAN_SHARE * f / width), FEWEST_BINS)
        smooth[i] = np.median(density[max(i - side, 0) : i + side + 1])
    return smooth


def _taps(factor: int, sample_period_s: float, cutoff_hz: float | None) -> FloatArray:
    from scipy.signal import firwin

    if factor == 1 and cutoff_hz is None:
        return np.ones(1)
    nyquist_hz = 0.5 / sample_period_s
    cutoff = nyquist_hz / factor if cutoff_hz is None else cutoff_hz
    if not 0.0 < cutoff < nyquist_hz:
        raise InputError(
            "cutoff_hz",
            expected=f"above 0 and below half the sample rate ({nyquist_hz:g} Hz)",
            found=f"{cutoff:g}",
        )
    half = max(HALF_WIDTH_FACTORS * factor, round(HALF_WIDTH_FACTORS * nyquist_hz / cutoff))
    return np.asarray(firwin(2 * half + 1, cutoff / nyquist_hz), dtype=np.float64)


def _filtered(columns: FloatArray, taps: FloatArray) -> FloatArray:
    """Return the filter's output where it lies wholly in the segment."""
    from scipy.signal import oaconvolve

    if taps.size == 1:
        return columns
    return np.asarray(oaconvolve(columns, taps[:, None], mode="valid", axes=0), dtype=np.float64)


def _weights(weight: FloatArray, half: int, rows: NDArray[np.int64]) -> FloatArray:
    ones = np.concatenate([[0.0], np.cumsum(weight)])
    zeros = np.concatenate([[0], np.cumsum(weight == 0.0)])
    low, high = rows - half, rows + half + 1
    mean = (ones[high] - ones[low]) / (2 * half + 1)
    return np.asarray(np.where(zeros[high] > zeros[low], 0.0, mean))
