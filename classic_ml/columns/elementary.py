"""Powers in loops that the compiler can make vector instructions of.

The library's own power function takes one number at a time, and numpy's differs in the last bit
between processors. These are sums and products alone, so that they are the same everywhere.
"""

from __future__ import annotations

import numpy as np

from classic_ml.columns.compiled_as_written import as_written
from surge_core.types import FloatArray

__all__ = ["power_of", "powers"]

# ln 2 as the sum of two numbers, the first of which has room for the factor n without rounding.
LN2_HIGH = 6.93147180369123816490e-01
LN2_LOW = 1.90821492927058770002e-10
PER_LN2 = 1.44269504088896338700
# Reduction and polynomials of FreeBSD's msun, e_log.c and e_exp.c (Sun Microsystems, 1993), good to
# 2^-58 on the reduced ranges.
LOG_1, LOG_2, LOG_3 = 6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01
LOG_4, LOG_5, LOG_6 = 2.222219843214978396e-01, 1.818357216161805012e-01, 1.531383769920937332e-01
LOG_7 = 1.479819860511658591e-01
EXP_1, EXP_2 = 1.66666666666666019037e-01, -2.77777777770155933842e-03
EXP_3, EXP_4 = 6.61375632143793436117e-05, -1.65339022054652515390e-06
EXP_5 = 4.13813679705723846039e-08
# 1.5 * 2^52: what is added to it is rounded to a whole number, which its last bits then show.
ROUNDER = 6755399441055744.0
ROUNDER_BITS = 0x4338000000000000
# Bits of 1 less those of √½: added, they carry into the exponent from √½ upwards.
FROM_ROOT_HALF = 0x3FF0000000000000 - 0x3FE6A09E667F3BCD
BIAS = 1023


@as_written
def _log(x: float) -> float:
    """Return ln x of a positive number that is not subnormal."""
    bits = np.float64(x).view(np.uint64)
    biased = (bits + np.uint64(FROM_ROOT_HALF)) >> np.uint64(52)
    whole = biased - np.uint64(BIAS)
    n = np.uint64(whole + np.uint64(ROUNDER_BITS)).view(np.float64) - ROUNDER
    # x = 2^n (1 + f) with 1 + f from √½ to √2, and ln(1 + f) = 2 artanh(f/(2 + f)).
    f = np.uint64(bits - (whole << np.uint64(52))).view(np.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    even = w * (LOG_2 + w * (LOG_4 + w * LOG_6))
    odd = z * (LOG_1 + w * (LOG_3 + w * (LOG_5 + w * LOG_7)))
    half = 0.5 * f * f
    return n * LN2_HIGH - ((half - (s * (half + (odd + even)) + n * LN2_LOW)) - f)


@as_written
def _exp(x: float) -> float:
    """Return e^x for |x| < 700."""
    rounded = x * PER_LN2 + ROUNDER
    n = rounded - ROUNDER
    whole = np.float64(rounded).view(np.uint64) - np.uint64(ROUNDER_BITS)
    high = x - n * LN2_HIGH
    low = n * LN2_LOW
    r = high - low
    z = r * r
    c = r - z * (EXP_1 + z * (EXP_2 + z * (EXP_3 + z * (EXP_4 + z * EXP_5))))
    fraction = 1.0 - ((low - (r * c) / (2.0 - c)) - high)
    bits = np.float64(fraction).view(np.uint64) + (whole << np.uint64(52))
    return np.uint64(bits).view(np.float64)


@as_written
def power_of(base: float, exponent: float) -> float:
    """Return base^exponent for a positive base.

    Parameters
    ----------
    base : float
        Positive and not subnormal; the result is NaN where it is infinite or NaN.
    exponent : float
        Small enough that |exponent · ln base| < 700.

    Returns
    -------
    float
        Within 3e-16 of itself while |exponent · ln base| < 1, and 2e-16 more for each unit beyond.
    """
    power: float = _exp(exponent * _log(base))
    # Neither does well with what is not finite.
    return power + (base - base)


@as_written
def _powers(base: FloatArray, exponent: float, out: FloatArray) -> None:
    for k in range(base.size):
        out[k] = power_of(base[k], exponent)


def powers(base: FloatArray, exponent: float) -> FloatArray:
    """Return the powers of positive numbers, each as :func:`power_of` gives it.

    Parameters
    ----------
    base : ndarray of shape (n,)
        Positive numbers.
    exponent : float
        The exponent.

    Returns
    -------
    ndarray of shape (n,)
        base^exponent.
    """
    out = np.empty(base.shape)
    _powers(np.ravel(base), exponent, out.reshape(-1))
    return out
