"""What a page is made of: parts that hold words, lists, tables and pictures."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from surge_core.display import Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Letters of a word that a printed column holds, and of a cell that stays in one line.
LONGEST_WORD, LONGEST_LINE = 26, 30
# Columns beyond which a table is set smaller, and beyond which its numbers are broken in print.
MANY_COLUMNS, MOST_COLUMNS = 7, 16


@dataclass(frozen=True)
class Words:
    """A paragraph.

    Parameters
    ----------
    text : str
        Plain text; the template escapes it.
    tone : {"plain", "quiet", "caution", "code", "heading"}
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
    zero : str
        The word in this column that is sorted as a zero; empty for none.
    """

    text: str
    meaning: str = ""
    numeric: bool = False
    prose: bool = False
    zero: str = ""

    def style_of(self, cell: str | Cell) -> str:
        """Return the classes of a cell: one that is long, or holds a long word, may be broken.

        Parameters
        ----------
        cell : str or Cell
            The cell, or the text of the head itself.
        """
        text = cell if isinstance(cell, str) else f"{cell.text} {cell.small}"
        kind = "numeric" if self.numeric else "prose" if self.prose else "short"
        wrapped = " wrapped" if not self.numeric and len(text) > LONGEST_LINE else ""
        long = " long" if any(len(word) > LONGEST_WORD for word in text.split()) else ""
        return kind + wrapped + long


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
        A class for each row: ``"failed"``, ``"best"`` (the row to look at first) or empty.
    """

    kind: ClassVar[str] = "table"
    caption: str
    heads: tuple[Head, ...]
    rows: tuple[tuple[str | Cell, ...], ...]
    marks: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        grid: Grid,
        *,
        caption: str = "",
        meanings: Mapping[str, str] | None = None,
        prose: Collection[str] = (),
        zero: str = "",
    ) -> Table:
        """Return a grid as a table of a page: what is no column of words is one of numbers.

        Parameters
        ----------
        grid : Grid
            Its cells; the marked row is the best.
        caption : str
            In place of the grid's title.
        meanings : mapping of str to str, optional
            What each column says, by its head.
        prose : collection of str
            Heads of the columns of sentences.
        zero : str
            The word that is sorted as a zero among numbers.
        """
        heads = tuple(
            Head(
                text,
                (meanings or {}).get(text, ""),
                column not in grid.words,
                text in prose,
                zero if column not in grid.words else "",
            )
            for column, text in enumerate(grid.header)
        )
        marks = tuple("best" if row == grid.marked else "" for row in range(len(grid.rows)))
        return cls(caption or grid.title, heads, grid.rows, marks)

    @property
    def sortable(self) -> bool:
        """Whether its rows may change places: not where one goes on with the row above it."""
        leads = [row[0] if isinstance(row[0], str) else row[0].text for row in self.rows]
        return len(self.rows) > 1 and all(leads)

    @property
    def style(self) -> str:
        """Classes of the table in the page."""
        columns = len(self.heads)
        kinds = (
            ("sortable", self.sortable),
            ("wide", columns > MANY_COLUMNS),
            ("widest", columns > MOST_COLUMNS),
        )
        return " ".join(name for name, holds in kinds if holds)

    def mark(self, row: int) -> str:
        """Return the class of a row."""
        return self.marks[row] if row < len(self.marks) else ""


@dataclass(frozen=True)
class Picture:
    """A picture with the sentences that say what it shows.

    Parameters
    ----------
    title : str
        What it is.
    figure : Figure
        The drawing.
    alt : str
        What it shows, in numbers: below the picture, and for those who cannot see it.
    reading : str
        How to read it.
    """

    kind: ClassVar[str] = "picture"
    title: str
    figure: Figure
    alt: str
    reading: str

    @property
    def uri(self) -> str:
        """The image as a data URI; drawn each time it is asked for."""
        from comparisons.page.style import figure_to_data_uri

        return figure_to_data_uri(self.figure)


@dataclass(frozen=True)
class Summary:
    """The first screen of a section: a line, questions with their answers, and a picture.

    The first answer is set large; the picture stands beside the answers, or below them on a narrow
    screen.
    """

    kind: ClassVar[str] = "summary"
    line: str
    items: tuple[tuple[str, str], ...]
    picture: Picture | None


Block = Words | Bullets | Table | Picture | Summary


@dataclass(frozen=True)
class Part:
    """A part of a section.

    Parameters
    ----------
    title : str
        Its heading; without one the blocks stand below the heading of the section.
    blocks : tuple of Block
        What it holds, in order.
    folded : bool
        Whether the page shows its heading alone until it is opened.
    """

    title: str
    blocks: tuple[Block, ...]
    folded: bool = False

    @classmethod
    def together(cls, title: str, parts: Iterable[Part]) -> Part:
        """Return parts as one, the title of each a heading in it.

        Parameters
        ----------
        title : str
            Its heading.
        parts : iterable of Part
            In order.
        """
        pairs = [(Words(part.title, "heading"), *part.blocks) for part in parts]
        return cls(title, tuple(block for blocks in pairs for block in blocks))

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """Its pictures."""
        own = (b.picture if isinstance(b, Summary) else b for b in self.blocks)
        return tuple(block for block in own if isinstance(block, Picture))
