"""Efficiency of estimates against the Cramer-Rao bound, with its sampling error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
NORMAL_975 = 1.959964


def mean_and_se(values: FloatArray) -> tuple[float, float]:
    """Return the mean over records and its standard error, nan for fewer than two.

    Parameters
    ----------
    values : ndarray of shape (n,)
        One of each record.
    """
    if values.size == 0:
        return float("nan"), float("nan")
    se = values.std(ddof=1) / np.sqrt(values.size) if values.size > 1 else float("nan")
    return float(values.mean()), float(se)


def efficiency(error: FloatArray, control: FloatArray | None = None) -> tuple[float, float]:
    """Return 1 / mean(error²) and its standard error.

    Parameters
    ----------
    error : ndarray of shape (n,)
        Error / bound of each record.
    control : ndarray of shape (n,), optional
        The same of an estimate that attains the bound on these records. Its mean square is
        known to be 1, so that mean(error² - control²) + 1 estimates mean(error²), and the chance
        of the records, which moves both alike, drops out.
    """
    squared = error**2 if control is None else error**2 - control**2
    mean, se = mean_and_se(squared)
    if control is not None:
        mean += 1.0
    # By the delta method; a mean of few differences can come out negative and then says nothing.
    return (1.0 / mean, se / mean**2) if mean > 0.0 else (float("nan"), float("nan"))


def coverage(holds: FloatArray, control: FloatArray) -> tuple[float, float]:
    """Return the share of intervals that hold the truth and its standard error.

    Parameters
    ----------
    holds : ndarray of shape (n,)
        1 where the interval of a record holds, else 0.
    control : ndarray of shape (n,)
        (error / bound) of the one-step estimate from the truth. Whether it is below 1.96 is a
        share known to be 0.95; the regression on it takes out the chance of the records.
    """
    expected = (np.abs(control) <= NORMAL_975).astype(np.float64) - 0.95
    spread = expected.var()
    slope = float(np.mean((holds - holds.mean()) * expected) / spread) if spread > 0.0 else 0.0
    return mean_and_se(holds - slope * expected)


def middle_half(values: FloatArray) -> float:
    """Return the mean without the lowest and the highest quarter; nan of nothing.

    A median alone moves in steps where the kernel counts CPU time in ticks, and a mean alone
    follows the few fits beside which something else ran.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Times, or ratios of times.
    """
    quarter = values.size // 4
    kept = np.sort(values)[quarter : values.size - quarter]
    return float(kept.mean()) if kept.size else float("nan")
