"""The command `sindy-surge run`: from a raw record to the answer on one page."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from classic_ml.io.series import write_series
from comparisons.analysis import STEPS, analyse
from comparisons.cli.output import page, take_away, working
from comparisons.show.json_output import run_document
from comparisons.show.report import report_pages, run_section
from surge_core.files import check_apart, to_strict_json, write_whole
from surge_core.progress import shown_steps

# What is left in the folder, by what the terminal calls it.
FILES = {"series": "series.csv", "numbers": "run.json", "report": "report.html"}
DRAWING_S = 5.0


def run(given: argparse.Namespace) -> Iterable[str]:
    """Analyse a raw record, and leave its page, numbers and series."""
    paths = {label: given.out / name for label, name in FILES.items()}
    check_apart([given.raw, given.test], paths.values())
    with shown_steps([*STEPS.values(), DRAWING_S]) as begin:
        twins = not given.no_twins
        found = analyse(given.raw, given.test, twins=twins, begin=begin, progress=working)
        begin("drawing the page")
        pages = report_pages([run_section(found)])
        drawn = page(f"Surge test: {found.reduction.test.name}", pages)
        numbers = to_strict_json(run_document(found))
    given.out.mkdir(parents=True, exist_ok=True)
    write_series(found.reduction.series, paths["series"])
    write_whole(paths["numbers"], numbers)
    write_whole(paths["report"], drawn)
    lines = [f"{label}: {path}" for label, path in paths.items()]
    return str(found.answer), "", *lines, *take_away(given.figures, pages, found.answer)
