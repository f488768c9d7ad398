"""What all counterparts of the paper's figures share: the value, units, shading, migrations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.flow import LBM_KG
from classic_ml.records import Record, fault_name
from comparisons.page.style import INK, MARK, QUIET, SHADE, dress, new_figure
from surge_core.segments import runs_of
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from comparisons.paper.instabilities import InstabilityRun

__all__ = [
    "CYCLES_S",
    "HIGH",
    "INCEPTION_S",
    "MACHINE",
    "MEDIUM",
    "OUTSIDE",
    "PAPER_THRESHOLD_LBM_S",
    "PSI_PA",
    "RANKINE_PER_K",
    "TRUTH",
    "VOLUME",
    "PaperFigure",
    "add_arrow",
    "add_box",
    "between",
    "case_table",
    "clipped_rows",
    "cycles_s",
    "kilograms_above",
    "kpa_right",
    "mark_time",
    "one_panel",
    "panels",
    "pounds",
    "secondary_y",
    "shade_band",
    "shade_unstalled",
    "stall_time_s",
]

PSI_PA = 6_894.757_293
RANKINE_PER_K = 1.8
# Paper, "Model Identification for 98.5% Corrected Speed".
PAPER_THRESHOLD_LBM_S = 50.0
# Fig 11: the quasi-steady cycles of the identification.
CYCLES_S = (1.8, 3.6)
# Fig 7 to 9 and 12 to 15 give no times; the first cycles after the blowdown are to be seen in them.
INCEPTION_S = (0.0, 2.2)

MEDIUM = 4.8
HIGH = 6.6
BAND = "#e2edf6"
# Boxes of the schematics.
VOLUME, MACHINE, OUTSIDE = "#dcebf5", "#f6ead2", "#f2f2f2"
# How the rig's own signals and curves are drawn in every picture.
TRUTH: dict[str, Any] = {
    "color": INK,
    "lw": 1.0,
    "linestyle": (0, (1, 1.2)),
    "label": "truth of the rig",
}


@dataclass(frozen=True)
class PaperFigure:
    """The counterpart of one figure of the paper.

    Parameters
    ----------
    number : int
        Number of the figure in the paper.
    title : str
        What is drawn, in a few words.
    figure : Figure
        The picture.
    caption : str
        What is shown and what to see in it, with numbers computed from the data.
    paper_caption : str
        The caption in the paper.
    """

    number: int
    title: str
    figure: Figure
    caption: str
    paper_caption: str


def one_panel(height_in: float = MEDIUM) -> tuple[Figure, Axes]:
    """Return a figure of the common width with one pair of dressed axes."""
    figure = new_figure(height_in=height_in)
    return figure, dress(figure.add_subplot())


def panels(rows: int, columns: int = 1, height_in: float = HIGH, **options: Any) -> Any:
    """Return a figure of the common width and an array of dressed axes."""
    figure = new_figure(height_in=height_in)
    grid = figure.subplots(rows, columns, squeeze=False, **options)
    for ax in grid.flat:
        dress(ax)
    return figure, grid


def pounds(kilograms: ArrayLike) -> FloatArray:
    """Return a mass flow in lbm/s."""
    return np.asarray(kilograms, dtype=np.float64) / LBM_KG


def secondary_y(ax: Axes, factor: float, label: str, offset: float = 0.0) -> None:
    """Add the SI unit on the right: SI = factor · shown + offset."""
    axis = ax.secondary_yaxis(
        "right",
        functions=(
            lambda shown: np.asarray(shown) * factor + offset,
            lambda si: (np.asarray(si) - offset) / factor,
        ),
    )
    axis.set_ylabel(label, fontsize=9, color=QUIET)
    axis.tick_params(labelsize=8.5, colors=QUIET)
    axis.spines["right"].set_color("#888888")


def kpa_right(ax: Axes) -> None:
    """Add kPa on the right of an axis in psia."""
    secondary_y(ax, 1e-3 * PSI_PA, "[kPa]")


def kilograms_above(ax: Axes) -> None:
    """Add kg/s above an axis in lbm/s."""
    axis = ax.secondary_xaxis(
        "top",
        functions=(lambda v: np.asarray(v) * LBM_KG, lambda v: np.asarray(v) / LBM_KG),
    )
    axis.set_xlabel("[kg/s]", fontsize=9, color=QUIET)
    axis.tick_params(labelsize=8.5, colors=QUIET)
    axis.spines["top"].set_color("#888888")


def between(time_s: FloatArray, span_s: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the rows of a span of time."""
    return np.asarray((time_s >= span_s[0]) & (time_s <= span_s[1]))


