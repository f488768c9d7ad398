"""The page of a report: its template, style and script, and what a browser may do with it."""

from __future__ import annotations

import base64
import hashlib
import platform
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version as version_of
from importlib.resources import files
from typing import Any

from comparisons.page.blocks import Part
from surge_core.display import Grid

PACKAGES = (
    "sindy-surge",
    "numpy",
    "scipy",
    "pandas",
    "scikit-learn",
    "pysindy",
    "numba",
    "xarray",
    "matplotlib",
    "jinja2",
)
# Letters of a cell that stays in one line, and of a word that a printed column holds.
LONGEST_LINE, LONGEST_WORD = 30, 26
# Columns beyond which a table is set smaller, and beyond which its numbers are broken in print.
MANY_COLUMNS, MOST_COLUMNS = 7, 16


def render_page(
    sections: Sequence[tuple[str, Sequence[Part]]],
    *,
    title: str,
    command: str,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> str:
    """Return a page that holds its style, its script and its pictures.

    Parameters
    ----------
    sections : sequence of (str, sequence of Part)
        Headings and what stands below them.
    title, command : str
        Title of the page and the command line that made it.
    progress : callable
        Wraps the iteration over the pictures, to show how far the drawing is.

    Notes
    -----
    Every text is escaped; the only script and the only style that a browser runs are those of this
    package, since the page's own policy names their SHA-256 (W3C, Content Security Policy Level 3).
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader("comparisons.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    pictures = [picture for _, parts in sections for part in parts for picture in part.pictures]
    uris = {id(picture): picture.uri for picture in progress(pictures)}
    environment.globals |= {
        "kind_of": lambda block: type(block).__name__.lower(),
        "uri_of": lambda picture: uris[id(picture)],
        "table_style": _table_style,
        "cell_style": _cell_style,
    }
    style, script = (
        (files("comparisons.page") / "templates" / name).read_text("utf-8")
        for name in ("report.css", "report.js")
    )
    policy = (
        f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; "
        f"script-src '{_digest(script)}'; base-uri 'none'; form-action 'none'"
    )
    page = environment.get_template("report.html.jinja").render(
        title=title,
        command=command,
        versions=_versions(),
        sections=sections,
        policy=policy,
        style=Markup(style),
        script=Markup(script),
    )
    # A file's name may hold bytes that are no text; Python keeps them as lone surrogates.
    return page.encode("utf-8", "backslashreplace").decode("utf-8")


def _versions() -> Grid:
    rows = (("Python", platform.python_version()), *((n, version_of(n)) for n in PACKAGES))
    return Grid("Versions", ("package", "version"), rows, frozenset({0, 1}))


def _table_style(grid: Grid) -> str:
    """Return the classes of a table; rows of which one goes on with that above it stay in place."""
    kinds = (
        ("sortable", len(grid.rows) > 1 and all(row[0] for row in grid.rows)),
        ("wide", len(grid.header) > MANY_COLUMNS),
        ("widest", len(grid.header) > MOST_COLUMNS),
    )
    return " ".join(name for name, holds in kinds if holds)


def _cell_style(grid: Grid, column: int, text: str) -> str:
    """Return the classes of a cell: one of words that is long may be broken."""
    long = any(len(word) > LONGEST_WORD for word in text.split())
    if column not in grid.words:
        return "numeric long" if long else "numeric"
    # Small print has a line of its own.
    return "prose" if long or max(map(len, text.split("\n"))) > LONGEST_LINE else "short"


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()
