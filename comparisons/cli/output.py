"""What the commands do alike: read series, write what was asked for, show how far they are."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from classic_ml.io.series import read_series
from classic_ml.series import CoefficientSeries
from comparisons.harness.rows import check_once
from comparisons.page.blocks import Part
from comparisons.page.html import render_page
from comparisons.results import Answer
from comparisons.show.figures import write_figures
from surge_core.files import to_strict_json, write_whole
from surge_core.progress import shown_over

Pages = Sequence[tuple[str, Sequence[Part]]]

# How far fits, twins, passes of a step and pictures are, on a terminal only.
fitting = partial(shown_over, unit="fit", words="fitting")
measuring = partial(shown_over, unit="twin", words="measuring twins")
working = partial(shown_over, unit="pass")
drawing = partial(shown_over, unit="picture", words="drawing")

# What the line on a written file calls it, by the option.
LABELS = {
    "json": "numbers",
    "out": "reconstruction",
    "save_facility": "facility",
}


def read_records(paths: Sequence[Path]) -> list[CoefficientSeries]:
    """Read series files, each once: a record that is held out must not be fitted too."""
    records = [read_series(path) for path in paths]
    check_once(records)
    return records


def write_asked(
    given: argparse.Namespace, **contents: Callable[[], str | dict[str, Any] | list[Any]]
) -> list[str]:
    """Write the texts that were asked for once all are made, and return a line on each.

    ``contents`` has, by the name of the option, what makes its text or the document of its JSON.
    """
    made = []
    for name, make in contents.items():
        path = getattr(given, name)
        if path is not None:
            content = make()
            text = content if isinstance(content, str) else to_strict_json(content)
            made.append((name, path, text))
    for _, path, text in made:
        write_whole(path, text)
    return [f"{LABELS.get(name, name)}: {path}" for name, path, _ in made]


def take_away(folder: Path | None, pages: Pages, answer: Answer) -> list[str]:
    """Write what a page shows as files where that was asked for, and return a line on it."""
    if folder is None:
        return []
    n = write_figures(pages, folder, answer.curve)
    return [f"figures and tables: {folder} ({n} files)"]


def command_line() -> str:
    """Return the command as it was typed, for reports."""
    return " ".join(["sindy-surge", *sys.argv[1:]])


def page(title: str, sections: Pages) -> str:
    """Return a page with the command that made it."""
    return render_page(sections, title=title, command=command_line(), progress=drawing)
