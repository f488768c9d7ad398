"""Typed look-ups in a TOML table that answer a mistake with file, table and key."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from math import isfinite
from typing import Any

from classic_ml.readers.toml_file import shown
from classic_ml.units import quantity_in
from surge_core.errors import InputError

__all__ = ["Table"]

_KINDS = {"Pa": "pressure", "K": "temperature"}


class Table:
    """One table of a TOML file; remembers which keys were asked for.

    Parameters
    ----------
    file : str
        The file, for errors.
    path : str
        Dotted name of the table, empty for the file's top.
    values : mapping
        The parsed table.
    keys : iterable of str
        Keys that such a table may hold, as far as they are known beforehand: they are listed when
        another is found, and never taken for a misspelling of each other.
    """

    def __init__(
        self, file: str, path: str, values: Mapping[str, Any], keys: Iterable[str] = ()
    ) -> None:
        self.file = file
        self.path = path
        self._values = values
        self._asked: set[str] = set()
        self._keys = frozenset(keys)

    @property
    def where(self) -> str:
        """The table, for errors: file and name."""
        return f"{self.file}: [{self.path}]" if self.path else self.file

    def error(self, key: str, expected: str, found: str, remedy: str = "") -> InputError:
        """Return an InputError that names file, table and key."""
        table = f" [{self.path}]" if self.path else ""
        return InputError(
            f"{self.file}:{table} {key}", expected=expected, found=found, remedy=remedy
        )

    def __iter__(self) -> Iterator[str]:
        """Iterate over the keys in file order."""
        return iter(self._values)

    def __contains__(self, key: object) -> bool:
        """Tell whether the table holds a key, which counts as asking for it."""
        self._asked.add(str(key))
        return key in self._values

    def table(self, key: str, keys: Iterable[str] = ()) -> Table:
        """Return a table inside this one, which may hold ``keys``."""
        path = f"{self.path}.{key}" if self.path else key
        if key not in self._values:
            raise InputError(self.file, expected=f"a table [{path}]", found="none")
        self._asked.add(key)
        values = self._values[key]
        if not isinstance(values, Mapping):
            raise self.error(key, f"a table [{path}]", shown(values))
        return Table(self.file, path, values, keys)

    def _get(self, key: str, expected: str) -> Any:
        self._asked.add(key)
        if key not in self._values:
            strange = [k for k in self._values if k not in self._asked | self._keys]
            near = get_close_matches(key, strange, 1)
            raise self.error(key, expected, "nothing", f"is '{near[0]}' meant?" if near else "")
        return self._values[key]

    def number(
        self,
        key: str,
        *,
        above: float | None = None,
        below: float | None = None,
        least: float | None = None,
        most: float | None = None,
        default: float | None = None,
        unit: str = "",
        remedy: str = "",
    ) -> float:
        """Return a finite number inside its bounds (``above``, ``below`` exclusive).

        ``unit`` and ``remedy`` go into the sentence that refuses another value. Where the unit is
        Pa or K, a text such as "7.98 psia" or "-0.67 degF" is a number too.
        """
        self._asked.add(key)
        if default is not None and key not in self._values:
            return default
        bounds = [
            f"{word} {bound:g}"
            for word, bound in (
                ("above", above),
                ("below", below),
                ("at least", least),
                ("at most", most),
            )
            if bound is not None
        ]
        what = f"a number in {unit}" if unit else "a number"
        expected = f"{what} {' and '.join(bounds)}".strip()
        value = self._get(key, expected)
        if isinstance(value, str) and unit in _KINDS:
            value = quantity_in(value, _KINDS[unit], f"{self.where} {key}")
        if not _is_finite(value):
            raise self.error(key, expected, shown(value))
        outside = (
            (above is not None and value <= above)
            or (below is not None and value >= below)
            or (least is not None and value < least)
            or (most is not None and value > most)
        )
        if outside:
            raise self.error(key, expected, f"{value:g}", remedy)
        return float(value)

    def number_or(self, key: str, word: str, *, default: float) -> float | None:
        """Return a positive number, or None where the file holds ``word``."""
        self._asked.add(key)
        if self._values.get(key) == word:
            return None
        if isinstance(self._values.get(key), str):
            raise self.error(key, f'a number above 0 or "{word}"', shown(self._values[key]))
        return self.number(key, above=0.0, default=default)

    def whole(self, key: str, *, least: int, most: int) -> int:
        """Return a whole number."""
        expected = f"a whole number from {least} to {most}"
        value = self._get(key, expected)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise self.error(key, expected, shown(value))
        return int(value)

    def text(self, key: str) -> str:
        """Return a text that is not empty."""
        value = self._get(key, "a text")
        if not isinstance(value, str) or not value.strip():
            raise self.error(key, "a text", shown(value))
        if not value.isprintable():
            raise self.error(key, "a text of one line, without control characters", shown(value))
        return value

    def choice(self, key: str, choices: Sequence[str | int]) -> str | int:
        """Return one of a few values."""
        expected = " or ".join(repr(c) for c in choices).replace("'", '"')
        value = self._get(key, expected)
        if isinstance(value, bool) or value not in choices:
            raise self.error(key, expected, shown(value).replace("'", '"'))
        return choices[list(choices).index(value)]

    def interval(self, key: str) -> tuple[float, float]:
        """Return a range [low, high]."""
        expected = "a range [low, high] of two numbers"
        value = self._get(key, expected)
        numbers = isinstance(value, list) and len(value) == 2 and all(map(_is_finite, value))
        if not numbers or value[0] >= value[1]:
            raise self.error(key, expected, shown(value))
        return float(value[0]), float(value[1])

    def finish(self) -> None:
        """Refuse keys that nobody asked for: a misspelt option must not be ignored."""
        allowed = sorted(self._asked | self._keys)
        for key in self._values:
            if key not in allowed:
                known = get_close_matches(key, allowed, 1)
                raise self.error(
                    key,
                    "only " + ", ".join(allowed),
                    f"'{key}'",
                    f"is '{known[0]}' meant?" if known else "",
                )


def _is_finite(value: object) -> bool:
    """Tell whether a value is a number; TOML's true and false are ints to Python."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return isfinite(value)
    except OverflowError:
        # A whole number beyond all floats.
        return False
