"""The page of the command `structure`: one HTML file with its pictures in it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

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
    return tuple(parts)


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
        "Blocks of rows are drawn with replacement and the terms chosen again. A term near 1 is "
        "needed by every such record; two that share the records stand in for each other. "
        "Resamples show the scatter of this record, not what every cycle of it has wrong.",
    )


def _path_picture(found: FoundStructure) -> Picture:
    """Draw the structures that were tried over their size.

    By the score above the least; by the free run's error on cycles left out where these decide.
    """
    from surge_core.terms import pretty_term

    path = found.fit.path_
    # Where cycles left out decide, the score means little or is not there.
    scored = any(math.isfinite(row.score) for row in path)
    held_out = found.state[0] == "model_error_dominates" or not scored
    values = [row.held_out_rms if held_out else row.score for row in path]
    known = [(row, value) for row, value in zip(path, values, strict=True) if math.isfinite(value)]
    offset = 0.0 if held_out else min((value for _, value in known), default=0.0)
    points = [(row.size, value - offset) for row, value in known]
    least: dict[int, float] = {}
    for size, value in points:
        least[size] = min(value, least.get(size, math.inf))
    figure = new_figure(height_in=4.2)
    ax = dress(figure.add_subplot())
    ax.plot(*np.reshape(points, (-1, 2)).T, "o", ms=4.5, color=QUIET, label="tried")
    line = np.reshape(sorted(least.items()), (-1, 2)).T
    ax.plot(*line, color=FAINT, lw=1.2, zorder=1, label="least of its size")
    chosen = next((row for row in path if row.chosen), None)
    taken = ""
    if chosen is not None:
        taken = f" Chosen: {', '.join(map(pretty_term, chosen.terms))}."
        at = [point for (row, _), point in zip(known, points, strict=True) if row is chosen]
        look: dict[str, Any] = {"ms": 11, "mec": MARK, "mfc": "none", "mew": 2}
        ax.plot(*np.reshape(at, (-1, 2)).T, "o", **look, label="chosen")
    ax.set_xticks(sorted(least))
    ax.set_xlabel("number of terms")
    symbol = coefficient_symbol(found.target)
    if held_out:
        ax.set_ylabel(f"rms error of {symbol} on cycles left out [-]")
        ax.set_ylim(bottom=0.0)
    else:
        ax.set_ylabel("score above the least (extended BIC)")
        ax.set_yscale("symlog", linthresh=10.0)
        ax.set_ylim(-2.5, 3.0 * max(10.0, *(value for _, value in points)))
    legend_above(figure, ax, columns=4)
    what = "error on cycles left out" if held_out else "score above the least"
    each = ", ".join(f"{size}: {value:.3g}" for size, value in sorted(least.items())) or "not known"
    return Picture.of(
        "Structures by size",
        figure,
        f"Least {what}, by number of terms: {each}.{taken}",
        "Each mark is a structure that was tried and has that number. More terms that do not lower "
        "it by much are not needed; the least error alone does not choose, since some structure of "
        "many is best by luck.",
    )
