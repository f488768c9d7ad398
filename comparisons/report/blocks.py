"""What a report is made of: parts that hold words, lists, tables and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

__all__ = ["Block", "Bullets", "Cell", "Head", "Part", "Picture", "Table", "Words"]


@dataclass(frozen=True)
class Words:
    """A paragraph.

    Parameters
    ----------
    text : str
        Plain text; the template escapes it.
    tone : {"plain", "quiet", "caution", "code"}
        How it is set.
    """

    kind: ClassVar[str] = "words"
    text: str
    tone: str = "plain"


@dataclass(frozen=True)
class Bullets:
    """A list.

    Parameters
    ----------
    items : tuple of str
        Plain text.
    tone : {"plain", "caution"}
        How it is set.
    heading : str
        A line above; may be empty.
    """

    kind: ClassVar[str] = "bullets"
    items: tuple[str, ...]
    tone: str = "plain"
    heading: str = ""


@dataclass(frozen=True)
class Head:
    """The head of a column.

    Parameters
    ----------
    text, meaning : str
        What it is called and what it says.
    numeric, prose : bool
        Whether its cells are numbers, or sentences that need room.
    """

    text: str
    meaning: str = ""
    numeric: bool = False
    prose: bool = False

    @property
    def style(self) -> str:
        """Class of its cells in the page."""
        return "numeric" if self.numeric else "prose" if self.prose else "short"


@dataclass(frozen=True)
class Cell:
    """A cell with small print below it.

    Parameters
    ----------
    text, small : str
        What it says, and the small print.
    """

    text: str
    small: str


@dataclass(frozen=True)
class Table:
    """A table.

    Parameters
    ----------
    caption : str
        What it shows.
    heads : tuple of Head
        Its columns.
    rows : tuple of tuple of str or Cell
        Its cells.
    marks : tuple of str
        A class for each row: ``"failed"``, ``"best"`` or empty.
    """

    kind: ClassVar[str] = "table"
    caption: str
    heads: tuple[Head, ...]
    rows: tuple[tuple[str | Cell, ...], ...]
    marks: tuple[str, ...] = ()

    def mark(self, row: int) -> str:
        """Return the class of a row."""
        return self.marks[row] if row < len(self.marks) else ""


@dataclass(frozen=True)
class Picture:
    """A picture.

    Parameters
    ----------
    title : str
        What it is.
    uri : str
        The image as a data URI.
    alt : str
        What it shows, for those who cannot see it.
    reading : str
        How to read it.
    """

    kind: ClassVar[str] = "picture"
    title: str
    uri: str
    alt: str
    reading: str


Block = Words | Bullets | Table | Picture


@dataclass(frozen=True)
class Part:
    """A part of a section.

    Parameters
    ----------
    title : str
        Its heading.
    blocks : tuple of Block
        What it holds, in order.
    """

    title: str
    blocks: tuple[Block, ...]
