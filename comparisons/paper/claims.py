"""All 48 claims of the paper, in their order: what it says (claims.csv) and how each is checked."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from importlib.resources import files
from typing import Any

from comparisons.paper import claims_facility, claims_identification
from comparisons.paper.claim import Check, Claim
from comparisons.paper.instabilities import Instabilities
from surge_core.errors import InputError

# What checks each claim, by its number.
_CHECKS: dict[int, Check] = {
    number: check
    for checks in (claims_facility.CHECKS, claims_identification.CHECKS)
    for check, numbers in checks.items()
    for number in numbers
}
CHECKS = {number: _CHECKS[number] for number in sorted(_CHECKS)}
# Claims whose numbers are those of one machine and its facility: another machine has others, and
# the claim is judged on the paper's alone. The rest must hold on most machines as well.
OF_ONE_MACHINE = frozenset({19, 23, 25, 26, 28, 33, 37, 44})
# A number that is read back from a setting is the stated one to this share.
SAME = 1e-3


def check_claims(
    runs: Instabilities,
    others: Sequence[Instabilities] = (),
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> tuple[Claim, ...]:
    """Check every claim of the paper against the runs.

    A claim of the kind "tested" that is not of one machine must hold on more than half of the other
    machines too.
    """
    claims = []
    for number in progress(CHECKS):
        claim = check_claim(runs, number)
        if claim.kind == "tested" and others:
            found = [_holds_on(other, number) for other in others]
            machines = tuple(holds for holds in found if holds is not None)
            most = number in OF_ONE_MACHINE or 2 * sum(machines) > len(machines)
            claim = replace(claim, holds=claim.holds and most, machines=machines)
        claims.append(claim)
    return tuple(claims)


def _holds_on(runs: Instabilities, number: int) -> bool | None:
    """Return whether a claim holds on a machine; None where its variation does not surge there."""
    try:
        return check_claim(runs, number).holds
    except InputError:
        return None


def check_claim(runs: Instabilities, number: int) -> Claim:
    """Check one claim by its number, from 1."""
    text = files("comparisons.paper").joinpath("claims.csv").read_text("utf-8")
    row = list(csv.DictReader(text.splitlines()))[number - 1]
    stated: float | str
    try:
        stated = float(row["stated"])
    except ValueError:
        stated = row["stated"]
    found, holds, seen = CHECKS[number](runs)[number]
    # Rows go to JSON, which knows no numpy.
    plain = found if isinstance(found, str) else float(found)
    if holds is None:
        if isinstance(plain, str) or isinstance(stated, str):
            holds = plain == stated
        else:
            holds = math.isclose(plain, stated, rel_tol=SAME)
    how = row["how"].format(**seen)
    return Claim(
        number, row["section"], row["claim"], row["kind"], stated, plain, bool(holds), how,
        row["unit"],
    )  # fmt: skip
