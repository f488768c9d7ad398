"""The first screen of a report: the answer in words, and the characteristic that it states."""

from __future__ import annotations

import numpy as np

from comparisons.page.blocks import Part, Picture, Summary
from comparisons.page.style import (
    FAINT,
    coefficient_symbol,
    dress,
    estimator_styles,
    legend_above,
    new_figure,
    printable,
    robust_limits,
)
from comparisons.results import SYMBOLS, Answer, Curve, Truth
from surge_core.rounding import round_to_error

# So small a figure stays legible at the width of a phone.
WIDTH_IN, HEIGHT_IN = 4.8, 4.1
POINTS_DRAWN = 2000
BAND = 1.96
CENTRAL = (1.0, 95.0)


def answer_part(answer: Answer, truth: Truth | None = None) -> Part:
    """Return the first screen of a section.

    Parameters
    ----------
    answer : Answer
        What it says.
    truth : Truth, optional
        τ and characteristic of a simulated record.
    """
    items = list(answer.lines)
    if truth is not None:
        items.insert(1, ("true τ of the simulated rig", f"{1e3 * truth.time_constant_s:g} ms"))
    picture = None if answer.curve is None else curve_picture(answer.curve, answer.estimator, truth)
    return Part("", (Summary(answer.test, tuple(items), picture),))


def curve_picture(curve: Curve, estimator: str = "", truth: Truth | None = None) -> Picture:
    """Draw a characteristic with its band over the scored points, where φ was scored.

    Parameters
    ----------
    curve : Curve
        The characteristic.
    estimator : str
        Key of what found it, for its colour.
    truth : Truth, optional
        The characteristic of a simulated record.
    """
    figure = new_figure(WIDTH_IN, HEIGHT_IN)
    ax = dress(figure.add_subplot())
    step = -(-curve.measured.size // POINTS_DRAWN)
    phi, measured = curve.measured_phi[::step], curve.measured[::step]
    rising = curve.rising[::step]
    # The lag holds the points off the curve, on one side as φ falls and on the other as it rises.
    for label, rows, mark in (("φ falling", ~rising, "v"), ("φ rising", rising, "^")):
        ax.plot(
            phi[rows], measured[rows], mark, ms=2.5, mew=0, color=FAINT, label=f"measured, {label}"
        )
    colour = estimator_styles([estimator or "classic_ml"])[estimator or "classic_ml"].colour
    band = curve.value - BAND * curve.stderr, curve.value + BAND * curve.stderr
    ax.fill_between(curve.phi, *band, color=colour, alpha=0.25, lw=0, label="95 % band")
    symbol = coefficient_symbol(curve.target, quasi_steady=True)
    ax.plot(curve.phi, curve.value, color=colour, lw=2.0, label=symbol + r"$(\varphi)$")
    if truth is not None:
        low, high = curve.valid_phi
        drawn = (truth.phi >= low) & (truth.phi <= high)
        known = truth.phi[drawn], truth.quasi_steady[drawn]
        ax.plot(*known, color="black", lw=1.4, ls=(0, (1, 1.5)), label=printable(truth.label))
    # Rows just behind the entry into stall lie far above the curve, by the lag.
    ends = np.percentile(curve.measured, CENTRAL) if curve.measured.size else np.zeros(0)
    ax.set_ylim(*robust_limits(curve.value, ends, margin=0.12))
    ax.set_xlabel(r"flow coefficient $\varphi$ [-]")
    word = "pressure" if curve.target == "psi_p" else "work"
    ax.set_ylabel(f"{word} coefficient {coefficient_symbol(curve.target)} [-]")
    legend_above(figure, ax)
    at = [
        f"{round_to_error(float(value), float(error))} at φ = {phi:.3f}"
        for phi, value, error in zip(curve.phi, curve.value, curve.stderr, strict=True)
    ]
    name = f"{SYMBOLS[curve.target]}_QS"
    shown = f"{at[0]} and {at[-1]}" if at else "nowhere"
    return Picture.of(
        f"{name} over φ",
        figure,
        f"{name} over φ: {shown}.",
        f"{name} with its 95 % band where φ was scored. The lag holds the measured points off "
        "the curve, on one side as φ falls and on the other as it rises.",
    )
