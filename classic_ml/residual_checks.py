"""Checks of a fit as rows: statistic, threshold, passed, and what it means."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from classic_ml.records import FloatArray

__all__ = ["CheckRow", "coverage", "input_correlation", "whiteness"]

# Down and up again, and once more: less than three sweeps is a single excursion.
FEWEST_SWEEPS = 3


@dataclass(frozen=True)
class CheckRow:
    """One check.

    Parameters
    ----------
    check : str
        Name of the check.
    statistic : float
        What was computed.
    operator : {"<", ">="}
        On which side of the threshold the statistic should lie.
    threshold : float
        The limit.
    passed : bool
        Whether it does.
    meaning : str
        What the outcome says about the fit, in words.
    """

    check: str
    statistic: float
    operator: str
    threshold: float
    passed: bool
    meaning: str


def whiteness(innovations: FloatArray, runs: list[slice], n_lags: int = 20) -> CheckRow:
    """Check that one-step errors do not predict each other.

    Parameters
    ----------
    innovations : ndarray of shape (n,)
        One-step errors.
    runs : list of slice
        Their segments; no product straddles two.
    n_lags : int
        Lags that are looked at.
    """
    correlations = _correlations(innovations, innovations, runs, range(1, n_lags + 1))
    largest = float(np.max(np.abs(correlations)))
    limit = _limit(innovations.size, n_lags)
    passed = largest < limit
    meaning = (
        "one-step errors are white within the noise"
        if passed
        else "one-step errors predict each other: the noise model is incomplete or the data were "
        "low-passed; the time constant is biased and textbook errors would be too small (those "
        "stated allow for it)"
    )
    return CheckRow("whiteness", largest, "<", limit, passed, meaning)


def input_correlation(
    errors: FloatArray, phi: FloatArray, runs: list[slice], n_lags: int = 20
) -> CheckRow:
    """Check that the errors hold nothing more that φ could explain.

    Parameters
    ----------
    errors : ndarray of shape (n,)
        One-step errors.
    phi : ndarray of shape (n,)
        Flow coefficient.
    runs : list of slice
        Their segments.
    n_lags : int
        Lags to either side.
    """
    smooth = phi - phi.mean()
    lags = range(-n_lags, n_lags + 1)
    correlations = _correlations(errors, smooth, runs, lags)
    # φ is far from white: its own memory widens the band (Bartlett's formula).
    memory = _correlations(smooth, smooth, runs, range(1, n_lags + 1))
    colour = _correlations(errors, errors, runs, range(1, n_lags + 1))
    widening = np.sqrt(max(1.0 + 2.0 * float(memory @ colour), 1.0))
    largest = float(np.max(np.abs(correlations)))
    limit = float(_limit(errors.size, 2 * n_lags + 1) * widening)
    passed = largest < limit
    meaning = (
        "nothing is left in the errors that φ would explain"
        if passed
        else "the errors still follow φ: the characteristic, the lag or the alignment of φ and ψ' "
        "lacks something"
    )
    return CheckRow("input_correlation", largest, "<", limit, passed, meaning)


def coverage(phi: FloatArray, runs: list[slice], valid: tuple[float, float]) -> CheckRow:
    """Check how often φ sweeps from one end of its range to the other.

    Parameters
    ----------
    phi : ndarray of shape (n,)
        Flow coefficient of the fitted rows.
    runs : list of slice
        Their segments.
    valid : tuple of float
        Range whose outer thirds count as its ends.
    """
    low, high = valid
    third = (high - low) / 3.0
    sweeps = 0
    for run in runs:
        side = np.where(phi[run] > high - third, 1, np.where(phi[run] < low + third, -1, 0))
        sweeps += int(np.count_nonzero(np.diff(side[side != 0])))
    passed = sweeps >= FEWEST_SWEEPS
    meaning = (
        "φ sweeps its range several times"
        if passed
        else f"φ sweeps its range fewer than {FEWEST_SWEEPS} times: the curve rests on one event"
    )
    return CheckRow("phi_coverage", float(sweeps), ">=", float(FEWEST_SWEEPS), passed, meaning)


def _limit(n_rows: int, n_lags: int) -> float:
    from scipy.stats import norm

    # Bonferroni over the lags keeps the stated 1 % for the largest of them.
    return float(norm.isf(0.005 / n_lags) / np.sqrt(max(n_rows, 1)))


def _correlations(
    first: FloatArray, second: FloatArray, runs: list[slice], lags: range
) -> FloatArray:
    norm = np.sqrt(float(first @ first) * float(second @ second))
    sums = np.zeros(len(lags))
    for run in runs:
        one, two = first[run], second[run]
        for i, lag in enumerate(lags):
            if abs(lag) >= one.size:
                continue
            head, tail = (one[lag:], two[: one.size - lag]) if lag >= 0 else (one[:lag], two[-lag:])
            sums[i] += float(head @ tail)
    return sums / norm if norm > 0.0 else sums
