"""What a claim of the paper is, how it is checked, and the claims as JSON, text and table."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

from comparisons.paper.instabilities import Instabilities
from surge_core.display import Field, Grid, Sheet


class Finding(NamedTuple):
    """What the check of a claim gave.

    ``found`` is the number or the words; ``holds`` is None where the claim holds if that is what
    is stated; ``seen`` is what else was seen, by the names that the column ``how`` of claims.csv
    has for it.
    """

    found: float | str
    holds: bool | None = None
    seen: Mapping[str, Any] = MappingProxyType({})


# What a check finds, by the numbers of the claims.
Findings: TypeAlias = Mapping[int, Finding]
Check: TypeAlias = Callable[[Instabilities], Findings]


@dataclass(frozen=True)
class Claim:
    """One claim of the paper beside what was found."""

    id: int  # Its number in the list of claims
    section: str  # Where in the paper
    claim: str  # In one sentence
    # What its check is worth. "conformance": the code does as the paper says it did; "built in":
    # the rig was made so; "tested": it comes from simulated counts and could be otherwise.
    kind: str
    stated: float | str  # The number of the paper, or words where it has none
    found: float | str
    holds: bool
    how: str  # How it was tested, and what else was seen
    unit: str = ""
    # Whether it holds on each machine drawn about the paper's; empty where it was not asked.
    machines: tuple[bool, ...] = ()

    def shown(self, value: float | str) -> str:
        """Return a number of the claim with its unit, or the words."""
        return value if isinstance(value, str) else f"{value:.6g} {self.unit}".rstrip()

    @property
    def elsewhere(self) -> str:
        """On how many other machines it holds; empty where it was not asked."""
        n = len(self.machines)
        return f"holds on {sum(self.machines)} of {n} machines drawn about this one" if n else ""


def claims_json(claims: Sequence[Claim]) -> list[dict[str, Any]]:
    """Return the rows of ``reproduce --json``: id, claim, kind, stated, found, holds."""
    rows = []
    for claim in claims:
        row = {n: getattr(claim, n) for n in ("id", "claim", "kind", "stated", "found", "holds")}
        unknown = isinstance(claim.found, float) and not math.isfinite(claim.found)
        rows.append(row | {"found": None} if unknown else row)
    return rows


def claims_table(claims: Sequence[Claim]) -> str:
    """Return the claims as text for a terminal, those that do not hold with their reasons."""
    fields = []
    for claim in claims:
        lines = [
            f"{claim.claim} ({claim.kind})",
            f"stated: {claim.shown(claim.stated)}; found: {claim.shown(claim.found)}",
        ]
        if not claim.holds:
            lines.append(f"tested: {claim.how}")
        if claim.elsewhere:
            lines.append(claim.elsewhere)
        word = "holds" if claim.holds else "does NOT hold"
        fields.append(Field(f"{claim.id:2} {word}", tuple(lines)))
    return Sheet(_title(claims), tuple(fields)).text()


def _title(claims: Sequence[Claim]) -> str:
    tested = [claim for claim in claims if claim.kind == "tested"]
    rest = [claim for claim in claims if claim.kind != "tested"]
    kinds = [f"{sum(c.kind == kind for c in rest)} {kind}" for kind in ("conformance", "built in")]
    off = ", ".join(str(claim.id) for claim in rest if not claim.holds)
    return (
        f"The paper claim by claim: {len(tested)} tested, of which "
        f"{sum(claim.holds for claim in tested)} hold; {' and '.join(kinds)}"
        + (f", of which {off} does not hold" if off else "")
    )


def claims_block(claims: Sequence[Claim]) -> Grid:
    """Return the claims as a table of the report."""
    meanings = {
        "": "",
        "claim of the paper": "section, and kind: conformance of the code, built into the rig, or "
        "tested",
        "stated": "what the paper says",
        "found": "from the raw counts of the simulated rig",
        "holds": "",
        "how": "how it was tested, and what else was seen",
    }
    # What could have come out otherwise, and did, first.
    kinds = ("tested", "conformance", "built in")
    ordered = sorted(claims, key=lambda claim: (kinds.index(claim.kind), claim.holds))
    rows = tuple(
        (
            str(claim.id),
            f"{claim.claim}\n{claim.section}; {claim.kind}",
            claim.shown(claim.stated),
            claim.shown(claim.found),
            "yes" if claim.holds else "no",
            claim.how + (f"; {claim.elsewhere}" if claim.elsewhere else ""),
        )
        for claim in ordered
    )
    marks = tuple("" if claim.holds else "failed" for claim in ordered)
    words = frozenset(range(1, len(meanings)))
    return Grid(_title(claims), tuple(meanings), rows, words, marks, meanings)
