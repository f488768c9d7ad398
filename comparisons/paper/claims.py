"""All 48 claims of the paper, in their order: what each says (claims.csv), and what was found."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.resources import files
from typing import Any

from comparisons.paper import claims_facility, claims_identification
from comparisons.paper.claim import Check, Claim, Finding
from comparisons.paper.instabilities import Instabilities
from surge_core.errors import InputError

# The claims in their order: what each says, and the function that checks it.
TABLE = tuple(
    csv.DictReader(
        files("comparisons.paper").joinpath("claims.csv").read_text("utf-8").splitlines()
    )
)
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
    for name in progress(dict.fromkeys(row["check"] for row in TABLE)):
        found, elsewhere = _check(name)(runs), []
        for other in others:
            # A variation that does not surge there says nothing.
            with suppress(InputError):
                elsewhere.append(_check(name)(other))
        for number, finding in found.items():
            claim = _claim(number, finding)
            if claim.kind == "tested" and others:
                machines = tuple(_claim(number, each[number]).holds for each in elsewhere)
                most = number in OF_ONE_MACHINE or 2 * sum(machines) > len(machines)
                claim = replace(claim, holds=claim.holds and most, machines=machines)
            claims.append(claim)
    return tuple(sorted(claims, key=lambda claim: claim.id))


def check_claim(runs: Instabilities, number: int) -> Claim:
    """Check one claim by its number, from 1."""
    return _claim(number, _check(TABLE[number - 1]["check"])(runs)[number])


def _check(name: str) -> Check:
    module = claims_facility if hasattr(claims_facility, name) else claims_identification
    check: Check = getattr(module, name)
    return check


def _claim(number: int, finding: Finding) -> Claim:
    """Return a claim with what was found."""
    row, (found, holds, seen) = TABLE[number - 1], finding
    stated: float | str
    try:
        stated = float(row["stated"])
    except ValueError:
        stated = row["stated"]
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
