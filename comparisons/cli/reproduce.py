"""The command `sindy-surge reproduce`: run the tests, check the claims, write rows and report."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from comparisons.cli.output import page, write_asked
from comparisons.page.blocks import Part, Picture, Words
from comparisons.paper.claim import Claim, claims_block, claims_json, claims_table
from comparisons.paper.claims import check_claims
from comparisons.paper.figures import draw_figures
from comparisons.paper.instabilities import run_instabilities, run_machines
from comparisons.show.report import ReportSection, report_pages
from surge_core.progress import shown_over

# Machines drawn about the paper's, on which claims are tested as well.
MACHINES = 4
ABOUT = (
    "Four surge tests and one of steady rotating stall were simulated on a rig whose truth is "
    "known, read from their raw counts and reduced and fitted the paper's way: Butterworth "
    "filter of order 3 at 48 Hz on the pressures, run once; 50 lbm/s between the regimes; "
    "maximum likelihood with a moving average and zero-order hold. A claim of the kind “built in” "
    "reads back how the rig was made, “conformance” says that the code does as the paper says it "
    "did, and “tested” could have come out otherwise. A tested claim must hold on the paper's "
    "machine, and on most of four machines drawn about it unless its number is that of one "
    "machine. What does not hold is printed as such."
)


def run(given: argparse.Namespace) -> Iterable[str]:
    """Run the tests, and check each claim on them."""
    runs = run_instabilities(given.seed, shown_over)
    others = run_machines(MACHINES, given.seed, shown_over)
    claims = check_claims(runs, others, shown_over)

    def report() -> str:
        sections = claims_sections(claims, draw_figures(runs), shown_over)
        return page("The paper, claim by claim", report_pages(sections))

    yield claims_table(claims)
    yield from write_asked(given, json=lambda: claims_json(claims), report=report)


def claims_sections(
    claims: Sequence[Claim],
    pictures: Sequence[Picture],
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> tuple[ReportSection, ...]:
    """Return the sections of the page: the claims, and the counterparts of the paper's figures."""
    table = Part("Table", (Words(ABOUT, "quiet"), claims_block(claims)))
    shown = tuple(Part(picture.title, (picture,)) for picture in progress(pictures))
    return ReportSection("Claims", extra=(table,)), ReportSection("Figures", extra=shown)
