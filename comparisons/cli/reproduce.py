"""What `sindy-surge reproduce` does: run the tests, check the claims, write rows and report."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from comparisons.cli.shared import Commands, add_targets, check_files, command_line, whole
from surge_core.files import write_whole
from surge_core.progress import shown_over

if TYPE_CHECKING:
    from comparisons.page.blocks import Picture
    from comparisons.paper.claim import Claim
    from comparisons.show.report import ReportSection

__all__ = ["add_parser", "claims_sections", "run"]

ABOUT = (
    "Four surge tests and one of steady rotating stall were simulated on a rig whose truth is "
    "known, read from their raw counts and reduced and fitted the paper's way: Butterworth "
    "filter of order 3 at 48 Hz on the pressures, run once; 50 lbm/s between the regimes; "
    "maximum likelihood with a moving average and zero-order hold. A claim of the kind “built in” "
    "reads back how the rig was made, “conformance” says that the code does as the paper says it "
    "did, and “tested” could have come out otherwise. What does not hold is printed as such."
)


def add_parser(commands: Commands) -> None:
    """Add the command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "reproduce",
        help="check the paper claim by claim on four simulated instabilities",
        description="Simulate the paper's four instabilities and its steady rotating stall, reduce "
        "the raw counts and fit them the paper's way, and print each claim of the paper with the "
        "number it states, the number found and whether it holds.",
    )
    add_targets(parser, "json", "report")
    parser.add_argument(
        "--seed", type=whole(0, 2**32 - 1), default=0, help="seed of the sensors (default: 0)"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Check the claims and print them.

    Parameters
    ----------
    arguments : argparse.Namespace
        Of the command.

    Raises
    ------
    InputError
        When a file cannot be written; it is refused before any work is done.
    """
    check_files([], json=arguments.json, report=arguments.report)

    from comparisons.paper.claim import claims_json, claims_table
    from comparisons.paper.claims import check_claims
    from comparisons.paper.instabilities import run_instabilities

    runs = run_instabilities(arguments.seed, shown_over)
    claims = check_claims(runs, shown_over)
    print(claims_table(claims))
    if arguments.json is not None:
        rows = json.dumps(claims_json(claims), indent=1, allow_nan=False, ensure_ascii=False)
        write_whole(arguments.json, rows + "\n")
        print(f"numbers: {arguments.json}")
    if arguments.report is not None:
        from comparisons.paper.figures import draw_figures
        from comparisons.show.report import write_report

        sections = claims_sections(claims, draw_figures(runs), shown_over)
        title = "The paper, claim by claim"
        write_report(arguments.report, sections, title=title, command=command_line())
        print(f"report: {arguments.report}")


def claims_sections(
    claims: Sequence[Claim],
    pictures: Sequence[Picture],
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> tuple[ReportSection, ...]:
    """Return the sections of the page: the claims and the pictures.

    Parameters
    ----------
    claims : sequence of Claim
        Checked claims.
    pictures : sequence of Picture
        Counterparts of the paper's figures.
    progress : callable
        Wraps the iteration over the pictures, to show how far it is.
    """
    from comparisons.paper.claim import claims_block
    from comparisons.show.report import Part, ReportSection, Words

    table = Part("Table", (Words(ABOUT, "quiet"), claims_block(claims)))
    shown = tuple(Part(picture.title, (picture,)) for picture in progress(pictures))
    return ReportSection("Claims", extra=(table,)), ReportSection("Figures", extra=shown)
