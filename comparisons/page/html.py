"""The page of a report: its template, style and script, and what a browser may do with it."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.metadata import version as version_of
from importlib.resources import files

from comparisons.page.blocks import Part, Table

__all__ = ["render_page"]


def render_page(
    sections: Sequence[tuple[str, Sequence[Part]]],
    *,
    title: str,
    command: str,
    version: str | None = None,
    versions: Table | None = None,
) -> str:
    """Return a page that holds its style, its script and its pictures.

    Parameters
    ----------
    sections : sequence of (str, sequence of Part)
        Headings and what stands below them.
    title, command : str
        Title of the page and the command line that made it.
    version : str, optional
        Version of this package; that of the installed one without it.
    versions : Table, optional
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
        version=version or version_of("sindy-surge"),
        versions=versions or Table("Versions", (), ()),
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
