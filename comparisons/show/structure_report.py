"""The page of the command `structure`: one HTML file with its pictures in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.harness.structure_fit import FoundStructure
from comparisons.page.blocks import Block, Head, Part, Picture, Table, Words
from comparisons.page.html import render_page
from comparisons.page.style import (
    ACCENT,
    FAINT,
    MARK,
    QUIET,
    coefficient_symbol,
    dress,
    estimator_styles,
    legend_above,
    new_figure,
    printable,
    robust_limits,
)
from comparisons.show.structure_output import LEAST_INCLUSION, left_out_words, opening_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sindy_surge.selection import PathRow

__all__ = ["structure_report"]

POINTS_DRAWN = 4000
BAND = 1.96


def structure_report(
    found: FoundStructure, *, command: str = "sindy-surge structure", version: str | None = None
) -> str:
    """Return all that is known as one self-contained HTML page.

    Parameters
    ----------
    found : FoundStructure
        From :func:`find_structure`.
    command : str
        The command line that made it.
    version : str, optional
        Version of this package; that of the installed one without it.
    """
    names = ", ".join(Path(record.source).name for record in found.records)
    return render_page(
        [(names, _parts(found))],
        title=f"Structure of the characteristic of {names}",
        command=command,
        version=version,
    )


def _parts(found: FoundStructure) -> tuple[Part, ...]:
    opening = Words(opening_words(found) + ".")
    code, advice = found.state
    if found.refused:
        refusal = Words(f"No structure ({code}): {advice}", "caution")
        return (Part("Structure", (opening, refusal)),)
    inclusion: tuple[Block, ...] = (Words(left_out_words(found)),)
    if found.inclusion:
        inclusion = (_inclusion_picture(found), *inclusion)
    parts = [
        Part("Structure", (opening, *_summary(found))),
        Part("Characteristic", (_curve_picture(found),)),
        Part("Inclusion probabilities", inclusion),
    ]
    if found.fit.path_:
        parts.append(Part("Structures tried", (_path_picture(found),)))
    equations = tuple(Words(found.equation(style), "code") for style in ("latex", "python"))
    return (*parts, Part("Equation as LaTeX and Python", equations))


def _summary(found: FoundStructure) -> tuple[Block, ...]:
    """Return the fields and tables that a terminal and a notebook show of the fit."""
    sheet = found.summary.sheet()
    fields = Table(
        sheet.title,
        (Head("quantity"), Head("value", prose=True)),
        # A ledger has a line for each of its entries.
        tuple(
            (field.label if number == 0 else "", line)
            for field in sheet.fields
            for number, line in enumerate(field.lines)
        ),
    )
    tables = (
        Table(
            table.title,
            tuple(
                Head(text, numeric=column not in table.words, prose=text == "terms")
                for column, text in enumerate(table.header)
            ),
            table.rows,
            tuple("best" if row == table.marked else "" for row in range(len(table.rows))),
        )
        for table in sheet.grids
    )
    return (fields, *tables)


def _curve_picture(found: FoundStructure) -> Picture:
    """Draw the characteristic with its band over the measured points and the histogram of φ."""
    from surge_core.terms import pretty_term

    phi, value, stderr = found.curve()
    figure = new_figure(height_in=6.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[4, 1])
    step = -(-found.phi.size // POINTS_DRAWN)
    points = found.phi[::step], found.measured[::step]
    dress(upper).plot(*points, ".", ms=2.5, color=FAINT, label="measured, with the lag in it")
    colour = estimator_styles(["sindy"])["sindy"].colour
    if np.any(np.isfinite(stderr)):
        ends = value - BAND * stderr, value + BAND * stderr
        upper.fill_between(phi, *ends, color=colour, alpha=0.22, lw=0, label="95 % band")
    symbol = coefficient_symbol(found.target, quasi_steady=True)
    upper.plot(phi, value, color=colour, lw=2.0, label=symbol + r"$(\varphi)$")
    upper.set_ylim(*robust_limits(value, found.measured, margin=0.12))
    upper.set_ylabel(f"{coefficient_symbol(found.target)}, {symbol} [-]")
    density, edges = np.histogram(found.phi, bins=60, density=True)
    dress(lower).stairs(density, edges, fill=True, color="#bcc5d0", lw=0)
    lower.set_ylabel("share of rows\n" + r"per unit $\varphi$", fontsize=8.5)
    lower.set_xlabel(r"flow coefficient $\varphi$ [-]")
    lower.set_xlim(*robust_limits(phi, margin=0.02))
    legend_above(figure, upper)
    name = pretty_term(found.target)
    widest = float(np.max(stderr[np.isfinite(stderr)], initial=0.0))
    return Picture.of(
        f"Quasi-steady {name} over φ",
        figure,
        f"{name}_QS over φ from {phi[0]:.3g} to {phi[-1]:.3g}: {np.nanmin(value):.3g} to "
        f"{np.nanmax(value):.3g}, its largest standard error {widest:.2g}; below, the histogram of "
        "φ.",
        "The curve ends where the data end. The band holds for the terms as they were chosen, "
        "not for another choice; where it leaves the picture the record says nothing. Points are "
        "measured and lie off the curve by the lag; where few rows are, the curve rests on the "
        "form of its terms.",
    )


def _inclusion_picture(found: FoundStructure) -> Picture:
    """Draw the inclusion probabilities as bars, the chosen terms in colour."""
    from surge_core.terms import pretty_term

    chosen = set(found.fit.terms_)
    known = sorted(found.inclusion.items(), key=lambda pair: -pair[1])
    shown = [(name, p) for name, p in known if p >= LEAST_INCLUSION or name in chosen]
    figure = new_figure(height_in=1.3 + 0.32 * max(len(shown), 3))
    ax = dress(figure.add_subplot())
    for row, (name, p) in enumerate(shown):
        ax.barh(row, p, color=ACCENT if name in chosen else FAINT, height=0.7)
        ax.text(p + 0.01, row, f"{p:.2f}", va="center", fontsize=9)
    ax.set_yticks(range(len(shown)), [printable(pretty_term(name)) for name, _ in shown])
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.set_xlim(0.0, 1.08)
    ax.grid(False, axis="y")
    n_left_out = len(known) - len(shown)
    rest = f"; {n_left_out} more terms below {LEAST_INCLUSION:g}" if n_left_out else ""
    ax.set_xlabel(f"share of resampled records whose structure holds the term{rest}")
    ax.set_title("blue: in the chosen structure", loc="right", fontsize=8.5, color=QUIET)
    return Picture.of(
        "Inclusion probabilities",
        figure,
        "Share of resampled records that hold a term: "
        + ", ".join(f"{pretty_term(name)} {p:.2f}" for name, p in shown)
        + ".",
        "Cycles are drawn with replacement and the terms chosen again. A term near 1 is needed by "
        "every such record; two that share the records stand in for each other. Resamples show "
        "the scatter of this record, not what every cycle of it has wrong.",
    )


def _path_picture(found: FoundStructure) -> Picture:
    """Draw the structures that were tried over their size.

    Left, the free run's error on cycles left out; right, the score above the least, of those
    scored about the fit with all terms and of those about their own. A panel without a finite
    value is left out.
    """
    from surge_core.terms import pretty_term

    path = found.fit.path_
    held_out = [row for row in path if math.isfinite(row.held_out_rms)]
    scored = [row for row in path if math.isfinite(row.score)]
    # Where cycles left out decide, the score means little or is not there.
    by_score = bool(scored) and (not held_out or found.state[0] != "model_error_dominates")
    figure = new_figure(height_in=4.2)
    panels = list(np.atleast_1d(np.asarray(figure.subplots(1, bool(held_out) + by_score))))
    sizes = {row.size for row in path}
    if held_out:
        values = [row.held_out_rms for row in held_out]
        _path_panel(panels[0], held_out, values, sizes)
        symbol = coefficient_symbol(found.target)
        panels[0].set_ylabel(f"rms error of {symbol} on cycles left out [-]")
        panels[0].set_ylim(0.0, 1.1 * max(values))
    if by_score:
        least = min(row.score for row in scored)
        values = [row.score - least for row in scored]
        _path_panel(panels[-1], scored, values, sizes)
        panels[-1].set_yscale("symlog", linthresh=10.0)
        panels[-1].set_ylim(-2.5, 3.0 * max(*values, 10.0))
        panels[-1].set_ylabel("score above the least (extended BIC)")
    legend_above(figure, *panels, columns=4)
    best = _least_by_size(held_out, [row.held_out_rms for row in held_out])
    errors = ", ".join(f"{n}: {rms:.3g}" for n, rms in sorted(best.items())) or "not known"
    chosen = next((row for row in path if row.chosen), None)
    taken = f" Chosen: {', '.join(map(pretty_term, chosen.terms))}." if chosen else ""
    return Picture.of(
        "Structures by size",
        figure,
        f"Least error on cycles left out, by number of terms: {errors}.{taken}",
        "Each mark is a structure that was tried. Only those with a fit of their own (full) have "
        "an error on cycles left out. A score, where there is one, can be compared only with those "
        "about the same fit: full marks with each other at most. More terms that lower neither by "
        "much are not needed; the least error alone does not choose, since some structure of many "
        "is best by luck.",
    )


def _path_panel(
    ax: Axes, rows: Sequence[PathRow], values: Sequence[float], sizes: set[int]
) -> None:
    dress(ax)
    marks = {True: (QUIET, "about its own fit"), False: ("none", "about the fit with all terms")}
    for refitted, (face, label) in marks.items():
        some = [(r.size, v) for r, v in zip(rows, values, strict=True) if r.refitted == refitted]
        if some:
            look: dict[str, Any] = {"ms": 4.5, "mec": QUIET, "mfc": face, "mew": 0.8}
            ax.plot(*zip(*some, strict=True), "o", **look, label=label)
    least = sorted(_least_by_size(rows, values).items())
    ax.plot(*zip(*least, strict=True), color=FAINT, lw=1.2, zorder=1, label="least of its size")
    chosen = [(r.size, v) for r, v in zip(rows, values, strict=True) if r.chosen]
    if chosen:
        ax.plot(*zip(*chosen, strict=True), "o", ms=11, mec=MARK, mfc="none", mew=2, label="chosen")
    ax.set_xticks(sorted(sizes))
    ax.set_xlim(min(sizes) - 0.5, max(sizes) + 0.5)
    ax.set_xlabel("number of terms")


def _least_by_size(rows: Sequence[PathRow], values: Sequence[float]) -> dict[int, float]:
    least: dict[int, float] = {}
    for row, value in zip(rows, values, strict=True):
        least[row.size] = min(value, least.get(row.size, math.inf))
    return least
