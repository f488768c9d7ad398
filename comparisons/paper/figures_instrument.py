"""Figures 1 and 2: where the rig's sensors sit, and one of its rakes."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi, sqrt
from typing import TYPE_CHECKING, Any

from comparisons.page.style import ACCENT, INK, MARK, QUIET, new_figure
from comparisons.paper.figures_common import (
    MACHINE,
    MEDIUM,
    OUTSIDE,
    VOLUME,
    PaperFigure,
    add_arrow,
    case_table,
)
from comparisons.paper.instabilities import InstabilityRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_instrument_figures"]

INCH_M = 0.0254
IMMERSIONS = ("tip", "hub")


def draw_instrument_figures(run: InstabilityRun) -> list[PaperFigure]:
    """Draw the counterparts of Figures 1 and 2: instrument locations and a rake.

    Parameters
    ----------
    run : InstabilityRun
        Any test; its description names the channels.
    """
    return [_locations(run), _rake(run)]


def _locations(run: InstabilityRun) -> PaperFigure:
    from matplotlib.patches import Polygon

    channels = run.rig.test["channels"]
    figure = new_figure(height_in=MEDIUM + 1.2)
    axes = figure.subplots(2, 1, height_ratios=(1.0, 1.25))
    for ax in axes:
        ax.set_axis_off()
    sketch, table = axes
    sketch.set_xlim(0.0, 18.0)
    sketch.set_ylim(0.0, 5.0)
    casing = [(2.0, 4.5), (5.0, 4.5), (13.0, 3.9), (16.0, 3.9)]
    hub = [(16.0, 3.3), (13.0, 3.3), (5.0, 1.9), (2.0, 1.9)]
    sketch.add_patch(Polygon([*casing, *hub], closed=True, facecolor=VOLUME, edgecolor="none"))
    blades = [(5.4, 4.47), (12.6, 3.93), (12.6, 3.23), (5.4, 1.97)]
    sketch.add_patch(Polygon(blades, closed=True, facecolor=MACHINE, edgecolor="none"))
    for edge in (casing, hub):
        sketch.plot(*zip(*edge, strict=True), color=INK, lw=1.2)
    for stage in range(10):
        share = (stage + 0.5) / 10.0
        x = 5.4 + 7.2 * share
        low, high = 1.97 + 1.26 * share, 4.47 - 0.54 * share
        sketch.plot([x, x], [low, high], color=QUIET, lw=1.0)
    sketch.text(9.0, 1.45, "10 stages", ha="center", fontsize=9)
    add_arrow(sketch, (0.6, 3.2), (1.9, 3.2))
    add_arrow(sketch, (16.1, 3.6), (17.4, 3.6))
    for x, plane, low, high in ((3.6, "25", 1.9, 4.5), (14.6, "31", 3.3, 3.9)):
        sketch.plot([x, x], [low, high], color=ACCENT, lw=3.0)
        sketch.text(x, 4.65, f"plane {plane}", ha="center", fontsize=9, color=ACCENT, weight="bold")
        count = sum(entry["plane"] == int(plane) for entry in channels.values())
        sketch.text(
            x, low - 0.55, f"2 rakes, {count} channels", ha="center", fontsize=8.5, color=ACCENT
        )
    sketch.plot([0.4, 17.6], [0.3, 0.3], color=QUIET, lw=1.0, linestyle="-.")
    sketch.text(9.0, 0.5, "axis", ha="center", fontsize=8.5, color=QUIET)
    _channel_table(table, channels)
    pressures = sum(entry["kind"] == "pressure" for entry in channels.values())
    caption = (
        f"Where the rig's {len(channels)} channels sit: at each plane two rakes (A, B), on each "
        "two immersions with a forward and an aft facing pressure probe and one thermocouple, "
        f"{pressures} pressures and {len(channels) - pressures} temperatures in all; below, what "
        "test.toml says of the probes, a and b being the constants of Eq 2. Not to scale."
    )
    return PaperFigure(
        1,
        "Where the instruments of the rig sit",
        figure,
        caption,
        "Dynamic Instrumentation Locations.",
    )


def _channel_table(ax: Axes, channels: Mapping[str, Any]) -> None:
    """Draw one row for each kind of channel, rakes A and B together."""
    rows = []
    for plane in ("25", "31"):
        for immersion in IMMERSIONS:
            entry = channels[f"P{plane}_A_{immersion}_forward"]
            rows.append(
                [
                    f"P{plane}_A/B_{immersion}_forward/aft",
                    "4",
                    entry["unit"],
                    f"a = {entry['probe_slope']:g}, b = {entry['probe_offset']:g}",
                    f"ZOC {entry['zoc_reference_Pa'] / 1e3:.1f} kPa",
                ]
            )
        entry = channels[f"T{plane}_A"]
        rows.append(
            [
                f"T{plane}_A/B",
                "2",
                entry["unit"],
                f"recovery {entry['recovery_factor']:g}",
                f"time constant {1e3 * entry['time_constant_s']:g} ms",
            ]
        )
    drawn = ax.table(
        rows,
        colLabels=["channels", "number", "unit", "probe", "calibration"],
        colWidths=[0.32, 0.09, 0.09, 0.25, 0.25],
        cellLoc="left",
        loc="center",
    )
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(8.5)
    drawn.scale(1.0, 1.35)
    for (row, _), cell in drawn.get_celld().items():
        cell.set_edgecolor("#cccccc")
        cell.set_facecolor(OUTSIDE if row == 0 else "white")


def _rake(run: InstabilityRun) -> PaperFigure:
    from matplotlib.patches import FancyBboxPatch

    case = case_table(run)
    mean, area = float(case["mean_radius_m"]), float(case["inlet_area_m2"])
    # Annulus whose root-mean-square radius is the mean radius: r_t² − r_h² = A/π.
    tip, hub = sqrt(mean**2 + area / (2.0 * pi)), sqrt(mean**2 - area / (2.0 * pi))
    figure = new_figure(height_in=MEDIUM + 0.6)
    ax = figure.add_subplot()
    ax.set_axis_off()
    ax.set_xlim(0.0, 18.0)
    ax.set_ylim(0.0, 10.4)
    ax.fill_between([0.5, 17.5], 9.4, 9.9, color="#d5d5d5", lw=0)
    ax.fill_between([0.5, 17.5], 0.4, 0.9, color="#d5d5d5", lw=0)
    ax.text(
        0.7, 9.65, f"casing, r = {tip:.3f} m ({tip / INCH_M:.1f} in)", va="center", fontsize=8.5
    )
    ax.text(0.7, 0.65, f"hub, r = {hub:.3f} m ({hub / INCH_M:.1f} in)", va="center", fontsize=8.5)
    body = FancyBboxPatch(
        (8.2, 1.8), 1.6, 8.1, boxstyle="round,pad=0,rounding_size=0.3", facecolor=VOLUME, ec=INK
    )
    ax.add_patch(body)
    channels = run.rig.test["channels"]
    for immersion, height in (("tip", 8.0), ("hub", 3.0)):
        entry = channels[f"P25_A_{immersion}_forward"]
        for side, x in ((-1.0, 8.2), (1.0, 9.8)):
            ax.plot([x, x + side * 1.5], [height, height], color=INK, lw=4.0, solid_capstyle="butt")
            ax.plot(x + side * 1.5, height, "o", color="white", markeredgecolor=INK, ms=6)
        ax.text(6.4, height, "forward\n" + r"$P_f$", ha="right", va="center", fontsize=9)
        ax.text(11.6, height, "aft\n" + r"$P_a$", ha="left", va="center", fontsize=9)
        ax.text(
            17.5,
            height,
            f"{immersion} pair\n$M = {entry['probe_slope']:g}\\,M_{{calc}} + "
            f"{entry['probe_offset']:g}$",
            ha="right",
            va="center",
            fontsize=9,
        )
    ax.plot([9.8, 11.3], [5.5, 5.5], color=MARK, lw=2.4)
    ax.plot(11.3, 5.5, "D", color=MARK, ms=6)
    couple = channels["T25_A"]
    ax.text(
        11.6,
        5.5,
        f"aspirated thermocouple\n{1e3 * couple['time_constant_s']:g} ms, "
        f"$T_i/T = {couple['recovery_factor']:g}$",
        va="center",
        fontsize=9,
        color=MARK,
    )
    ax.text(9.0, 5.0, "oil\n100 °F", ha="center", va="center", fontsize=8.5, color=QUIET)
    for height in (7.0, 5.5, 4.0):
        add_arrow(ax, (1.0, height), (3.6, height), ACCENT)
    ax.text(2.3, 7.3, "forward flow", ha="center", fontsize=9, color=ACCENT)
    caption = (
        "One of the two rakes at plane 25 as the rig has it: two immersions, each with a forward "
        f"and an aft probe, in an annulus of {area:.4f} m² between {hub:.3f} and {tip:.3f} m, and "
        "one thermocouple between them. In forward flow the forward probe feels the total pressure "
        "and the aft one the wake; in reversed flow they change places. Not to scale."
    )
    return PaperFigure(
        2, "One rake at plane 25", figure, caption, "Plane 25 Transient Airflow Rake."
    )
