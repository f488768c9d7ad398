"""Units at the boundary: what a file or test.toml states, as one multiply-add to SI.

Inside the packages a pressure is in Pa, a temperature in K and a time in s. The factors come from
pint's definitions in exact fractions and are rounded once, so that no conversion is off by more
than the last digit of a double.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction
from functools import cache, lru_cache
from typing import Any

import numpy as np

from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "COUNT",
    "Conversion",
    "is_count",
    "is_unit_label",
    "kind_of_unit",
    "pressure_conversion",
    "pressure_reference",
    "quantity_in",
    "same_unit",
    "states_a_unit",
    "temperature_conversion",
    "time_conversion",
    "unit_in_brackets",
]

COUNT = "count"
_COUNT_WORDS = frozenset(
    ("count", "counts", "code", "codes", "adc counts", "raw counts", "lsb", "cts")
)
# Labels that state nothing: a form's empty field.
_NO_STATEMENT = frozenset(("", "-", "--", "n/a", "na", "none", "unknown", "undefined", "null"))
_DIMENSIONLESS = frozenset(("1", "dimensionless"))

_SI = {"pressure": "Pa", "temperature": "K", "time": "s"}
_COMMON = {
    "pressure": (
        *("Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi", "psf", "atm", "torr"),
        *("mmHg", "inHg", "mmH2O", "inH2O"),
    ),
    "temperature": ("K", "degC", "degF", "degR"),
    "time": ("s", "ms", "us", "ns", "min"),
}
# Spellings of the trade that pint has not, or reads as something else (R is its gas constant, C
# its coulomb, F its farad). Where a kind of quantity is asked for, none of them is in doubt.
_SPELLINGS = {
    "pressure": {
        # Capitals are no matter but between MPa and mPa.
        **{name.lower(): name for name in _COMMON["pressure"] if name != "MPa"},
        "psf": "pound_force / foot**2",
        "lbf/in2": "psi",
        "lb/in2": "psi",
        "lbf/in^2": "psi",
        "lbf/ft2": "pound_force / foot**2",
        "n/m2": "Pa",
        "n/m^2": "Pa",
        "n/m²": "Pa",
        "in hg": "inHg",
        "in. hg": "inHg",
        "in h2o": "inH2O",
        "in. h2o": "inH2O",
        "mm hg": "mmHg",
        "mm h2o": "mmH2O",
        "mmh2o": "mmH2O",
        "mmwc": "mmH2O",
        "inwc": "inH2O",
    },
    "temperature": {
        **dict.fromkeys(("c", "deg c", "deg_c", "°c", "° c", "celsius", "degree c"), "degC"),
        **dict.fromkeys(("f", "deg f", "deg_f", "°f", "° f", "fahrenheit", "degree f"), "degF"),
        **dict.fromkeys(("r", "deg r", "deg_r", "°r", "° r", "rankine", "degree r"), "degR"),
        **dict.fromkeys(("k", "deg k", "deg_k", "degk", "°k", "kelvin", "kelvins"), "K"),
        **{name.lower(): name for name in ("degC", "degF", "degR")},
    },
    "time": {
        **dict.fromkeys(("sec", "secs", "sec.", "second", "seconds"), "s"),
        **dict.fromkeys(("msec", "millisecond", "milliseconds"), "ms"),
        **dict.fromkeys(("usec", "µs", "μs", "microsecond", "microseconds"), "us"),
        **dict.fromkeys(("nsec", "nanosecond", "nanoseconds"), "ns"),
    },
}
# mmH2O is a conventional unit, as inH2O is: a column of water of 1000 kg/m³ under g of 9.80665.
_EXACT = {
    ("pressure", "mmH2O"): Fraction("9.80665"),
    ("pressure", "Pa"): Fraction(1),
    ("temperature", "K"): Fraction(1),
    ("time", "s"): Fraction(1),
}

_ABSOLUTE, _GAUGE, _DIFFERENTIAL = "absolute", "gauge", "differential"
_REFERENCES = {
    **dict.fromkeys(("a", "abs", "absolute"), _ABSOLUTE),
    **dict.fromkeys(("g", "gauge", "gage", "ga"), _GAUGE),
    **dict.fromkeys(("d", "diff", "differential"), _DIFFERENTIAL),
}
_WORDED = re.compile(r"^(?P<unit>.+?)[\s_]*[\s_(\[](?P<word>[a-z]+)[)\]]?$", re.IGNORECASE)
_LETTERED = re.compile(r"^(?P<unit>psi|psf|m?bar|[kMh]?Pa)(?P<word>[agd])$", re.IGNORECASE)
_BRACKETED = re.compile(r"[(\[{](?P<unit>[^()\[\]{}]+(?:\([a-z]+\))?)[)\]}]\s*$", re.IGNORECASE)
_LONGEST = 60
# pint would work 10**999999999 out: a number in a unit is the one digit of an exponent.
_NO_UNIT = re.compile(
    r"(?<![A-Za-z_0-9*^ -])\d|(?<![A-Za-z_0-9])\d[\d.eE_]|(?:\*\*|\^)[^*/]*(?:\*\*|\^)"
)


@dataclass(frozen=True)
class Conversion:
    """SI value = factor · value + offset.

    Parameters
    ----------
    factor : float
        SI units in one unit.
    offset : float
        SI value of a reading of zero: 273.15 K for degC, the reference pressure of a gauge.
    """

    factor: float = 1.0
    offset: float = 0.0

    def to_si(self, values: FloatArray) -> FloatArray:
        """Return values in SI; unchanged to the last bit where they are in it already.

        What is too large for a double there is infinite.
        """
        # Whoever converts readings looks for those that are not finite, and says where they are.
        with np.errstate(over="ignore"):
            if self.factor != 1.0:
                values = values * self.factor
            return values + self.offset if self.offset != 0.0 else values


def pressure_reference(unit: str) -> str:
    """Return what a pressure unit is taken against, as far as its name says so.

    Parameters
    ----------
    unit : str
        For example ``"psia"``, ``"bar(g)"``, ``"kPa abs"``, ``"psi"``.

    Returns
    -------
    str
        ``"absolute"``, ``"gauge"``, ``"differential"``, or ``""`` where the name leaves it open.
    """
    return _split_reference(unit)[1]


def pressure_conversion(unit: str, where: str, reference_Pa: float | None = None) -> Conversion:
    """Return what turns readings of a pressure into absolute pascals.

    Parameters
    ----------
    unit : str
        Any unit of pressure, with or without "a", "g", "abs", "gauge".
    where : str
        What to call it in an error.
    reference_Pa : float, optional
        Absolute pressure of a reading of zero; only a unit that names itself absolute needs none.

    Raises
    ------
    InputError
        When the unit is no unit of pressure, or it is open what its readings are taken against.
    """
    plain, reference = _split_reference(unit)
    factor, _ = _parsed(plain, "pressure", f"{where} unit", unit)
    if reference == _ABSOLUTE:
        if reference_Pa:
            raise InputError(
                f"{where} reference_Pa",
                expected=f'none beside the unit "{unit}", which is absolute',
                found=f"{reference_Pa:g}",
                remedy=f'write "{plain}" if its readings are taken against that pressure',
            )
        return Conversion(factor)
    if reference_Pa is None:
        raise InputError(
            f"{where} reference_Pa",
            expected=f'the absolute pressure, in Pa, that a reading of 0 "{unit}" stands for',
            found="nothing",
            remedy="the barometer for a gauge reading"
            + (f'; 0, or the unit "{_absolute(plain)}", for an absolute one' * (not reference)),
        )
    if reference == _GAUGE and reference_Pa == 0.0:
        raise InputError(
            f"{where} reference_Pa",
            expected=f'the pressure that readings in "{unit}" are taken against',
            found="0",
            remedy=f'write "{_absolute(plain)}" if they are absolute',
        )
    return Conversion(factor, reference_Pa)


def temperature_conversion(unit: str, where: str) -> Conversion:
    """Return what turns a temperature into kelvins.

    Parameters
    ----------
    unit : str
        K, degC, degF, degR or a unit that pint knows; no difference of temperatures.
    where : str
        What to call it in an error.

    Raises
    ------
    InputError
        When the unit is none of temperature, or one of differences only.
    """
    return Conversion(*_parsed(unit, "temperature", f"{where} unit", unit))


def time_conversion(unit: str, where: str) -> Conversion:
    """Return what turns a time into seconds.

    Parameters
    ----------
    unit : str
        s, ms, us, min or a unit that pint knows.
    where : str
        What to call it in an error.

    Raises
    ------
    InputError
        When the unit is none of time.
    """
    return Conversion(*_parsed(unit, "time", where, unit))


def is_count(unit: str) -> bool:
    """Tell whether a label stands for the bare codes of a converter."""
    return unit.strip().lower() in _COUNT_WORDS


def states_a_unit(label: str) -> bool:
    """Tell whether a label of a file says anything: forms leave "-" or "n/a" where they do not."""
    return label.strip().lower() not in _NO_STATEMENT


def is_unit_label(text: str) -> bool:
    """Tell whether a text is a unit, or what is written where there is none."""
    return not states_a_unit(text) or bool(kind_of_unit(text)) or _is_any_unit(text)


def kind_of_unit(unit: str) -> str:
    """Return ``"count"``, ``"pressure"``, ``"temperature"``, ``"time"``, or nothing for others."""
    if is_count(unit):
        return COUNT
    plain, _ = _split_reference(unit)
    for kind, name in (("pressure", plain), ("temperature", unit), ("time", unit)):
        if _factor_and_offset(name.strip(), kind) is not None:
            return kind
    return ""


def unit_in_brackets(name: str) -> str:
    """Return the unit of pressure, temperature or time, or the counts, that ends a column's name.

    Parameters
    ----------
    name : str
        For example ``"PT25A fwd [psia]"``.

    Returns
    -------
    str
        The text in the brackets, or nothing: ``"P25 (C)"`` names a rake, ``"T25 (C)"`` a unit.
    """
    match = _BRACKETED.search(name)
    unit = match["unit"].strip() if match is not None else ""
    if len(unit) == 1 and unit != "s" and not name.lower().startswith("t"):
        # "P25 (C)" names a rake; no unit of pressure has one letter.
        return ""
    return unit if unit and kind_of_unit(unit) else ""


def _is_any_unit(text: str) -> bool:
    if text.strip() in _DIMENSIONLESS:
        return text.strip() != "1"
    if not _is_harmless(text):
        return False
    try:
        _registry().parse_units(text)
    except Exception:
        # pint raises whatever its parser stumbles over.
        return False
    # The words of Python's floats are prefixed units to pint.
    return text.strip().lower() not in ("nan", "inf", "infinity")


def same_unit(one: str, other: str, kind: str, reference_Pa: float | None = None) -> bool:
    """Tell whether what a file states is what test.toml says.

    Parameters
    ----------
    one : str
        Label of the file.
    other : str
        Unit of test.toml.
    kind : str
        ``"pressure"``, ``"temperature"`` or ``"time"``.
    reference_Pa : float, optional
        What test.toml takes a pressure against: 0 contradicts a file that says gauge, another
        value one that says absolute.
    """
    if is_count(one) or is_count(other):
        dimensionless = one.strip().lower() in _DIMENSIONLESS
        return (is_count(one) or dimensionless) and is_count(other)
    plain, reference = _split_reference(one) if kind == "pressure" else (one, "")
    plain_other, reference_other = _split_reference(other) if kind == "pressure" else (other, "")
    try:
        if _parsed(plain, kind, "", one) != _parsed(plain_other, kind, "", other):
            return False
    except InputError:
        return False
    taken_absolute = reference_other == _ABSOLUTE or reference_Pa == 0.0
    if reference == _ABSOLUTE:
        return taken_absolute
    return not (reference and taken_absolute)


def quantity_in(text: str, kind: str, where: str) -> float:
    """Return a number with a unit, such as ``"14.7 psia"`` or ``"-0.67 degF"``, in SI.

    Parameters
    ----------
    text : str
        Number, space, unit; a pressure must say that it is absolute.
    kind : str
        ``"pressure"`` or ``"temperature"``.
    where : str
        What to call it in an error.

    Raises
    ------
    InputError
        When it is something else.
    """
    number, _, unit = text.strip().partition(" ")
    example = "7.98 psia" if kind == "pressure" else "-0.67 degF"
    expected = f'a number, or a number with a unit of {kind} as in "{example}"'
    try:
        value = float(number)
    except ValueError:
        raise InputError(where, expected=expected, found=repr(text)) from None
    plain, reference = _split_reference(unit) if kind == "pressure" else (unit, "")
    factor_and_offset = _factor_and_offset(plain, kind)
    if factor_and_offset is None:
        raise InputError(where, expected=expected, found=repr(text))
    if kind == "pressure" and reference != _ABSOLUTE:
        raise InputError(
            where,
            expected="an absolute pressure",
            found=repr(text),
            remedy=f'write "{number} {_absolute(plain)}" if it is one',
        )
    factor, offset = factor_and_offset
    return value * factor + offset


def _split_reference(unit: str) -> tuple[str, str]:
    """Return a unit of pressure without its "a" or "gauge", and what that stood for."""
    text = unit.strip()
    if len(text) > _LONGEST:
        # No unit, and the time that a match takes grows with the square of its length.
        return text, ""
    for pattern in (_LETTERED, _WORDED):
        match = pattern.match(text)
        if match is not None and match["word"].lower() in _REFERENCES:
            return match["unit"].strip(), _REFERENCES[match["word"].lower()]
    return text, ""


def _absolute(plain: str) -> str:
    return f"{plain}a" if _LETTERED.match(f"{plain}a") else f"{plain} abs"


def _is_harmless(name: str) -> bool:
    return bool(name) and len(name) <= _LONGEST and not _NO_UNIT.search(name)


@cache
def _registry() -> Any:
    import pint

    # Without a cache folder nothing is written to the user's disk.
    return pint.UnitRegistry(non_int_type=Fraction, cache_folder=None)


def _parsed(plain: str, kind: str, where: str, shown: str) -> tuple[float, float]:
    """Return factor and offset of a unit of one kind, or refuse it."""
    known = _factor_and_offset(plain, kind)
    if known is None:
        folded = {name.lower(): name for name in _COMMON[kind]}
        near = get_close_matches(plain.lower(), folded, 1)
        raise InputError(
            where,
            expected=f"a unit of {kind}, such as " + ", ".join(_COMMON[kind]),
            found=f'"{shown[:_LONGEST]}"',
            remedy=f"is '{folded[near[0]]}' meant?" if near else "",
        )
    return known


# A file may label any number of columns, each in another way.
@lru_cache(maxsize=1024)
def _factor_and_offset(plain: str, kind: str) -> tuple[float, float] | None:
    """Return what turns readings into SI, as pint's definitions have it; None for another unit."""
    name = _SPELLINGS[kind].get(plain.lower(), plain)
    if (kind, name) in _EXACT:
        return float(_EXACT[kind, name]), 0.0
    if not _is_harmless(name):
        return None
    registry = _registry()
    try:
        unit = registry.parse_units(name)
        # pint converts a difference of temperatures as if it were a temperature.
        if any(part.startswith("delta_") for part in unit._units):
            return None
        offset, one = (registry.Quantity(Fraction(n), unit).to(_SI[kind]).magnitude for n in (0, 1))
        return float(one - offset), float(offset)
    except Exception:
        # pint raises whatever its parser stumbles over, and cannot even print some of it.
        return None
