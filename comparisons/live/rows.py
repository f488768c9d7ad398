"""What a decoder makes of the bytes of a feed."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surge_core.types import FloatArray

__all__ = ["Decoder", "End", "Header", "Item", "Rows", "Tally", "Units"]


@dataclass(frozen=True)
class Header:
    """The names of the columns, with which every connection begins.

    Parameters
    ----------
    names : tuple of str
        In the order of the values.
    """

    names: tuple[str, ...]


@dataclass(frozen=True)
class Units:
    """The units of the columns, where the line below the header states them.

    Parameters
    ----------
    labels : tuple of str
        In the order of the values.
    line : bytes
        That line, without its end.
    """

    labels: tuple[str, ...]
    line: bytes


@dataclass(frozen=True)
class Rows:
    """Rows as numbers and as the lines of CSV that stand for exactly these numbers.

    Parameters
    ----------
    values : ndarray of shape (n, n_columns)
        All columns, in the order of the header.
    lines : tuple of bytes
        One line a row, without its end.
    """

    values: FloatArray
    lines: tuple[bytes, ...]

    def __len__(self) -> int:
        return len(self.lines)

    def part(self, rows: slice) -> Rows:
        """Return rows that follow one another."""
        return Rows(self.values[rows], self.lines[rows])

    def those(self, keep: NDArray[np.bool_]) -> Rows:
        """Return the rows that are marked."""
        lines = tuple(self.lines[row] for row in np.flatnonzero(keep))
        return Rows(self.values[keep], lines)

    @staticmethod
    def joined(parts: list[Rows]) -> Rows:
        """Return several rows one behind the other."""
        if len(parts) == 1:
            return parts[0]
        values = np.concatenate([part.values for part in parts])
        return Rows(values, tuple(line for part in parts for line in part.lines))


@dataclass(frozen=True)
class End:
    """The sender says that the run is over."""


Item: TypeAlias = Header | Units | Rows | End


@dataclass
class Tally:
    """What was refused of a feed, counted by reason.

    Parameters
    ----------
    refused : Counter of str
        Lines or frames by the reason why they were left out.
    remedies : dict of str to str
        By such a reason what was found the first time and how to mend it, where that is known.
    """

    refused: Counter[str] = field(default_factory=Counter)
    remedies: dict[str, str] = field(default_factory=dict)

    def refuse(self, why: str, count: int = 1, remedy: str = "") -> None:
        """Count something that is left out."""
        self.refused[why] += count
        if remedy:
            self.remedies.setdefault(why, remedy)

    @property
    def total(self) -> int:
        """How many were left out."""
        return sum(self.refused.values())


class Decoder(Protocol):
    """Turns the bytes of one connection, however they are cut, into header, rows and end."""

    def feed(self, data: bytes) -> list[Item]:
        """Return what is complete by now."""

    def close(self) -> None:
        """Count what the end of the connection cut off."""
