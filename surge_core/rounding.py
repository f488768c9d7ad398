"""Numbers as people read them: rounded to their uncertainty."""

from __future__ import annotations

import math

# Beyond these a number is easier read with a power of ten.
PLAIN_RANGE = (1e-4, 1e6)
# Below this, which no measurement reaches, a float has lost its digits: the value is exact.
SMALLEST_ERROR = 1e-300
NOT_KNOWN = "n/a"


def round_to_error(value: float, error: float) -> str:
    """Round a value and its standard error as the Particle Data Group does.

    The error keeps two digits when its first three lie between 100 and 354, one up to 949, and
    is rounded up to 1000 with two digits beyond; the value keeps as many decimals. E.g.
    ``"30.1 ± 1.2"``, ``"(1.21 ± 0.05)e-06"``; ``"30.12 ± ?"`` where the error is not known,
    ``"n/a"`` where the value is not.
    """
    if not math.isfinite(value):
        return NOT_KNOWN
    if not math.isfinite(error):
        return f"{significant(value)} ± ?"
    if error < SMALLEST_ERROR:
        return significant(value)
    value, error, power = _scaled(value, error)
    decimals = decimals_for(error)
    text = f"{_fixed(value, decimals)} ± {_fixed(_rounded_error(error), decimals)}"
    return f"({text}){power}" if power else text


def bracketed(value: float, error: float) -> str:
    """Round a value to its standard error and write the error in its last digits.

    E.g. ``"0.351(12)"``, ``"30.1(1.2)"``, ``"353(24)"``, ``"1.20(3)e-08"``; without an error to
    speak of, the value alone.
    """
    if not (math.isfinite(value) and math.isfinite(error) and error >= SMALLEST_ERROR):
        return significant(value)
    value, error, power = _scaled(value, error)
    decimals = decimals_for(error)
    if abs(value) < error:
        # Rounded to tens of its error a parameter would stand outside its bounds.
        decimals = max(decimals, 0)
    rounded = _rounded_error(error)
    last_digits = rounded * 10.0**decimals if 0.0 < rounded < 1.0 else rounded
    error_text = f"{last_digits:.0f}" if rounded < 1.0 else _fixed(rounded, decimals)
    return f"{_fixed(value, decimals)}({error_text}){power}"


def round_like(value: float, error: float) -> str:
    """Round a value to the decimals of its standard error, without writing that."""
    if not math.isfinite(value):
        return NOT_KNOWN
    if not (math.isfinite(error) and error >= SMALLEST_ERROR):
        return significant(value)
    return _fixed(value, decimals_for(error))


def significant(value: float, digits: int = 4) -> str:
    """Round to significant digits, for a value whose error is not known."""
    if not math.isfinite(value):
        return NOT_KNOWN
    text = f"{value:#.{digits}g}".rstrip(".")
    return text if "e" in text else text.removeprefix("-") if float(text) == 0.0 else text


def decimals_for(error: float) -> int:
    """Return the decimals that an error is written with; negative for tens, hundreds, …"""
    exponent = math.floor(math.log10(error))
    leading = round(error / 10.0**exponent, 2)
    if leading >= 9.5:
        return -exponent
    return 1 - exponent if leading < 3.55 else -exponent


def _scaled(value: float, error: float) -> tuple[float, float, str]:
    """Return a value and its error by a power of ten, and that power as text where one is due."""
    largest = max(abs(value), error)
    if PLAIN_RANGE[0] <= largest < PLAIN_RANGE[1]:
        return value, error, ""
    exponent = math.floor(math.log10(largest))
    return value / 10.0**exponent, error / 10.0**exponent, f"e{exponent:+03d}"


def _rounded_error(error: float) -> float:
    exponent = math.floor(math.log10(error))
    return 10.0 ** (exponent + 1) if round(error / 10.0**exponent, 2) >= 9.5 else error


def _fixed(value: float, decimals: int) -> str:
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


# From here on tenths are no evidence, and a search that ends on a flat crest does not hold them.
WHOLE_LOG_UNITS = 100.0
# A curve far beyond its data can miss by anything.
LARGE_LOG_UNITS = 1e7


def log_units(gain: float, not_known: str = NOT_KNOWN) -> str:
    """Return a gain of the log-likelihood, in natural units, to the digits that say something."""
    if not math.isfinite(gain):
        return not_known
    if abs(gain) >= LARGE_LOG_UNITS:
        return f"{gain:.2g}"
    return f"{gain:.1f}" if abs(gain) < WHOLE_LOG_UNITS else f"{gain:.0f}"
