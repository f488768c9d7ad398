"""The page of the command `structure`: one HTML file with its pictures in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comparisons.harness.structure_fit import FoundStructure
from comparisons.page.blocks import Block, Head, Part, Picture, Table, Words
from comparisons.page.html import render_page
from comparisons.page.style import (
    FAINT,
    coefficient_symbol,
    dress,
    estimator_styles,
    legend_above,
    new_figure,
    robust_limits,
)
from comparisons.show.structure_output import left_out_words, opening_words
from surge_core.terms import pretty_term

POINTS_DRAWN = 4000
BAND = 1.96


def structure_report(found: FoundStructure, *, command: str = "sindy-surge structure") -> str:
    """Return all that is known as one self-contained HTML page.

    Parameters
    ----------
    found : FoundStructure
        From :func:`find_structure`.
    command : str
        The command line that made it.
    """
    names = ", ".join(Path(record.source).name for record in found.records)
    return render_page(
        [(names, structure_parts(found))],
        title=f"Structure of the characteristic of {names}",
        command=command,
    )


def structure_parts(found: FoundStructure) -> tuple[Part, ...]:
    """Return the parts of a report section on the terms of the characteristic.

    Parameters
    ----------
    found : FoundStructure
        From :func:`find_structure`.
    """
    opening = Words(opening_words(found) + ".")
    code, advice = found.state
    if found.refused:
        refusal = Words(f"No structure ({code}): {advice}", "caution")
        return (Part("Structure", (opening, refusal)),)
    return (
        Part("Structure", (opening, *_summary(found), Words(left_out_words(found)))),
        Part("Characteristic", (_curve_picture(found),)),
    )


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
    return (fields, *map(Table.of, sheet.grids))


def _curve_picture(found: FoundStructure) -> Picture:
    """Draw the characteristic with its band over the measured points and the histogram of φ."""
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
