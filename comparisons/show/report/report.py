"""The report: one HTML file that holds everything and asks the network for nothing."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comparisons.page.blocks import Head, Part, Table
from comparisons.results import Comparison, Reconstruction, Truth
from surge_core.files import check_target, write_whole

if TYPE_CHECKING:
    from classic_ml.reduction import Reduction

__all__ = ["ReportSection", "Truth", "render_report", "write_report"]

PACKAGES = (
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


@dataclass(frozen=True)
class ReportSection:
    """What one section of a report is about: a record, or several that are fitted together.

    Parameters
    ----------
    title : str
        Its heading.
    comparison : Comparison, optional
        Estimators of the pressure coefficient ψ' side by side.
    work : Comparison, optional
        The same of the work coefficient ψ.
    reduction : Reduction, optional
        How the record was reduced from raw counts; without it the pictures show φ and ψ' alone.
    truth, work_truth : Truth, optional
        Of a simulated record, for ψ' and ψ.
    validation : tuple of Reconstruction
        Models fitted elsewhere, run over other records.
    extra : tuple of Part
        Further parts, set before the ledger.
    """

    title: str
    comparison: Comparison | None = None
    work: Comparison | None = None
    reduction: Reduction | None = None
    truth: Truth | None = None
    work_truth: Truth | None = None
    validation: tuple[Reconstruction, ...] = ()
    extra: tuple[Part, ...] = ()


def render_report(
    sections: Sequence[ReportSection],
    *,
    title: str,
    command: str,
    version: str | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> str:
    """Return a report as one self-contained HTML page.

    Parameters
    ----------
    sections : sequence of ReportSection
        What it is about.
    title : str
        Title of the page.
    command : str
        The command line that made it.
    version : str, optional
        Version of this package; that of the installed one without it.
    progress : callable
        Wraps the iteration over the parts, to show how far the drawing is.

    Returns
    -------
    str
        HTML with its style and its images in it. All text is escaped: names of files and
        channels, and what ledgers say, are data.
    """
    from comparisons.page.html import render_page
    from comparisons.show.report.parts import makers_of

    chosen = version_of("sindy-surge") if version is None else version
    makers = [(place, make) for place, one in enumerate(sections) for make in makers_of(one)]
    parts: list[list[Part]] = [[] for _ in sections]
    for place, make in progress(makers):
        part = make()
        if part.blocks:
            parts[place].append(part)
    return render_page(
        [(section.title, own) for section, own in zip(sections, parts, strict=True)],
        title=title,
        command=command,
        version=chosen,
        versions=_versions(chosen),
    )


def write_report(
    path: str | Path,
    sections: Sequence[ReportSection],
    *,
    title: str,
    command: str,
    version: str | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> None:
    """Write a report, whole or not at all.

    Parameters
    ----------
    path : str or path
        Target, ending in ``.html``.
    sections, title, command, version, progress
        See :func:`render_report`.

    Raises
    ------
    InputError
        When the target cannot be written; it is refused before any picture is drawn.
    """
    target = Path(path)
    check_target(target, (".html", ".htm"))
    page = render_report(sections, title=title, command=command, version=version, progress=progress)
    write_whole(target, page)


def _versions(version: str) -> Table:
    rows = [("sindy-surge", version), ("Python", platform.python_version())]
    for name in PACKAGES:
        try:
            rows.append((name, version_of(name)))
        except PackageNotFoundError:
            rows.append((name, "not installed"))
    return Table("Versions", (Head("package"), Head("version")), tuple(rows))