def shade_unstalled(
    ax: Axes, time_s: FloatArray, in_stall: NDArray[np.bool_], label: str = "unstalled"
) -> None:
    """Shade the unstalled stretches of a picture over time."""
    shown: str | None = label
    for run in runs_of(in_stall, in_stall.size):
        if not in_stall[run.start]:
            last = min(run.stop, time_s.size - 1)
            low, high = float(time_s[run.start]), float(time_s[last])
            ax.axvspan(low, high, color=SHADE, lw=0, zorder=0, label=shown)
            shown = None


def shade_band(ax: Axes, low: float, high: float, label: str, *, across: bool = False) -> None:
    """Shade a range of the vertical axis, or with ``across`` of the horizontal one."""
    span = ax.axvspan if across else ax.axhspan
    # Above the shaded regimes, below the grid.
    span(low, high, color=BAND, lw=0, zorder=0.2, label=label)


def mark_time(
    ax: Axes, at: float, text: str, *, colour: str = MARK, height: float = 0.97, left: bool = False
) -> None:
    """Draw a dashed line at a time or frequency, with a word along it on one of its sides."""
    ax.axvline(at, color=colour, lw=0.9, linestyle="--")
    ax.annotate(
        text,
        (at, height),
        xycoords=("data", "axes fraction"),
        xytext=(-4 if left else 4, 0),
        textcoords="offset points",
        fontsize=8.5,
        color=colour,
        ha="right" if left else "left",
        va="top",
        rotation=90,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
    )


def add_box(
    ax: Axes, at: tuple[float, float], size: tuple[float, float], text: str, colour: str
) -> None:
    """Draw one box of a schematic, with its words in the middle."""
    from matplotlib.patches import FancyBboxPatch

    x, y = at
    width, height = size
    ax.add_patch(
        FancyBboxPatch(
            (x, y),
            width,
            height,
            boxstyle="round,pad=0,rounding_size=0.08",
            facecolor=colour,
            edgecolor=INK,
            linewidth=1.0,
        )
    )
    ax.text(x + width / 2, y + height / 2, text, ha="center", va="center", fontsize=8.5, color=INK)


def add_arrow(
    ax: Axes, begin: tuple[float, float], end: tuple[float, float], colour: str = INK
) -> None:
    """Draw an arrow of a schematic."""
    ax.annotate(
        "",
        end,
        begin,
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.2, "shrinkA": 0, "shrinkB": 0},
    )


def case_table(run: InstabilityRun) -> dict[str, Any]:
    """Return the parameters of the rig's case."""
    return dict(run.rig.truth_parameters["case"])


def stall_time_s(run: InstabilityRun) -> float:
    """Return when the machine first stalled, by the rig's own word."""
    times = run.rig.truth_parameters["stall_times_s"]
    return float(times[0]) if times else float(run.rig.truth.time_s[0])


def cycles_s(run: InstabilityRun) -> tuple[float, float]:
    """Return when the quasi-steady cycles were found to begin and end.

    The paper's reduction may name a part of them alone.
    """
    return run.reduction.window_s


def clipped_rows(record: Record) -> NDArray[np.bool_]:
    """Return the rows in which a transducer of plane 25 is at the end of its range."""
    prefix = fault_name("P25")
    clipped = np.zeros(record.n_samples, dtype=np.bool_)
    for name, channel in record.channels.items():
        if name.startswith(prefix):
            clipped |= channel.values > 0.0
    return clipped
