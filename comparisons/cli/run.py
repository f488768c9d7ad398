"""The command `sindy-surge run`: from a raw record to the answer on one page."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from comparisons.cli.command import Command, check_folder, command_line, drawing, take_away, working
from comparisons.cli.options import FIGURES, NO_TWINS, RAW, argument
from surge_core.files import check_apart, to_strict_json, write_whole
from surge_core.progress import shown_steps

PAGE, NUMBERS, SERIES = "report.html", "run.json", "series.csv"
DRAWING_S = 5.0


def _run(given: argparse.Namespace) -> Iterable[str]:
    from classic_ml.io.series import write_series
    from comparisons.analysis import STEPS, analyse
    from comparisons.page.html import render_page
    from comparisons.show.report import report_pages
    from comparisons.show.run_output import run_document, run_section

    folder = check_folder(given.out)
    if given.figures:
        check_folder(given.figures)
    written = [folder / name for name in (SERIES, NUMBERS, PAGE)]
    check_apart([given.raw, given.test], written)
    with shown_steps([*STEPS.values(), DRAWING_S]) as begin:
        twins = not given.no_twins
        found = analyse(given.raw, given.test, twins=twins, begin=begin, progress=working)
        begin("drawing the page")
        pages, title = report_pages([run_section(found)]), f"Surge record {given.raw.name}"
        page = render_page(pages, title=title, command=command_line(), progress=drawing)
        numbers = to_strict_json(run_document(found))
    folder.mkdir(parents=True, exist_ok=True)
    write_series(found.reduction.series, written[0])
    write_whole(written[1], numbers)
    write_whole(written[2], page)
    labels = ("series", "numbers", "report")
    lines = [f"{label}: {path}" for label, path in zip(labels, written, strict=True)]
    lines += take_away(given.figures, pages, found.answer)
    return str(found.answer), "", *lines


COMMAND = Command(
    "run",
    help="from a raw record to the answer: τ, characteristic, what is missing, on one page",
    description="Inspect and reduce a raw record, compare the estimators, choose the terms of the "
    "characteristic, look for what the lag model lacks, and fit the work characteristic where T31 "
    "allows. Leaves report.html, run.json and series.csv in a folder; the terminal has the answer.",
    arguments=(
        *RAW,
        argument(
            "--out",
            type=Path,
            default=Path("run"),
            metavar="DIR",
            help="folder for the page, the numbers and the series (default: run)",
        ),
        FIGURES,
        NO_TWINS,
    ),
    run=_run,
)
