"""Picture of where a residual stands out: over time, over frequency, over flow."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.missing_effect.where_rows import ResidualRuns, Where
from comparisons.missing_effect.where_words import signed
from comparisons.page.blocks import Picture
from comparisons.page.style import (
    ACCENT,
    FAINT,
    INK,
    MARK,
    QUIET,
    broken,
    dress,
    legend,
    legend_above,
    new_figure,
    plain_numbers,
    printable,
    robust_limits,
    thinned,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

__all__ = ["where_picture"]

# More records than these would leave each too narrow to read.
MOST_RECORDS = 4
SMALL = 8.5
TINY = 7.5
MOST_POINTS = 1200
MEAN = "#009E73"
AFTER = "#CC79A7"
OFFSET: dict[str, Any] = {"textcoords": "offset points"}
BELOW_TOP = ("data", "axes fraction")
# The strongest colours would swallow the numbers.
PALER = 1.8


def where_picture(data: ResidualRuns, where: Where, after: Where | None = None) -> Picture:
    """Draw the residual of a model over time, over frequency and over flow.

    Parameters
    ----------
    data : ResidualRuns
        The residual.
    where, after : Where
        From :func:`comparisons.missing_effect.where.localise`; the second of the model with what
        was added.

    Returns
    -------
    Picture
        Residual over time with mean and rms of each block; its spectrum over the noise's, with
        bands and surge, and that after; its mean in each octile of φ while φ falls and rises.
        Everything is in floors: the rms of the measurement noise is 1. What lies beyond chance is
        red.
    """
    figure = new_figure(height_in=9.2)
    outer = figure.add_gridspec(3, 1, height_ratios=[1.0, 1.0, 0.95])
    top = _over_time(figure, outer[0], data, where)
    _over_frequency(dress(figure.add_subplot(outer[1])), where, after)
    _over_flow(figure.add_subplot(outer[2]), where)
    legend_above(figure, *top, columns=4)
    return Picture.of(
        "The residual of the model before",
        figure,
        " ".join(where.words),
        "Everything in floors: the rms of the measurement noise is 1. Top: the residual over time "
        "with mean and rms of each block. Middle: its spectrum over the noise's: peaks at surge "
        "and its harmonics follow φ, a rise at the left is drift, a line far above surge is cells "
        "that turn. Below: its mean where φ was and which way it went. Red: beyond what chance "
        "reaches in all these looks together.",
        said_above=True,
    )


def _over_time(figure: Figure, place: SubplotSpec, data: ResidualRuns, where: Where) -> list[Axes]:
    strongest = max(where.time, key=lambda row: row.z)
    names = _shown_records(where)
    grid = place.subgridspec(1, len(names), wspace=0.04)
    panels: list[Axes] = []
    limits = robust_limits(data.residual[data.scored] / where.floor_rms, margin=0.15)
    for column, name in enumerate(names):
        ax = dress(figure.add_subplot(grid[column]))
        panels.append(ax)
        number = data.record_names.index(name)
        runs = [run for run in data.runs if data.record[run.start] == number]
        values = np.where(data.scored, data.residual / where.floor_rms, np.nan)
        ax.plot(*broken(data.time_s, values, runs), color=FAINT, lw=0.5, label="residual")
        for side in (-1.0, 1.0):
            label = "± floor" if side > 0.0 else None
            ax.axhline(side, color=INK, lw=0.9, ls=(0, (5, 2)), zorder=3, label=label)
        rows = [row for row in where.time if row.record == name]
        edges = [rows[0].from_s, *(row.to_s for row in rows)]
        rms = [row.rms / where.floor_rms for row in rows]
        mean = [row.mean / where.floor_rms for row in rows]
        ax.stairs(rms, edges, color=ACCENT, lw=1.5, baseline=None, zorder=4, label="rms of a block")
        ax.stairs(mean, edges, color=MEAN, lw=1.5, baseline=None, zorder=4, label="mean of a block")
        if strongest.record == name:
            colour = MARK if strongest.z > where.bound_z else QUIET
            ax.axvspan(strongest.from_s, strongest.to_s, color=colour, alpha=0.18, lw=0)
            look: dict[str, Any] = {"ha": "center", "va": "top", "fontsize": SMALL, "color": colour}
            top = (0.5 * (strongest.from_s + strongest.to_s), 1.0)
            words = f"z {strongest.z:.1f}"
            ax.annotate(words, top, xytext=(0, -3), xycoords=BELOW_TOP, **OFFSET, **look)
        ax.set_ylim(*limits)
        ax.set_xlim(edges[0], edges[-1])
        ax.set_title(printable(name, 60 // len(names)), fontsize=9, color=INK, loc="left")
        ax.set_xlabel("facility clock [s]", fontsize=9)
        if column:
            ax.tick_params(labelleft=False)
    panels[0].set_ylabel("residual [floors]")
    return panels


def _shown_records(where: Where) -> list[str]:
    """Return the records that are drawn over time, those with the strongest blocks if not all."""
    strongest: dict[str, float] = {}
    for row in where.time:
        strongest[row.record] = max(strongest.get(row.record, 0.0), row.z)
    chosen = sorted(strongest, key=lambda name: -strongest[name])[:MOST_RECORDS]
    return [name for name in strongest if name in chosen]


def _over_frequency(ax: Axes, where: Where, after: Where | None) -> None:
    highest = lowest = 1.0
    for each, colour, label in ((where, FAINT, "spectrum"), (after, AFTER, "spectrum after")):
        if each is not None:
            # The last line, at half the sample rate, has no bandwidth of its own.
            shown = (each.spectrum_hz > 0.0) & (each.spectrum_hz < each.spectrum_hz[-1])
            line = thinned(each.spectrum_hz[shown], each.spectrum_ratio[shown], MOST_POINTS)
            ax.loglog(*line, color=colour, lw=0.8, label=label)
            highest = max(highest, float(line[1].max()))
            lowest = min(lowest, float(np.quantile(line[1], 0.02)))
    ax.axhline(1.0, color=INK, lw=1.0, ls=(0, (5, 2)), label="floor")
    low = float(where.spectrum_hz[1])
    edges = [max(where.frequency[0].low_hz, low), *(row.high_hz for row in where.frequency)]
    bounds = [row.ratio_bound for row in where.frequency]
    dots: dict[str, Any] = {"color": QUIET, "lw": 0.9, "ls": (0, (1, 1.5)), "baseline": None}
    ax.stairs(bounds, edges, **dots, label="chance reaches")
    for row, ends in zip(where.frequency, pairwise(edges), strict=True):
        beyond = row.z > where.bound_z
        ax.plot(ends, [row.ratio] * 2, color=MARK if beyond else ACCENT, lw=2.4)
        if beyond:
            place = (math.sqrt(ends[0] * ends[1]), row.ratio)
            look: dict[str, Any] = {"ha": "center", "fontsize": TINY, "color": MARK}
            ax.annotate(f"×{row.ratio:.3g}", place, xytext=(0, 3), **OFFSET, **look)
    ax.plot([], [], color=ACCENT, lw=2.4, label="mean of a band")
    bottom, top = min(max(lowest, 1e-2), 0.6), max(2.0, highest, *bounds)
    # Room for the legend below and for the marks above.
    height = math.log(top / bottom)
    ax.set_ylim(bottom * math.exp(-0.45 * height), top * math.exp(0.15 * height))
    ax.set_xlim(low, float(where.spectrum_hz[-1]))
    _mark_lines(ax, where)
    plain_numbers(ax.xaxis, ax.yaxis)
    ax.set_xlabel("frequency [Hz]", fontsize=9)
    ax.set_ylabel("power over the floor's")
    legend(ax, loc="lower left", ncols=3, fontsize=TINY)


def _mark_lines(ax: Axes, where: Where) -> None:
    """Mark surge, cells and what stands out of the residual, each name once."""
    colours = {"flow": QUIET, "given": ACCENT, "residual": MARK}
    written: set[str] = set()
    for line in where.lines:
        if line.harmonic > 1:
            continue
        colour = colours[line.source]
        ax.axvline(line.frequency_hz, color=colour, lw=0.8, ls=(0, (2, 2)), zorder=1)
        names = {"flow": "surge", "given": "cells", "residual": f"{line.frequency_hz:.3g} Hz"}
        text = names[line.source]
        if text in written:
            continue
        written.add(text)
        # What stands out of the residual may lie close to surge: it is written a line higher.
        up = 12 if line.source == "residual" else 2
        look: dict[str, Any] = {"ha": "center", "fontsize": TINY, "color": colour}
        place = (line.frequency_hz, 1.0)
        ax.annotate(text, place, xytext=(0, up), xycoords=BELOW_TOP, **OFFSET, **look)


def _over_flow(ax: Axes, where: Where) -> None:
    ways = ("falling", "rising")
    rows = [[row for row in where.flow if row.direction == way] for way in ways]
    mean = np.array([[row.mean / where.floor_rms for row in line] for line in rows])
    finite = np.abs(mean[np.isfinite(mean)])
    # A map of pure noise must not look like one of structure.
    noise = [where.bound_z * row.stderr / where.floor_rms for row in where.flow]
    reach = max(float(finite.max(initial=0.0)), float(np.nanmax([*noise, 0.0])), 1e-12)
    ax.imshow(mean, cmap="RdBu_r", vmin=-PALER * reach, vmax=PALER * reach, aspect="auto")
    for line, own in enumerate(rows):
        for column, row in enumerate(own):
            known = math.isfinite(row.z)
            beyond = known and abs(row.z) > where.bound_z
            ax.text(
                column,
                line,
                f"{signed(mean[line, column])}\nz {row.z:.1f}" if known else f"{row.n} rows",
                ha="center",
                va="center",
                fontsize=SMALL,
                fontweight="bold" if beyond else "normal",
                color=INK,
            )
    edges = [rows[0][0].phi_from, *(row.phi_to for row in rows[0])]
    ax.set_xticks(np.arange(len(edges)) - 0.5, [f"{edge:.3f}" for edge in edges], fontsize=SMALL)
    ax.set_yticks(
        range(2),
        [
            f"{way}\n{signed(value / where.floor_rms)}"
            for way, value in zip(ways, where.direction_means, strict=True)
        ],
        fontsize=SMALL,
    )
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0, colors=INK)
    ax.set_xlabel(r"octiles of the flow coefficient $\varphi$ [-]", fontsize=9)
    ax.set_title(
        f"mean residual [floors]; falling against rising: z {where.direction_z:.1f}",
        fontsize=9,
        color=MARK if abs(where.direction_z) > where.bound_z else INK,
        loc="left",
    )
