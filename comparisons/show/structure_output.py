"""What the command `structure` found, as text and as the parts of a page."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np

from comparisons.harness.fit_quality import trusted_range
from comparisons.harness.structure_fit import FoundStructure
from comparisons.page.blocks import Part, Picture, Words
from comparisons.results import Curve
from comparisons.show.plots_curve import curve_picture
from surge_core.display import Grid
from surge_core.terms import pretty_term

WIDTH = 100
# One in a hundred resampled records is no evidence for a term.
LEAST_INCLUSION = 0.01
QUOTE = (
    "The τ to quote is that of `sindy-surge compare`, which sets other estimators beside this one."
)


def structure_text(found: FoundStructure) -> str:
    """Return all that is known as text of at most 100 columns."""
    lines = _wrapped(_opening(found))
    if found.refused:
        code, advice = found.state
        return "\n".join([*lines, "", *_wrapped(f"no structure ({code}): {advice}")])
    return "\n".join([*lines, "", found.summary.sheet().text(), *_wrapped(_left_out(found)), QUOTE])


def structure_parts(found: FoundStructure) -> tuple[Part, ...]:
    """Return the parts of a report section on the terms of the characteristic."""
    opening = Words(f"{_opening(found)}.")
    code, advice = found.state
    if found.refused:
        refusal = Words(f"No structure ({code}): {advice}", "caution")
        return (Part("Structure", (opening, refusal)),)
    sheet = found.summary.sheet()
    # A ledger has a line for each of its entries.
    rows = tuple(
        (field.label if number == 0 else "", line)
        for field in sheet.fields
        for number, line in enumerate(field.lines)
    )
    fields = Grid(sheet.title, ("quantity", "value"), rows, frozenset({0, 1}))
    tables = (fields, *sheet.grids)
    return (
        Part("Structure", (opening, *tables, Words(f"{_left_out(found)} {QUOTE}"))),
        Part("Characteristic", (_picture(found),)),
    )


def _opening(found: FoundStructure) -> str:
    """Say what was fitted, and why that."""
    names = ", ".join(Path(record.source).name for record in found.records)
    return f"ψ' of {names}: {found.phi.size} rows; {found.reason}"


def _wrapped(prose: str) -> list[str]:
    return textwrap.wrap(prose, WIDTH, subsequent_indent="  ", break_on_hyphens=False)


def _left_out(found: FoundStructure) -> str:
    """Say how often terms that were not chosen came up, or why nothing is known of that."""
    known = found.inclusion
    if not known:
        why = f"records are not resampled where a fit ended as {found.state[0]}"
        if found.fitted_to == "whole runs":
            why = "the free run through whole records is not resampled"
        return f"No inclusion probabilities: {why}."
    others = sorted(
        ((p, name) for name, p in known.items() if name not in found.fit.terms_),
        key=lambda pair: -pair[0],
    )
    shown = [f"{pretty_term(name)} {p:.2f}" for p, name in others if p >= LEAST_INCLUSION]
    if not shown:
        return "No other term came up in a resampled record."
    return "Not chosen, yet in some resampled records: " + ", ".join(shown) + "."


def _picture(found: FoundStructure) -> Picture:
    """Draw the characteristic over all φ of the data, with the histogram of φ."""
    phi, value, stderr = found.curve()
    parts = found.summary.parts
    curve = Curve(
        "psi_p",
        parts.terms,
        parts.coef,
        parts.stderr,
        trusted_range(found.phi),
        phi,
        value,
        stderr,
        found.phi,
        found.measured,
        np.gradient(found.phi) > 0.0,
    )
    words = (
        "The curve ends where the data end. The band holds for the terms as they were chosen, not "
        "for another choice; where it leaves the picture the record says nothing. Where few rows "
        "are, the curve rests on the form of its terms."
    )
    return curve_picture(curve, "sindy", histogram=True, more=words)
