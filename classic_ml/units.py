"""Units at the boundary: what a file or test.toml states, as one multiply-add to SI.

Inside the packages a pressure is in Pa, a temperature in K and a time in s. The factors are pint's
definitions in exact fractions, rounded once.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, lru_cache
from typing import Any

import numpy as np

from surge_core.errors import InputError
from surge_core.types import FloatArray

COUNT = "count"
_COUNT_WORDS = ("count", "counts", "code", "codes", "adc counts", "raw counts", "lsb", "1")
# Labels that state nothing: a form's empty field.
_NO_STATEMENT = ("", "-", "--", "n/a", "na", "none", "unknown")
_SI = {"pressure": "Pa", "temperature": "K", "time": "s"}
COMMON_UNITS = {
    "pressure": "Pa, hPa, kPa, MPa, mbar, bar, psi, psf, atm, torr, mmHg, inHg, mmH2O, inH2O",
    "temperature": "K, degC, degF, degR",
    "time": "s, ms, us, ns, min",
}
# Units of the trade that pint has not.
_DEFINED = {"psf": "pound_force / foot**2", "mmH2O": "kgf / meter**2"}
_TEMPERATURE = re.compile(
    r"(?:deg(?:ree)?s?[ _]?|° ?)?(?P<letter>[cfrk])(?:elsius|ahrenheit|ankine|elvins?)?",
    re.IGNORECASE,
)
_WORDED = re.compile(
    r"(?P<unit>.+?)[\s_]*[\s_(\[](?:(?P<absolute>a|abs|absolute)|g|ga|gage|gauge|d|diff)[)\]]?",
    re.IGNORECASE,
)
_LETTERED = re.compile(r"(?P<unit>psi|psf|m?bar|[kMh]?Pa)(?:(?P<absolute>a)|g|d)", re.IGNORECASE)
# pint works numbers out, however large: one digit in an exponent is all that a unit has of them.
_PLAIN = re.compile(r"(?!.*\d\d)(?!.*(\*\*|\^).*(\*\*|\^))[^\d].{0,39}")


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
        """Return values in SI; what is too large for a double there is infinite."""
        if self == Conversion():
            return values
        with np.errstate(over="ignore"):
            return np.asarray(values * self.factor + self.offset)


def conversion_to_si(
    unit: str, kind: str, where: str, reference_Pa: float | None = None
) -> Conversion:
    """Return what turns readings into absolute pascals, kelvins, seconds or counts.

    Parameters
    ----------
    unit : str
        A unit that pint knows or the trade writes; a pressure with or without "a", "g", "abs",
        "gauge".
    kind : str
        ``"pressure"``, ``"temperature"`` (no difference of them), ``"time"`` or ``"count"``.
    where : str
        What to call the unit in an error; empty for the keys ``unit`` and ``reference_Pa``.
    reference_Pa : float, optional
        Absolute pressure of a reading of zero; only a pressure that names itself absolute needs
        none.

    Raises
    ------
    InputError
        When the unit is of another kind, or it is open what a pressure is taken against.
    """
    if kind == COUNT:
        return Conversion()
    plain, reference = split_reference(unit) if kind == "pressure" else (unit, "")
    known = _to_si(plain.strip(), kind)
    if known is None:
        expected = f"a unit of {kind}, such as {COMMON_UNITS[kind]}"
        raise InputError(where or "unit", expected=expected, found=f'"{unit[:60]}"')
    is_absolute = reference == "absolute"
    if kind != "pressure" or (is_absolute and not reference_Pa):
        return Conversion(*known)
    if is_absolute or reference_Pa is None or (reference == "gauge" and reference_Pa == 0.0):
        what = (
            "none" if is_absolute else "the absolute pressure in Pa that a reading of 0 stands for"
        )
        raise InputError(
            where or "reference_Pa",
            expected=f'{what}, beside the unit "{unit}"',
            found="nothing" if reference_Pa is None else f"{reference_Pa:g}",
            remedy=f'write "{plain} abs" as the unit of absolute readings, the barometer as the '
            "reference of gauge readings",
        )
    return Conversion(known[0], reference_Pa)


def kind_of_unit(unit: str) -> str:
    """Return ``"count"``, ``"pressure"``, ``"temperature"``, ``"time"``, or nothing for others."""
    if unit.strip().lower() in _COUNT_WORDS:
        return COUNT
    plain, _ = split_reference(unit)
    kinds = {"pressure": plain, "temperature": unit.strip(), "time": unit.strip()}
    # pint, which takes half a second to load, is asked for uncommon units alone.
    common = [kind for kind, name in kinds.items() if name in COMMON_UNITS[kind].split(", ")]
    others = (kind for kind, name in kinds.items() if _to_si(name, kind) is not None)
    return next(iter(common), "") or next(others, "")


def same_unit(one: str, other: str, reference_Pa: float | None = None) -> bool:
    """Return whether what a file states is what test.toml says.

    Parameters
    ----------
    one : str
        Label of the file; one that states nothing ("-", "n/a") contradicts nothing.
    other : str
        Unit of test.toml.
    reference_Pa : float, optional
        What test.toml takes a pressure against: 0 contradicts a file that says gauge, another
        value one that says absolute.
    """
    kind = kind_of_unit(other)
    if one.strip().lower() in _NO_STATEMENT or kind == COUNT == kind_of_unit(one):
        return True
    if kind != "pressure":
        return kind in _SI and _to_si(one.strip(), kind) == _to_si(other.strip(), kind)
    (plain, reference), (plain_other, reference_other) = map(split_reference, (one, other))
    if _to_si(plain, kind) != _to_si(plain_other, kind):
        return False
    is_absolute = reference_other == "absolute" or reference_Pa == 0.0
    return not reference or (reference == "absolute") == is_absolute


def split_reference(unit: str) -> tuple[str, str]:
    """Return a unit of pressure without its "a" or "gauge", and what that stood for.

    Parameters
    ----------
    unit : str
        For example ``"psia"``, ``"bar(g)"``, ``"kPa abs"``, ``"psi"``.

    Returns
    -------
    plain : str
        The unit alone.
    reference : str
        ``"absolute"``; ``"gauge"``, also for a differential reading; ``""`` where it is open.
    """
    # The time that a match takes grows with the square of the length.
    text = unit.strip()[:60]
    match = _LETTERED.fullmatch(text) or _WORDED.fullmatch(text)
    if match is None:
        return text, ""
    return match["unit"].strip(), "absolute" if match["absolute"] else "gauge"


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(non_int_type=Fraction, cache_folder=None)


# A file may label any number of columns, each in another way.
@lru_cache(maxsize=1024)
def _to_si(plain: str, kind: str) -> tuple[float, float] | None:
    """Return factor and offset to SI, as pint's definitions have it; None for another unit."""
    name = _pint_name(plain, kind)
    if name == _SI[kind]:
        return 1.0, 0.0
    if not _PLAIN.fullmatch(name):
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


def _pint_name(plain: str, kind: str) -> str:
    """Return pint's name of a unit that the trade spells in its own way."""
    match = _TEMPERATURE.fullmatch(plain) if kind == "temperature" else None
    if match is not None:
        # Alone, R is pint's gas constant, C its coulomb, F its farad.
        letter = match["letter"].upper()
        return "K" if letter == "K" else f"deg{letter}"
    # Capitals are no matter but between MPa and mPa.
    common = {name.lower(): name for name in COMMON_UNITS[kind].split(", ") if name != "MPa"}
    name = common.get(re.sub(r"[\s.]", "", plain).lower(), plain)
    # lbf/in2 is lbf/in^2.
    return _DEFINED.get(name, re.sub(r"(?<=[A-Za-z])2\b", "^2", name))
