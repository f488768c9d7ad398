"""Text of at most 100 columns for the terminal: wrapped prose and aligned tables."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Sequence

__all__ = ["ROWS_PRINTED", "aligned", "wrapped"]

WIDTH = 100
# Of a long ranking the best are printed; --json holds all.
ROWS_PRINTED = 8


def aligned(lines: Sequence[tuple[str, ...]], left: Collection[str], indent: str = "") -> str:
    """Return a table, numbers to the right.

    Parameters
    ----------
    lines : sequence of tuple of str
        The heads first.
    left : collection of str
        Heads of columns of words.
    indent : str
        Before each line.
    """
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join(
        indent
        + "  ".join(
            cell.ljust(width) if head in left else cell.rjust(width)
            for head, cell, width in zip(lines[0], line, widths, strict=True)
        ).rstrip()
        for line in lines
    )


def wrapped(prose: str, later: str = "") -> list[str]:
    """Return prose as lines, those after the first behind an indent."""
    return textwrap.wrap(prose, WIDTH, subsequent_indent=later, break_on_hyphens=False)
