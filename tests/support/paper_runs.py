"""The runs behind the paper's claims and figures, made once for every file that looks at them."""

from __future__ import annotations

from functools import cache

from comparisons.paper.instabilities import Instabilities, InstabilityRun, run_case
from comparisons.rig.cases import RigCase

CASES = ("90", "95", "985", "985-second", "75-stall")


@cache
def paper_case(case: str) -> InstabilityRun:
    """One test with the rig as it is, seed 0."""
    return run_case(case, 0)


def remembered_case(case: str | RigCase, seed: int = 0) -> InstabilityRun:
    """Return what `run_case` returns, from memory where the rig is as it is."""
    return paper_case(case) if isinstance(case, str) and seed == 0 else run_case(case, seed)


def paper_runs(*cases: str) -> Instabilities:
    """Return the runs of these cases, of all by default."""
    return {case: paper_case(case) for case in cases or CASES}
