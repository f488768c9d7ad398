"""The spectrum of a residual, and its mean over a signal, drawn before and after."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.missing_effect.scales import scale_of
from comparisons.missing_effect.where_rows import Where
from comparisons.missing_effect.where_words import SYMBOLS
from comparisons.page.style import ACCENT, INK, MARK, MEASURED, QUIET, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BEFORE, AFTER = MARK, ACCENT
SMALL = 8.5
LONGEST_NAME = 30


def draw_spectrum(ax: Axes, where: Where, *, two: bool) -> None:
    """Draw the power density of the measured output and of the residuals.

    Parameters
    ----------
    ax : Axes
        Where to.
    where : Where
        Of one output.
    two : bool
        Whether the models before and after differ.
    """
    rows = where.frequency
    at = np.array([math.sqrt(max(row.low_hz, 0.5 * rows[0].high_hz) * row.high_hz) for row in rows])
    curves = [("measured_psd", MEASURED, "measured", 2.4)]
    curves += [("before_psd", BEFORE, "residual before", 1.5)] if two else []
    curves.append(("after_psd", AFTER, "residual after" if two else "residual", 1.5))
    for key, colour, label, width in curves:
        values = np.array([getattr(row, key) for row in rows])
        ax.loglog(at, values, color=colour, lw=width, marker=".", ms=4, label=label)
    floor = np.array([row.before_psd / row.ratio for row in rows])
    if np.all(np.isfinite(floor)):
        ax.loglog(at, floor, color=QUIET, lw=1.0, ls=(0, (5, 2)), label="noise")
    unit = where.of.unit
    squared = "1" if unit == "1" else f"{unit}²" if unit.isalpha() else f"({unit})²"
    ax.set_ylabel(printable(f"power density [{squared}/Hz]"), fontsize=SMALL)
    ax.set_xlabel("frequency [Hz]", fontsize=9)
    ax.set_title(f"{_named(where.of.output)}: spectrum", fontsize=9, color=INK, loc="left")


def draw_over_signal(ax: Axes, where: Where, *, two: bool) -> None:
    """Draw the mean residual with two standard errors in ranges of a signal.

    Parameters
    ----------
    ax : Axes
        Where to.
    where : Where
        Of one output.
    two : bool
        Whether the models before and after differ.
    """
    both = [("before", BEFORE, "o")] * two + [("after", AFTER, "s")]
    cells = {key: [getattr(row, key) for row in where.flow] for key, _, _ in both}
    scale = scale_of(where.of.unit, [abs(c["any"].mean) for own in cells.values() for c in own])
    over = scale_of(where.of.signal_unit, [edge for r in where.flow for edge in (r.low, r.high)])
    at = over.factor * np.array([row.at for row in where.flow])
    ax.axhline(0.0, color=INK, lw=0.7)
    for key, colour, marker in both:
        mean = scale.factor * np.array([c["any"].mean for c in cells[key]])
        error = scale.factor * np.array([c["any"].stderr for c in cells[key]])
        look: dict[str, Any] = {
            "color": colour,
            "marker": marker,
            "ms": 3.5,
            "lw": 1.1,
            "elinewidth": 0.9,
        }
        ax.errorbar(at, mean, 2.0 * np.nan_to_num(error), capsize=2.0, **look)
        for way, sign in (("rising", "^"), ("falling", "v")):
            part = scale.factor * np.array([c[way].mean for c in cells[key]])
            ax.plot(at, part, color=colour, marker=sign, ms=3.0, lw=0, alpha=0.45)
    ax.set_ylabel(printable(f"mean residual {scale.bracketed}"), fontsize=SMALL)
    name = _named(where.of.signal)
    simulated = " simulated" if where.of.simulated else ""
    ax.set_xlabel(f"{name}{simulated} {printable(over.bracketed)}", fontsize=9)
    ax.locator_params(axis="x", nbins=6)
    title = f"{_named(where.of.output)}: mean residual over {name}"
    ax.set_title(title, fontsize=9, color=INK, loc="left")


def _named(name: str) -> str:
    return printable(SYMBOLS.get(name, name), LONGEST_NAME)
