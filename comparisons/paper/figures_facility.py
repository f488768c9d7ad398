"""Figure 10: what surrounds the compressor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from classic_ml.flow import LBM_KG
from comparisons.page.style import (
    ACCENT,
    INK,
    MARK,
    new_figure,
)
from comparisons.paper.figures_common import (
    MACHINE,
    MEDIUM,
    OUTSIDE,
    PSI_PA,
    RANKINE_PER_K,
    VOLUME,
    PaperFigure,
    add_arrow,
    add_box,
    case_table,
)
from comparisons.paper.instabilities import InstabilityRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_facility"]

CUBIC_FEET_PER_M3 = 35.3147


def draw_facility(run: InstabilityRun) -> PaperFigure:
    """Draw Figure 10: what surrounds the compressor in the rig, with its numbers.

    Parameters
    ----------
    run : InstabilityRun
        The test whose plant is described.
    """
    case, truth = case_table(run), run.rig.truth
    figure = new_figure(height_in=MEDIUM)
    ax = figure.add_subplot()
    ax.set_axis_off()
    ax.set_xlim(0.0, 18.0)
    ax.set_ylim(0.6, 8.8)
    row = 4.4
    add_box(ax, (0.1, row), (2.5, 1.8), "refrigeration\nplant", OUTSIDE)
    add_box(ax, (3.6, row - 0.4), (2.7, 2.6), _volume("inlet\nvolume", case, "inlet"), VOLUME)
    _compressor(ax, row)
    discharge = _volume("discharge\nvolume", case, "discharge")
    add_box(ax, (10.7, row - 0.4), (2.4, 2.6), discharge, VOLUME)
    _valve(ax, 13.75, row + 0.9)
    ax.text(13.75, row + 2.05, "throttle", ha="center", fontsize=8.5)
    exhaust = _volume("exhaust\nvolume", case, "exhaust")
    add_box(ax, (14.4, row - 0.4), (2.4, 2.6), exhaust, VOLUME)
    for begin, end in ((2.6, 3.6), (6.3, 7.3), (9.7, 10.7), (13.1, 13.45), (14.05, 14.4)):
        add_arrow(ax, (begin, row + 0.9), (end, row + 0.9))
    add_arrow(ax, (16.8, row + 0.9), (17.9, row + 0.9))
    ax.text(17.35, row + 1.15, "stack", ha="center", fontsize=8.5)
    _coil(ax, row)
    _plane(ax, 6.8, row, "25", truth)
    _plane(ax, 10.2, row, "31", truth)
    flow = float(truth["W25_kg_s"][0])
    volumes = ", ".join(
        f"{name} {case[f'{name}_volume_m3']:.2f} m³ "
        f"({CUBIC_FEET_PER_M3 * case[f'{name}_volume_m3']:.0f} ft³)"
        for name in ("inlet", "discharge", "exhaust")
    )
    caption = (
        "What surrounds the compressor in the simulated rig, drawn from its parameters; the "
        f"paper's drawing shows the real cell. Volumes: {volumes}. Near stall "
        f"{flow / LBM_KG:.1f} lbm/s ({flow:.1f} kg/s) pass. Discharge volume and throttle set the "
        "surge cycle; the inlet volume, which the reversed gas heats, and the refrigeration, which "
        "keeps on pumping, make inlet pressure and temperature rise."
    )
    return PaperFigure(
        10, "Schematic of the simulated test facility", figure, caption, "Test Facility Schematic."
    )


def _volume(name: str, case: dict[str, Any], key: str) -> str:
    size = float(case[f"{key}_volume_m3"])
    return f"{name}\n{size:.2f} m³\n({CUBIC_FEET_PER_M3 * size:.0f} ft³)"


def _compressor(ax: Axes, row: float) -> None:
    from matplotlib.patches import Polygon

    shape = [(7.3, row - 0.6), (9.7, row + 0.4), (9.7, row + 1.4), (7.3, row + 2.4)]
    ax.add_patch(Polygon(shape, closed=True, facecolor=MACHINE, edgecolor=INK, linewidth=1.0))
    ax.text(8.4, row + 0.9, "compressor\n10 stages", ha="center", va="center", fontsize=8.5)


def _valve(ax: Axes, x: float, y: float) -> None:
    from matplotlib.patches import Polygon

    for side in (-1.0, 1.0):
        shape = [(x, y), (x + 0.3 * side, y - 0.5), (x + 0.3 * side, y + 0.5)]
        ax.add_patch(Polygon(shape, closed=True, facecolor="white", edgecolor=INK, linewidth=1.0))


def _coil(ax: Axes, row: float) -> None:
    """Draw the way of the inlet's heat back through the refrigeration coil."""
    top = row + 3.4
    ax.plot([4.95, 4.95, 1.35], [row + 2.2, top, top], color=MARK, lw=1.2)
    add_arrow(ax, (1.35, top), (1.35, row + 1.8), MARK)
    ax.text(
        3.15, top + 0.12, "heat returns through the coil", ha="center", fontsize=8.5, color=MARK
    )
    ax.annotate(
        "",
        (4.95, row - 0.55),
        (8.4, row - 0.55),
        arrowprops={
            "arrowstyle": "-|>",
            "color": MARK,
            "lw": 1.2,
            "connectionstyle": "arc3,rad=-0.25",
        },
    )
    ax.text(
        6.7, row - 1.75, "reversed flow, tip recirculation", ha="center", fontsize=8.5, color=MARK
    )


def _plane(ax: Axes, x: float, row: float, plane: str, truth: Any) -> None:
    """Draw a measuring plane with its steady state near stall."""
    ax.plot([x, x], [row - 0.9, row + 2.9], color=ACCENT, lw=1.2, linestyle=(0, (3, 2)))
    ax.text(x, row + 3.05, f"plane {plane}", ha="center", fontsize=9, color=ACCENT, weight="bold")
    pressure = float(truth[f"P{plane}_Pa"][0])
    temperature = float(truth[f"T{plane}_K"][0])
    text = (
        f"near stall\n{pressure / PSI_PA:.1f} psia ({pressure / 1e3:.0f} kPa)\n"
        f"{RANKINE_PER_K * temperature:.0f} °R ({temperature:.0f} K)"
    )
    ax.text(x, row - 2.2, text, ha="center", va="top", fontsize=8.5, color=ACCENT)
