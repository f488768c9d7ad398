"""All 48 claims of the paper, in their order: what it says (claims.csv) and how each is checked."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable
from importlib.resources import files
from typing import Any

from comparisons.paper import claims_facility, claims_identification, claims_surge
from comparisons.paper.claim import Check, Claim
from comparisons.paper.instabilities import Instabilities

__all__ = ["CHECKS", "check_claim", "check_claims"]

# A function named claim_NN checks claim NN.
CHECKS: dict[int, Check] = {
    int(name.removeprefix("claim_")): check
    for module in (claims_facility, claims_surge, claims_identification)
    for name, check in sorted(vars(module).items())
    if name.startswith("claim_")
}
# A number that is read back from a setting is the stated one to this share.
SAME = 1e-3


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
    return tuple(check_claim(runs, number) for number in progress(CHECKS))


def check_claim(runs: Instabilities, number: int) -> Claim:
    """Check one claim.

    Parameters
    ----------
    runs : Instabilities
        The four instabilities and the steady stall.
    number : int
        Its number, from 1.
    """
    text = files("comparisons.paper").joinpath("claims.csv").read_text("utf-8")
    row = list(csv.DictReader(text.splitlines()))[number - 1]
    stated: float | str
    try:
        stated = float(row["stated"])
    except ValueError:
        stated = row["stated"]
    found, holds, how = CHECKS[number](runs)
    # Rows go to JSON, which knows no numpy.
    plain = found if isinstance(found, str) else float(found)
    if holds is None:
        if isinstance(plain, str) or isinstance(stated, str):
            holds = plain == stated
        else:
            holds = math.isclose(plain, stated, rel_tol=SAME)
    return Claim(
        int(row["id"]),
        row["section"],
        row["claim"],
        row["kind"],
        stated,
        plain,
        bool(holds),
        how,
        row["unit"],
    )
