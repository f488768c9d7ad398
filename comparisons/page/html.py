"""The page of a report: its template, style and script, and what a browser may do with it."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from comparisons.page.blocks import Part, Table

__all__ = ["render_page"]


def render_page(
    sections: Sequence[tuple[str, Sequence[Part]]],
    *,
    title: str,
    command: str,
    version: str,
    versions: Table,
) -> str:
    """Return a page that holds its style, its script and its pictures.

    Parameters
    ----------
    sections : sequence of (str, sequence of Part)
        Headings and what stands below them.
    title, command, version : str
        Title of the page, the command line that made it and the version of this package.
    versions : Table
        What else it was made with.

    Returns
    -------
    str
        HTML. Every text is escaped; the only script and the only style that a browser runs are
        those of this package, since the page's own policy names their hashes.
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
    style, script = _packaged("report.css"), _packaged("report.js")
    page = environment.get_template("report.html.jinja").render(
        title=title,
        command=command,
        version=version,
        versions=versions,
        sections=sections,
        policy=_content_policy(style, script),
        style=Markup(style),
        script=Markup(script),
    )
    # A file's name may hold bytes that are no text; Python keeps them as lone surrogates.
    return page.encode("utf-8", "backslashreplace").decode("utf-8")


def _content_policy(style: str, script: str) -> str:
    """Return the content security policy of a page: nothing but one style, one script, its images.

    Parameters
    ----------
    style, script : str
        Text between the tags.

    Returns
    -------
    str
        Names the SHA-256 of both (W3C, Content Security Policy Level 3), so that nothing that got
        into the page in spite of escaping could run, be styled, be sent or be fetched.
    """
    return (
        f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; "
        f"script-src '{_digest(script)}'; base-uri 'none'; form-action 'none'"
    )


def _packaged(name: str) -> str:
    return (files("comparisons.page") / "templates" / name).read_text("utf-8")


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()
