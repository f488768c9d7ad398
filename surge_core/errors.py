"""Errors that name what was found wrong and how to correct it, and checks of parameters."""

from __future__ import annotations

import math
from functools import partial
from numbers import Integral, Real


def one_of(name: str, value: object, allowed: tuple[object, ...]) -> None:
    """Refuse a value that is not one of those allowed."""
    if value not in allowed:
        raise InputError(
            name, expected="one of " + ", ".join(repr(a) for a in allowed), found=repr(value)
        )


def positive(name: str, value: object) -> None:
    """Refuse a value that is not a positive, finite number."""
    if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 < float(value) < math.inf:
        raise InputError(name, expected="a positive number", found=repr(value))


def whole_number(name: str, value: object, low: int, high: int) -> None:
    """Refuse a value that is not a whole number in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, Integral) or not low <= int(value) <= high:
        raise InputError(name, expected=f"a whole number from {low} to {high}", found=repr(value))


def require(good: bool, where: str, expected: str, found: str, remedy: str = "") -> None:
    """Refuse input in which something is not good."""
    if not good:
        raise InputError(where, expected=expected, found=found, remedy=remedy)


class InputError(ValueError):
    """Input that cannot be used, in one sentence a user can act on.

    Parameters
    ----------
    where : str
        The file, channel, column or parameter at fault.
    expected : str
        What was expected there.
    found : str
        What was found instead.
    remedy : str
        How to correct it; may be empty.
    """

    def __init__(self, where: str, *, expected: str, found: str, remedy: str = "") -> None:
        self.where = where
        self.expected = expected
        self.found = found
        self.remedy = remedy
        text = f"{where}: expected {expected}, found {found}"
        super().__init__(f"{text}; {remedy}" if remedy else text)

    def __reduce__(self) -> tuple[object, ...]:
        """Survive pickling (worker processes), which plain keyword arguments would not."""
        named = {"expected": self.expected, "found": self.found, "remedy": self.remedy}
        return (partial(InputError, self.where, **named), ())
