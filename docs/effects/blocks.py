"""The blocks of a page that a script writes: found by their marks, replaced, compared."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

__all__ = ["blocks_of", "bounds_of", "table", "with_blocks"]

_BLOCK = re.compile(r"^% made: (\w+)\n(.*?)^% end\n", re.MULTILINE | re.DOTALL)
# Beyond this a bound only keeps a search within the machine's numbers.
NO_BOUND = 1e300


def blocks_of(page: Path) -> dict[str, str]:
    """Return the text of each block that a page has, by its name.

    Parameters
    ----------
    page : path
        A Markdown file with blocks between ``% made: NAME`` and ``% end``.
    """
    return {found[1]: found[2].strip() for found in _BLOCK.finditer(page.read_text("utf-8"))}


def with_blocks(text: str, made: Mapping[str, str]) -> str:
    """Return a page's text with blocks replaced; what is not in ``made`` stays.

    Parameters
    ----------
    text : str
        The page.
    made : mapping of str to str
        New blocks by name.
    """

    def put(found: re.Match[str]) -> str:
        own = made.get(found[1])
        return found[0] if own is None else f"% made: {found[1]}\n\n{own}\n\n% end\n"

    return _BLOCK.sub(put, text)


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown.

    Parameters
    ----------
    heads : sequence of str
        One a column.
    rows : sequence of sequence of str
        The cells.
    """
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in x) + " |" for x in lines
    )


def bounds_of(low: float, high: float) -> str:
    """Return bounds in words.

    Parameters
    ----------
    low, high : float
        Infinite where there is none.
    """
    if abs(low) > NO_BOUND and abs(high) > NO_BOUND:
        return "any"
    if abs(high) > NO_BOUND:
        return f"from {_number(low)} on"
    return f"{_number(low)} to {_number(high)}"


def _number(value: float) -> str:
    return f"{value:g}".replace("-", "−").replace("e+0", "e")
