"""Errors that name what was found wrong and how to mend it."""

from __future__ import annotations

from functools import partial


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
        How to mend it; may be empty.
    """

    def __init__(self, where: str, *, expected: str, found: str, remedy: str = "") -> None:
        self.where = where
        self.expected = expected
        self.found = found
        self.remedy = remedy
        super().__init__(self.sentence())

    def sentence(self) -> str:
        """Return the whole message as one sentence."""
        text = f"{self.where}: expected {self.expected}, found {self.found}"
        return f"{text}; {self.remedy}" if self.remedy else text

    def __reduce__(self) -> tuple[object, ...]:
        """Survive pickling (worker processes), which plain keyword arguments would not."""
        named = {"expected": self.expected, "found": self.found, "remedy": self.remedy}
        return (partial(InputError, self.where, **named), ())
