"""All claims of the paper, checked, and their table for terminal, JSON and report."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from comparisons.page.blocks import Cell, Head, Table
from comparisons.paper import (
    claims_acquisition,
    claims_analysis,
    claims_conclusions,
    claims_identification,
    claims_ninety,
    claims_reduction,
)
from comparisons.paper.claims_base import Claim, ClaimCheck
from comparisons.paper.instabilities import Instabilities

__all__ = ["CHECKS", "Claim", "check_claims", "claims_block", "claims_json", "claims_table"]

CHECKS: tuple[ClaimCheck, ...] = (
    *claims_acquisition.CLAIMS,
    *claims_reduction.CLAIMS,
    *claims_analysis.CLAIMS,
    *claims_identification.CLAIMS,
    *claims_ninety.CLAIMS,
    *claims_conclusions.CLAIMS,
)

WIDTH = 118
# Number, claim, stated, found, holds; two spaces between.
COLUMNS = (2, 50, 19, 32, 5)
HEADINGS = ("", "claim of the paper", "stated", "found", "holds")


def check_claims(
    runs: Instabilities, progress: Callable[[Iterable[Any]], Iterable[Any]] = iter
) -> tuple[Claim, ...]:
    """Check every claim of the paper against the runs.

    Parameters
    ----------
    runs : Instabilities
        The four instabilities and the steady stall.
    progress : callable
        Wraps the iteration over the claims, to show how far it is.

    Returns
    -------
    tuple of Claim
        In the order of their numbers.
    """
    return tuple(check(runs) for check in progress(CHECKS))


def claims_json(claims: Sequence[Claim]) -> list[dict[str, Any]]:
    """Return the rows of ``reproduce --json``: id, claim, stated, found, holds.

    Parameters
    ----------
    claims : sequence of Claim
        Checked claims.
    """
    return [
        {
            "id": claim.id,
            "claim": claim.claim,
            "stated": _plain(claim.stated),
            "found": _plain(claim.found),
            "holds": bool(claim.holds),
        }
        for claim in claims
    ]


def _plain(value: float | str) -> float | str | None:
    if isinstance(value, str):
        return value
    return float(value) if math.isfinite(value) else None


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
        said = f"{claim.id} does not hold. Tested: {claim.how}."
        lines += textwrap.wrap(said, WIDTH, subsequent_indent="   ", break_on_hyphens=False)
    return "\n".join(lines)


def _lines(claim: Claim) -> list[str]:
    """Return the wrapped lines of one claim."""
    cells = (
        str(claim.id),
        claim.claim,
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
    if isinstance(value, str):
        return value
    return f"{value:.6g} {unit}".rstrip()


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
        Head("stated", "what the paper says"),
        Head("found", "from the raw counts of the simulated rig"),
        Head("holds"),
        Head("how", "how it was tested, and what else was seen", prose=True),
    )
    rows = tuple(
        (
            str(claim.id),
            Cell(claim.claim, claim.section),
            _shown(claim.stated, claim.unit),
            _shown(claim.found, claim.unit),
            "yes" if claim.holds else "no",
            claim.how,
        )
        for claim in claims
    )
    held = sum(claim.holds for claim in claims)
    return Table(
        f"The paper claim by claim: {held} of {len(claims)} hold",
        heads,
        rows,
        tuple("" if claim.holds else "failed" for claim in claims),
    )
