"""What a claim of the paper is, how it is checked, and the claims as JSON, text and table."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from comparisons.page.blocks import Cell, Head, Table
from comparisons.paper.instabilities import Instabilities

__all__ = [
    "Check",
    "Claim",
    "Finding",
    "claims_block",
    "claims_json",
    "claims_table",
    "reading",
]

WIDTH = 118
# Number, claim, kind, stated, found, holds; two spaces between.
COLUMNS = (2, 44, 11, 17, 29, 5)
HEADINGS = ("", "claim of the paper", "kind", "stated", "found", "holds")


class Finding(NamedTuple):
    """What the check of a claim gave.

    ``found`` is the number or the words; ``holds`` is None where the claim holds if that is what
    is stated; ``how`` says how it was tested and what else was seen.
    """

    found: float | str
    holds: bool | None
    how: str


Check: TypeAlias = Callable[[Instabilities], Finding]


def reading(read: Callable[[Instabilities], float | str], how: str) -> Check:
    """Return the check of a claim that only reads back how the rig was made.

    Parameters
    ----------
    read : callable
        Takes the runs, returns what the setting is.
    how : str
        Where it was read.
    """
    return lambda runs: Finding(read(runs), None, how)


@dataclass(frozen=True)
class Claim:
    """One claim of the paper beside what was found.

    Parameters
    ----------
    id : int
        Its number in the list of claims.
    section : str
        Where in the paper.
    claim : str
        The claim in one sentence.
    kind : {"conformance", "built in", "tested"}
        What its check is worth: the code does as the paper says it did; the rig was made so; or
        it comes from simulated counts and could have come out otherwise.
    stated, found : float or str
        The number the paper states and the one found, or words where it states none.
    holds : bool
        Whether it holds.
    how : str
        How it was tested, and what else was seen.
    unit : str
        Unit of the numbers.
    """

    id: int
    section: str
    claim: str
    kind: str
    stated: float | str
    found: float | str
    holds: bool
    how: str
    unit: str = ""


def claims_json(claims: Sequence[Claim]) -> list[dict[str, Any]]:
    """Return the rows of ``reproduce --json``: id, claim, kind, stated, found, holds.

    Parameters
    ----------
    claims : sequence of Claim
        Checked claims.
    """
    return [
        {
            "id": claim.id,
            "claim": claim.claim,
            "kind": claim.kind,
            "stated": _plain(claim.stated),
            "found": _plain(claim.found),
            "holds": claim.holds,
        }
        for claim in claims
    ]


def _plain(value: float | str) -> float | str | None:
    return value if isinstance(value, str) or math.isfinite(value) else None


def claims_table(claims: Sequence[Claim]) -> str:
    """Return the claims as a table for a terminal, those that do not hold with their reasons.

    Parameters
    ----------
    claims : sequence of Claim
        Checked claims.
    """
    lines = [_row(HEADINGS), "─" * WIDTH]
    section = ""
    for claim in claims:
        if claim.section != section:
            section = claim.section
            lines.append(section)
        lines += _lines(claim)
    failed = [claim for claim in claims if not claim.holds]
    lines += ["", f"{len(claims) - len(failed)} of {len(claims)} claims hold."]
    for claim in failed:
        text = f"{claim.id} does not hold. Tested: {claim.how}."
        lines += textwrap.wrap(text, WIDTH, subsequent_indent="   ", break_on_hyphens=False)
    return "\n".join(lines)


def _lines(claim: Claim) -> list[str]:
    """Return the wrapped lines of one claim."""
    cells = (
        str(claim.id),
        claim.claim,
        claim.kind,
        _shown(claim.stated, claim.unit),
        _shown(claim.found, claim.unit),
        "yes" if claim.holds else "NO",
    )
    wrapped = [
        textwrap.wrap(text, width, break_on_hyphens=False) or [""]
        for text, width in zip(cells, COLUMNS, strict=True)
    ]
    height = max(len(cell) for cell in wrapped)
    padded = [cell + [""] * (height - len(cell)) for cell in wrapped]
    return [_row(row) for row in zip(*padded, strict=True)]


def _row(cells: Sequence[str]) -> str:
    texts = [text.ljust(width) for text, width in zip(cells, COLUMNS, strict=True)]
    texts[0] = cells[0].rjust(COLUMNS[0])
    return "  ".join(texts).rstrip()


def _shown(value: float | str, unit: str) -> str:
    """Return a number with its unit, or the words."""
    return value if isinstance(value, str) else f"{value:.6g} {unit}".rstrip()


def claims_block(claims: Sequence[Claim]) -> Table:
    """Return the claims as a table of the report.

    Parameters
    ----------
    claims : sequence of Claim
        Checked claims.
    """
    heads = (
        Head("", numeric=True),
        Head("claim of the paper", "with its section", prose=True),
        Head("kind", "conformance of the code, built into the rig, or tested"),
        Head("stated", "what the paper says"),
        Head("found", "from the raw counts of the simulated rig"),
        Head("holds"),
        Head("how", "how it was tested, and what else was seen", prose=True),
    )
    rows = tuple(
        (
            str(claim.id),
            Cell(claim.claim, claim.section),
            claim.kind,
            _shown(claim.stated, claim.unit),
            _shown(claim.found, claim.unit),
            "yes" if claim.holds else "no",
            claim.how,
        )
        for claim in claims
    )
    held = sum(claim.holds for claim in claims)
    marks = tuple("" if claim.holds else "failed" for claim in claims)
    title = f"The paper claim by claim: {held} of {len(claims)} hold"
    return Table(title, heads, rows, marks)
