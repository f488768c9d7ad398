"""What `sindy-surge reproduce` does: run the tests, check the claims, write rows and report."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comparisons.cli.shared import Commands, add_targets, command_line, whole
from surge_core.files import check_apart, check_target, write_whole
from surge_core.progress import shown_over

if TYPE_CHECKING:
    from comparisons.paper.claim import Claim
    from comparisons.paper.figures import PaperFigure
    from comparisons.show.report import ReportSection

__all__ = ["add_parser", "claims_sections", "reproduce", "run"]

HTML = (".html", ".htm")
ABOUT = (
    "Four surge tests and one of steady rotating stall were simulated on a rig whose truth is "
    "known, read from their raw counts and reduced and fitted the paper's way: Butterworth "
    "filter of order 3 at 48 Hz on the pressures, run once; 50 lbm/s between the regimes; "
    "maximum likelihood with a moving average and zero-order hold. A claim of the kind “built in” "
    "reads back how the rig was made, “conformance” says that the code does as the paper says it "
    "did, and “tested” could have come out otherwise. What does not hold is printed as such."
)


def reproduce(
    *,
    seed: int = 0,
    json_path: Path | None = None,
    report: Path | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
    command: str = "sindy-surge reproduce",
) -> str:
    """Check the paper claim by claim on four simulated instabilities.

    Parameters
    ----------
    seed : int
        Seed of the rig's sensors.
    json_path : path, optional
        Where the rows go as JSON.
    report : path, optional
        Where the HTML report with its pictures goes.
    progress : callable
        Wraps iterations, to show how far they are.
    command : str
        Printed in the report.

    Returns
    -------
    str
        The table of the claims, and what was written.

    Raises
    ------
    InputError
        When a file cannot be written; it is refused before any work is done.
    """
    wanted = [(path, kind) for path, kind in ((json_path, ()), (report, HTML)) if path is not None]
    for path, suffixes in wanted:
        check_target(path, suffixes)
    check_apart([], [path for path, _ in wanted])

    from comparisons.paper.claim import claims_json, claims_table
    from comparisons.paper.claims import check_claims
    from comparisons.paper.instabilities import run_instabilities

    runs = run_instabilities(seed, progress)
    claims = check_claims(runs, progress)
    lines = [claims_table(claims)]
    if json_path is not None:
        rows = json.dumps(claims_json(claims), indent=1, allow_nan=False, ensure_ascii=False)
        write_whole(json_path, rows + "\n")
        lines.append(f"numbers: {json_path}")
    if report is not None:
        from comparisons.paper.figures import draw_figures
        from comparisons.show.report import write_report

        sections = claims_sections(claims, draw_figures(runs), progress)
        write_report(report, sections, title="The paper, claim by claim", command=command)
        lines.append(f"report: {report}")
    return "\n".join(lines)


def claims_sections(
    claims: Sequence[Claim],
    figures: Sequence[PaperFigure],
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> tuple[ReportSection, ...]:
    """Return the sections of the page: the claims and the pictures.

    Parameters
    ----------
    claims : sequence of Claim
        Checked claims.
    figures : sequence of PaperFigure
        Counterparts of the paper's figures.
    progress : callable
        Wraps the iteration over the figures, to show how far it is.
    """
    from comparisons.paper.claim import claims_block
    from comparisons.show.report import Part, Picture, ReportSection, Words

    table = Part("Table", (Words(ABOUT, "quiet"), claims_block(claims)))
    pictures = tuple(
        Part(f.title, (Picture.of(f.title, f.figure, f.caption, f.counterpart),))
        for f in progress(figures)
    )
    return ReportSection("Claims", extra=(table,)), ReportSection("Figures", extra=pictures)


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
    """
    print(
        reproduce(
            seed=arguments.seed,
            json_path=arguments.json,
            report=arguments.report,
            progress=shown_over,
            command=command_line(),
        )
    )
