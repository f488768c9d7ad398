"""All 48 claims of the paper, in their order: what it says (claims.csv) and how each is checked."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable
from importlib.resources import files
from typing import Any

from comparisons.paper.claim import Check, Claim
from comparisons.paper.claims_facility import FACILITY_CHECKS
from comparisons.paper.claims_identification import IDENTIFICATION_CHECKS
from comparisons.paper.claims_surge import SURGE_CHECKS
from comparisons.paper.instabilities import Instabilities

__all__ = ["CHECKS", "check_claim", "check_claims"]

CHECKS: dict[int, Check] = FACILITY_CHECKS | SURGE_CHECKS | IDENTIFICATION_CHECKS
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
    row = _rows()[number - 1]
    stated = _number(row["stated"])
    found, holds, how = CHECKS[number](runs)
    # Rows go to JSON, which knows no numpy.
    plain = found if isinstance(found, str) else float(found)
    return Claim(
        int(row["id"]),
        row["section"],
        row["claim"],
        row["kind"],
        stated,
        plain,
        _same(plain, stated) if holds is None else bool(holds),
        how,
        row["unit"],
    )


def _rows() -> list[dict[str, str]]:
    text = files("comparisons.paper").joinpath("claims.csv").read_text("utf-8")
    return list(csv.DictReader(text.splitlines()))


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _same(found: float | str, stated: float | str) -> bool:
    if isinstance(found, str) or isinstance(stated, str):
        return found == stated
    return math.isclose(found, stated, rel_tol=SAME)
