"""What is known of the terms beforehand: required, forbidden, or of one sign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from surge_core.errors import InputError
from surge_core.types import FloatArray, IndexArray

_WORDS = ("required", "forbidden", "positive", "negative")


@dataclass(frozen=True)
class Constraints:
    """Prior knowledge by position among the usable terms.

    Parameters
    ----------
    required : tuple of int
        Terms that every structure holds.
    signs : ndarray of shape (n_columns,)
        +1 or -1 where only that sign is possible, else 0.
    """

    required: tuple[int, ...]
    signs: FloatArray

    def allow(self, support: Sequence[int], coefficients: FloatArray) -> bool:
        """Return whether the coefficients of a structure have the signs asked for."""
        return bool(np.all(self.signs[list(support)] * coefficients >= 0.0))


def constraints_of(
    wishes: Mapping[str, str] | None, names: Sequence[str], usable: IndexArray
) -> tuple[IndexArray, Constraints]:
    """Read a user's constraints.

    Parameters
    ----------
    wishes : mapping of str to str, or None
        For the name of a term one or two of "required", "forbidden", "positive", "negative",
        separated by a space.
    names : sequence of str
        Names of all terms.
    usable : ndarray of int
        Positions of those that the data can separate.

    Returns
    -------
    columns : ndarray of int
        The usable terms without the forbidden ones.
    constraints : Constraints
        By position among these.

    Raises
    ------
    InputError
        For an unknown term or word, a contradiction, or a required term that the data cannot
        separate from others.
    """
    asked = {name: set(str(text).split()) for name, text in dict(wishes or {}).items()}
    for name, words in asked.items():
        clash = {"required", "forbidden"} <= words or {"positive", "negative"} <= words
        if name not in names or not words or not words <= set(_WORDS) or clash:
            raise InputError(
                f"constraints[{name!r}]",
                expected=f"for a term among {', '.join(names)} one of {', '.join(_WORDS)}, or two "
                "that agree",
                found=" ".join(sorted(words)) or "nothing",
            )
    forbidden = {names.index(name) for name, words in asked.items() if "forbidden" in words}
    columns = np.array([i for i in usable if int(i) not in forbidden], dtype=np.intp)
    position = {names[int(i)]: number for number, i in enumerate(columns)}
    required, signs = [], np.zeros(columns.size)
    for name, words in asked.items():
        if name in position:
            required += [position[name]] * ("required" in words)
            signs[position[name]] = ("positive" in words) - float("negative" in words)
        elif "required" in words:
            raise InputError(
                "constraints",
                expected=f"{name!r} to be separable from the other terms by the data",
                found="a term that is zero or a sum of others over this record",
                remedy="forbid one of those, or leave the requirement out",
            )
    return columns, Constraints(tuple(sorted(required)), signs)
