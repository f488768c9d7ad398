"""Picture of where a residual stands out: time, frequency, flow, cycle phase, regime."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

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
    SHADE,
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
# The strongest colours would swallow the numbers.
PALER = 1.8


def where_picture(data: ResidualRuns, where: Where) -> Picture:
    """Draw the residual over everything that it was looked at over.

    Parameters
    ----------
    data : ResidualRuns
        The residual.
    where : Where
        From :func:`comparisons.missing_effect.where.localise`.

    Returns
    -------
    Picture
        Residual over time with mean and rms of each block; its spectrum over the floor's with
        bands, surge and stall cells; its mean over the cycle, where φ has one; its mean in each
        octile of φ while φ falls and rises; its rms in each record, where there are several.
        Everything is in floors: the rms of the measurement noise is 1. What lies beyond chance is
        red.
    """
    figure = new_figure(height_in=9.2)
    several = len(where.regime) > 1
    outer = figure.add_gridspec(3, 1, height_ratios=[1.0, 1.0, 0.95])
    top = _over_time(figure, outer[0], data, where)
    cyclic = any(math.isfinite(row.z) for row in where.phase)
    widths = [1.65, 1.0] if cyclic else [1.0]
    middle = outer[1].subgridspec(1, len(widths), width_ratios=widths)
    _over_frequency(dress(figure.add_subplot(middle[0])), where)
    if cyclic:
        _over_phase(dress(figure.add_subplot(middle[1])), where)
    widths = [2.1, 1.0] if several else [1.0]
    bottom = outer[2].subgridspec(1, len(widths), width_ratios=widths)
    _over_flow(figure.add_subplot(bottom[0]), where)
    if several:
        _over_regimes(dress(figure.add_subplot(bottom[1])), where)
    legend_above(figure, *top, columns=4)
    return Picture.of(
        "The residual of the model before",
        figure,
        " ".join(where.words),
        "Everything in floors: the rms of the measurement noise is 1. Top: the residual over time "
        "with mean and rms of each block. Middle: its spectrum over the noise's, and its mean over "
        "the surge cycle. Below: its mean where φ was and which way it went, and its rms in each "
        "record. Red: beyond what chance reaches in all these looks together.",
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
            beyond = strongest.z > where.bound_z
            ax.axvspan(
                strongest.from_s, strongest.to_s, color=MARK if beyond else QUIET, alpha=0.18, lw=0
            )
            ax.annotate(
                f"z {strongest.z:.1f}",
                (0.5 * (strongest.from_s + strongest.to_s), 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, -3),
                textcoords="offset points",
                ha="center",
                va="top",
                fontsize=SMALL,
                color=MARK if beyond else QUIET,
            )
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


def _over_frequency(ax: Axes, where: Where) -> None:
    low = float(where.spectrum_hz[1])
    shown = where.spectrum_hz > 0.0
    frequency, ratio = where.spectrum_hz[shown], where.spectrum_ratio[shown]
    ax.loglog(*thinned(frequency, ratio, MOST_POINTS), color=FAINT, lw=0.8, label="spectrum")
    ax.axhline(1.0, color=INK, lw=1.0, ls=(0, (5, 2)), label="floor")
    edges = [max(where.frequency[0].low_hz, low), *(row.high_hz for row in where.frequency)]
    ax.stairs(
        [row.ratio_bound for row in where.frequency],
        edges,
        color=QUIET,
        lw=0.9,
        ls=(0, (1, 1.5)),
        baseline=None,
        label="chance reaches",
    )
    for number, row in enumerate(where.frequency):
        beyond = row.z > where.bound_z
        ax.plot(
            edges[number : number + 2],
            [row.ratio, row.ratio],
            color=MARK if beyond else ACCENT,
            lw=2.4,
            solid_capstyle="butt",
        )
        if beyond:
            ax.annotate(
                f"×{row.ratio:.3g}",
                (math.sqrt(edges[number] * edges[number + 1]), row.ratio),
                xytext=(0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=TINY,
                color=MARK,
            )
    ax.plot([], [], color=ACCENT, lw=2.4, label="mean of a band")
    bottom = min(max(float(np.quantile(ratio, 0.02)), 1e-2), 0.6)
    top = max(float(ratio.max()), 2.0, *(row.ratio_bound for row in where.frequency))
    # Room for the legend below and for the marks above.
    height = math.log(top / bottom)
    ax.set_ylim(bottom * math.exp(-0.45 * height), top * math.exp(0.15 * height))
    ax.set_xlim(low, float(frequency[-1]))
    _mark_lines(ax, where)
    plain_numbers(ax.xaxis, ax.yaxis)
    marks = " (marks: harmonics of surge)" if any(e.harmonic > 1 for e in where.lines) else ""
    ax.set_xlabel(f"frequency [Hz]{marks}", fontsize=9)
    ax.set_ylabel("power over the floor's")
    legend(ax, loc="lower left", ncols=2, fontsize=TINY)


def _mark_lines(ax: Axes, where: Where) -> None:
    written: list[float] = []
    for line in where.lines:
        colour = {"flow": QUIET, "given": ACCENT, "residual": MARK}[line.source]
        if line.harmonic > 1:
            ax.axvline(line.frequency_hz, 0.0, 0.03, color=colour, lw=0.9)
            continue
        ax.axvline(line.frequency_hz, color=colour, lw=0.8, ls=(0, (2, 2)), zorder=1)
        if line.source == "residual":
            near = np.abs(where.spectrum_hz - line.frequency_hz) <= 0.5 * line.width_hz
            top = float(np.max(where.spectrum_ratio[near], initial=0.0))
            ax.plot(line.frequency_hz, top, "v", ms=5, color=MARK, zorder=4)
        text = {"flow": "surge", "given": "cells", "residual": f"{line.frequency_hz:.3g} Hz"}
        close = [other for other in written if abs(math.log(line.frequency_hz / other)) < 0.7]
        # Surge of several records lies close together: it is written once.
        if close and line.source == "flow":
            continue
        ax.annotate(
            text[line.source],
            (line.frequency_hz, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2 + 10 * len(close)),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=TINY,
            color=colour,
        )
        written.append(line.frequency_hz)


def _over_phase(ax: Axes, where: Where) -> None:
    ax.set_xlabel(r"cycles since $\varphi$ rose through its mean", fontsize=9)
    ax.set_ylabel("mean residual [floors]")
    seen = [row for row in where.phase if math.isfinite(row.z)]
    middle = np.array([0.5 * (row.from_cycle + row.to_cycle) for row in seen])
    mean = np.array([row.mean for row in seen]) / where.floor_rms
    reach = where.bound_z * np.array([row.stderr for row in seen]) / where.floor_rms
    ax.axhline(0.0, color=INK, lw=0.8)
    ax.bar(
        middle,
        2.0 * reach,
        bottom=-reach,
        width=1.0 / len(where.phase),
        color=SHADE,
        lw=0,
        label="chance reaches",
    )
    every = np.array([row.mean for row in where.phase]) / where.floor_rms
    ax.plot((np.arange(every.size) + 0.5) / every.size, every, color=ACCENT, lw=1.2)
    for row, x, y in zip(seen, middle, mean, strict=True):
        ax.plot(x, y, "o", ms=4.5, color=MARK if abs(row.z) > where.bound_z else ACCENT)
    ax.set_xlim(0.0, 1.0)
    highest = 1.25 * float(np.max(np.maximum(np.abs(mean), reach)))
    ax.set_ylim(-highest, highest)
    legend(ax, loc="best", fontsize=TINY)


def _over_flow(ax: Axes, where: Where) -> None:
    ways = ("falling", "rising")
    rows = [[row for row in where.flow if row.direction == way] for way in ways]
    mean = np.array([[row.mean / where.floor_rms for row in line] for line in rows])
    finite = np.abs(mean[np.isfinite(mean)])
    # A map of pure noise must not look like one of structure.
    noise = [where.bound_z * row.stderr / where.floor_rms for row in where.flow]
    reach = max(float(finite.max(initial=0.0)), float(np.nanmax([*noise, 0.0])), 1e-12)
    image = ax.imshow(mean, cmap="RdBu_r", vmin=-PALER * reach, vmax=PALER * reach, aspect="auto")
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
    bar = ax.figure.colorbar(image, ax=ax, fraction=0.025, pad=0.01)
    bar.ax.tick_params(labelsize=TINY, colors=INK)
    bar.outline.set_visible(False)


def _over_regimes(ax: Axes, where: Where) -> None:
    place = np.arange(len(where.regime))
    beyond = [row.z > where.bound_z for row in where.regime]
    ax.barh(
        place,
        [row.ratio for row in where.regime],
        color=[MARK if b else ACCENT for b in beyond],
        height=0.55,
        alpha=0.85,
    )
    ax.axvline(1.0, color=INK, lw=1.0, ls=(0, (5, 2)), zorder=3)
    ax.set_yticks(place, [printable(row.record, 16) for row in where.regime], fontsize=SMALL)
    for y, row in zip(place, where.regime, strict=True):
        surge = f", {row.surge_hz:.2g} Hz" if math.isfinite(row.surge_hz) else ""
        ax.text(
            0.02 * max(r.ratio for r in where.regime),
            float(y) + 0.3,
            rf"$\overline{{\varphi}}$ {row.phi_mean:.2f} ± {row.phi_amplitude:.2f}{surge}, "
            f"z {row.z:.1f}",
            va="top",
            fontsize=TINY,
            color=QUIET,
            zorder=4,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
        )
    ax.set_ylim(len(place) - 0.2, -0.6)
    ax.grid(False, axis="y")
    ax.set_xlabel("rms [floors]", fontsize=9)
