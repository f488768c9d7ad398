"""The command `sindy-surge reproduce`: run the tests, check the claims, write rows and report."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from comparisons.cli.command import Command, command_line, write_asked
from comparisons.cli.options import JSON, REPORT, seed
from surge_core.progress import shown_over

if TYPE_CHECKING:
    from comparisons.page.blocks import Picture
    from comparisons.paper.claim import Claim
    from comparisons.show.report import ReportSection

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


def _run(given: argparse.Namespace) -> Iterable[str]:
    from comparisons.paper.claim import claims_json, claims_table
    from comparisons.paper.claims import check_claims
    from comparisons.paper.figures import draw_figures
    from comparisons.paper.instabilities import run_instabilities, run_machines
    from comparisons.show.report import render_report

    runs = run_instabilities(given.seed, shown_over)
    others = run_machines(MACHINES, given.seed, shown_over)
    claims = check_claims(runs, others, shown_over)

    def page() -> str:
        sections = claims_sections(claims, draw_figures(runs), shown_over)
        return render_report(sections, title="The paper, claim by claim", command=command_line())

    yield claims_table(claims)
    yield from write_asked(given, json=lambda: claims_json(claims), report=page)


def claims_sections(
    claims: Sequence[Claim],
    pictures: Sequence[Picture],
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> tuple[ReportSection, ...]:
    """Return the sections of the page: the claims, and the counterparts of the paper's figures."""
    from comparisons.page.blocks import Part, Words
    from comparisons.paper.claim import claims_block
    from comparisons.show.report import ReportSection

    table = Part("Table", (Words(ABOUT, "quiet"), claims_block(claims)))
    shown = tuple(Part(picture.title, (picture,)) for picture in progress(pictures))
    return ReportSection("Claims", extra=(table,)), ReportSection("Figures", extra=shown)


COMMAND = Command(
    "reproduce",
    help="check the paper claim by claim on four simulated instabilities",
    description="Simulate the paper's four instabilities and its steady rotating stall, reduce "
    "the raw counts and fit them the paper's way, and print each claim of the paper with the "
    "number it states, the number found and whether it holds.",
    arguments=(JSON, REPORT, seed()),
    run=_run,
)
