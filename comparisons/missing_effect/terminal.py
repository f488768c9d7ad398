"""A diagnosis on the terminal, in at most 100 columns; tables may be wider."""

from __future__ import annotations

import textwrap
from typing import Any

from comparisons.missing_effect.report import diagnosis_parts
from comparisons.missing_effect.results import Diagnosis
from comparisons.page.blocks import Block, Bullets, Part, Table, Words
from surge_core.display import Grid

WIDTH = 100


def diagnosis_text(d: Diagnosis, *, limits: Any = None, separation: Any = None) -> str:
    """Return all that a reader needs as text.

    Parameters
    ----------
    d : Diagnosis
        Of a lag or of a user's model.
    limits, separation : object, optional
        With ``lines``: what would have been named, and what would tell an alias set apart.
    """
    first, *others = diagnosis_parts(d, limits=limits, separation=separation, brief=True)
    verdict = [f"VERDICT: {d.verdict}", *(line for b in first.blocks for line in _printed(b))]
    paragraphs = [verdict, *(lines for part in others for lines in _paragraphs(part))]
    return "\n\n".join(map("\n".join, paragraphs))


def _paragraphs(part: Part) -> list[list[str]]:
    """Return the lines of each block; lists and small print go on with what is above them."""
    # A table has a title of its own, a sentence needs none.
    out = [[part.title]] if _goes_on(part.blocks[0]) else []
    for block in part.blocks:
        if _goes_on(block):
            out[-1] += _printed(block)
        else:
            out.append(_printed(block))
    return out


def _goes_on(block: Block) -> bool:
    return isinstance(block, Bullets) or getattr(block, "tone", "") in ("quiet", "code")


def _printed(block: Block) -> list[str]:
    if isinstance(block, Bullets):
        return [line for item in block.items for line in _wrapped(f"  {item}", "    ")]
    if isinstance(block, Table):
        words = frozenset(i for i, head in enumerate(block.heads) if not head.numeric)
        rows = tuple(tuple(map(str, row)) for row in block.rows)
        grid = Grid(block.caption, tuple(head.text for head in block.heads), rows, words)
        return [grid.title, *(f"  {line}" for line in grid.lines())]
    assert isinstance(block, Words)
    if block.tone != "code":
        return _wrapped(block.text)
    # A line may be indented, as one of a table is.
    lines = [(line, len(line) - len(line.lstrip())) for line in block.text.split("\n")]
    return [out for line, indent in lines for out in _wrapped(line, " " * (indent + 2))]


def _wrapped(prose: str, later: str = "") -> list[str]:
    return textwrap.wrap(prose, WIDTH, subsequent_indent=later, break_on_hyphens=False)
