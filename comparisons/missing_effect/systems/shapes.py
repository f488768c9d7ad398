"""What an effect does to a number: the functions behind the catalogue, one code each.

Terms are dimensionless: a signal is divided by its own rms before, and the result is multiplied
by the rms of the equation that it enters, so that one range of amplitudes serves every system.
"""

from __future__ import annotations

import math
from enum import IntEnum

from comparisons.missing_effect.systems.pointers import kernel


class Kind(IntEnum):
    """Where and how an effect acts; the integers are what the kernels see."""

    TERM = 0
    INPUT_MAP = 1
    INPUT_LAG = 2
    INPUT_DELAY = 3
    INPUT_PLAY = 4
    OUTPUT_MAP = 5
    OUTPUT_LAG = 6
    DRIFT = 7
    STATE_LIMIT = 8
    OVERFLOW = 9
    HYSTERESIS = 10
    RECORDING = 11


class Term(IntEnum):
    """Shapes of terms in an equation, of a scaled signal s."""

    CONSTANT = 0
    LINEAR = 1
    SQUARE = 2
    CUBE = 3
    DRAG = 4
    COULOMB = 5
    STRIBECK = 6
    GAP = 7
    SINE = 8
    PRODUCT = 9
    SIZE = 10
    SQUARE_PRODUCT = 11
    # An expression of the user's own, behind an address.
    CALLED = 12


class Map(IntEnum):
    """Shapes of what stands in place of an input or a sensor's reading."""

    SHIFT = 0
    UPPER = 1
    LOWER = 2
    BOTH = 3
    DEAD_ZONE = 4
    ABSOLUTE = 5
    RECTIFIED = 6
    SQUARE = 7
    CUBE = 8


@kernel
def term_value(code: int, s: float, other: float, a: float, b: float) -> float:
    """Return the shape of a term, one of `Term`, of a signal over its rms and a second one.

    The numbers a and b are the width of a change of sign, a threshold, Stribeck's excess.
    """
    value = 1.0
    if code == 1:
        value = s
    elif code == 2:
        value = s * s
    elif code == 3:
        value = s * s * s
    elif code == 4:
        value = s * abs(s)
    elif code == 5:
        value = math.tanh(s / a)
    elif code == 6:
        # The extra force at rest is as large again as the sliding one times b; it fades over a
        # speed of a tenth of the rms.
        value = math.tanh(s / a) * (1.0 + b * math.exp(-((s / 0.1) ** 2)))
    elif code == 7:
        value = max(s - a, 0.0) + min(s + a, 0.0)
    elif code == 8:
        value = math.sin(s)
    elif code == 9:
        value = s * other
    elif code == 10:
        value = abs(s)
    elif code == 11:
        value = s * s * other
    return value


@kernel
def map_value(code: int, value: float, scale: float, a: float) -> float:
    """Return what stands in place of an input or of a sensor's reading: one of `Map`.

    The number a is in units of the signal's rms, its scale; of a reading that is blind to the sign
    it is the exponent.
    """
    at = a * scale
    out = value
    if code == 0:
        out = value + at
    elif code == 1:
        out = min(value, at)
    elif code == 2:
        out = max(value, at)
    elif code == 3:
        out = min(max(value, -at), at)
    elif code == 4:
        out = max(value - at, 0.0) + min(value + at, 0.0)
    elif code == 5:
        out = scale * (abs(value) / scale) ** a
    elif code == 6:
        out = max(value, 0.0)
    elif code == 7:
        out = value + a * value * value / scale
    elif code == 8:
        out = value + a * value * value * value / (scale * scale)
    return out
