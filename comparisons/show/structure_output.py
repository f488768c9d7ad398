"""What the command `structure` found, as the parts of a page."""

from __future__ import annotations

import numpy as np

from comparisons.harness.fit_quality import trusted_range
from comparisons.harness.structure_fit import FoundStructure
from comparisons.page.blocks import Part, Picture
from comparisons.results import Curve
from comparisons.show.plots_curve import curve_picture
from surge_core.display import Grid


def structure_parts(found: FoundStructure) -> tuple[Part, ...]:
    """Return the parts of a report section on the terms of the characteristic."""
    sheet = found.sheet()
    # A ledger has a line for each of its entries.
    rows = tuple(
        (field.label if number == 0 else "", line)
        for field in sheet.fields
        for number, line in enumerate(field.lines)
    )
    fields = Grid(sheet.title, ("quantity", "value"), rows, frozenset({0, 1}))
    structure = Part("Structure", (fields, *sheet.grids))
    if found.refused:
        return (structure,)
    return structure, Part("Characteristic", (_picture(found),))


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
