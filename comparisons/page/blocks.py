"""What a page is made of: parts that hold words, lists, tables and pictures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from comparisons.page import style
from surge_core.display import Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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

    items: tuple[str, ...]
    tone: str = "plain"
    heading: str = ""


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

    title: str
    figure: Figure
    alt: str
    reading: str

    @property
    def uri(self) -> str:
        """The image as a data URI; drawn each time it is asked for."""
        return style.figure_to_data_uri(self.figure)


@dataclass(frozen=True)
class Summary:
    """The first screen of a section: a line, questions with their answers, and a picture.

    The first answer is set large; the picture stands beside the answers, or below them on a narrow
    screen.
    """

    line: str
    items: tuple[tuple[str, str], ...]
    picture: Picture | None


Block = Words | Bullets | Grid | Picture | Summary


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
