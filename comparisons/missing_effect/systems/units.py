"""Units as powers of symbols: they multiply, cancel and are written so that they can be read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from fractions import Fraction

SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
TOKEN = re.compile(
    r"\s*([()/*·.]|[^\W\d_]+|[°%]\w*|1(?!\d))(?:(?:\^|\*\*)?(-?\d+(?:\.\d+)?|\(-?\d+/\d+\)))?\s*"
)
TIMES = ("s", "ms", "min", "h")
LENGTHS = ("m", "mm", "cm", "dm", "km", "µm", "μm", "um", "nm", "in", "ft")
ANGLES = ("rad", "mrad", "deg", "°", "rev", "turn", "rpm")


def _powers(unit: str) -> dict[str, Fraction]:
    """Return the symbols of a unit with their powers; what cannot be read is a symbol itself."""
    if unit.strip() == "-":
        return {}
    plain = re.sub(r"[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+", lambda m: "^" + m[0].translate(SUPERSCRIPTS), unit)
    groups: list[tuple[dict[str, Fraction], float]] = [({}, 1)]
    sign, at = 1, 0
    while at < len(plain):
        found = TOKEN.match(plain, at)
        if found is None:
            return {unit: Fraction(1)}
        at, token, power = found.end(), found[1], Fraction((found[2] or "1").strip("()"))
        if token == "(":
            groups.append(({}, sign))
            sign = 1
        elif token == ")" and len(groups) > 1:
            inner, outside = groups.pop()
            _multiply(groups[-1][0], inner, outside * power)
        elif token == ")":
            return {unit: Fraction(1)}
        elif token in "/*·.":
            sign = -1 if token == "/" else 1
            continue
        else:
            _multiply(groups[-1][0], {} if token == "1" else {token: power}, sign)
            sign = 1
    return groups[0][0] if len(groups) == 1 else {unit: Fraction(1)}


def _multiply(into: dict[str, Fraction], unit: Mapping[str, Fraction], power: float) -> None:
    for symbol, own in unit.items():
        into[symbol] = into.get(symbol, Fraction(0)) + own * Fraction(power)
        if not into[symbol]:
            del into[symbol]


def product_of_units(*factors: tuple[str, float]) -> str:
    """Return a product of units, each with its power, simplified: ``m/s²``, ``1/(V·s)``."""
    powers: dict[str, Fraction] = {}
    for unit, power in factors:
        _multiply(powers, _powers(unit), power)
    above = [_raised(s, p) for s, p in powers.items() if p > 0]
    below = [_raised(s, -p) for s, p in powers.items() if p < 0]
    if not below:
        return "·".join(above) or "1"
    joined = below[0] if len(below) == 1 else f"({'·'.join(below)})"
    return f"{'·'.join(above) or '1'}/{joined}"


def _raised(symbol: str, power: Fraction) -> str:
    if power == 1:
        return symbol
    whole = power.denominator == 1
    return symbol + (str(power.numerator).translate(RAISED) if whole else f"^({power})")


def is_mechanical(unit: str) -> bool:
    """Tell whether a unit is that of a motion: of a length or an angle, or of their rates."""
    powers = {s: p for s, p in _powers(unit).items() if s not in TIMES}
    return len(powers) == 1 and all(s in (*LENGTHS, *ANGLES) and p == 1 for s, p in powers.items())


def is_speed(unit: str) -> bool:
    """Tell whether a unit is that of the rate of a length or an angle."""
    powers = _powers(unit)
    return is_mechanical(unit) and ("rpm" in powers or any(powers.get(s, 0) < 0 for s in TIMES))
