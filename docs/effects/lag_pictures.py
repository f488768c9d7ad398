"""Pictures of what a hidden effect leaves in the residual of the lag model."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from lag_effects import PICTURE_SEED, Hidden, hidden
from numpy.typing import NDArray

from comparisons.page.style import ACCENT, INK, MARK, dress, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_hidden", "save_picture"]

FloatArray = NDArray[np.float64]
DOTS = "#b4b4b4"
RISING, FALLING = ACCENT, MARK
DPI = 100
COLOURS = 128
STRETCH_S = 4.0
BINS = 36
LEAST_IN_BIN = 12


def draw_hidden(name: str, stretch_s: float = STRETCH_S) -> Figure:
    """Draw the residual of the lag model without an effect: over the test, over cycles, over φ.

    Parameters
    ----------
    name : str
        Of the effect.
    stretch_s : float
        How much of a record the second panel shows, in seconds.
    """
    from matplotlib.figure import Figure

    one = hidden(name, PICTURE_SEED)
    figure = Figure(figsize=(8.2, 4.9), dpi=DPI, layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=[1.0, 1.25], width_ratios=[1.25, 1.0])
    whole, cycles = dress(figure.add_subplot(grid[0, :])), dress(figure.add_subplot(grid[1, 0]))
    over_phi = dress(figure.add_subplot(grid[1, 1]))
    left, pure = _residuals(one)
    starts = np.cumsum([0, *(record.phi.size for record in one.test.records)])
    runs = [slice(int(a), int(b)) for a, b in pairwise(starts)]
    time_s = np.concatenate([record.time_s for record in one.test.records])
    for run in runs:
        _envelope(whole, one, time_s[run], pure[run])
    whole.set_xlabel("facility clock [s]", fontsize=9)
    whole.set_ylabel("residual [noise rms]", fontsize=9)
    whole.set_title(
        "the three records, without the noise: range and mean of each cycle", fontsize=9, loc="left"
    )
    whole.margins(x=0.01)
    _cycles(cycles, one, runs, time_s, left, pure, stretch_s)
    _over_phi(over_phi, one, pure)
    return figure


def _residuals(one: Hidden) -> tuple[FloatArray, FloatArray]:
    """Return what the model leaves of the measured ψ' and of ψ' without noise, over the noise.

    A few τ behind its start a run shows nothing of how it was started; before, both are left out.
    """
    d = one.diagnosis
    run = d.before.output(d.data)
    clean = np.concatenate(one.test.clean)
    left, pure = (np.array(y - run) / one.test.sigma for y in (d.data.measured, clean))
    lead = int(np.ceil(8.0 * d.tau_before_s / d.data.sample_period_s))
    for rows in d.data.slices:
        for values in (left, pure):
            values[rows.start : rows.start + lead] = np.nan
    return left, pure


def _envelope(ax: Axes, one: Hidden, time_s: FloatArray, pure: FloatArray) -> None:
    """Draw range and mean of the residual over each surge cycle of a record."""
    data = one.diagnosis.data
    width = max(round(data.surge_s / data.sample_period_s), 2)
    n = pure.size // width
    cycles = pure[: n * width].reshape(n, width)
    kept = np.isfinite(cycles).all(axis=1)
    middle = time_s[: n * width].reshape(n, width).mean(axis=1)[kept]
    low, high, mean = (f(cycles[kept], axis=1) for f in (np.min, np.max, np.mean))
    ax.fill_between(middle, low, high, color=DOTS, alpha=0.6, lw=0)
    ax.plot(middle, mean, color=INK, lw=1.4)


def _cycles(
    ax: Axes,
    one: Hidden,
    runs: list[slice],
    time_s: FloatArray,
    left: FloatArray,
    pure: FloatArray,
    stretch_s: float,
) -> None:
    run = runs[1]
    middle = 0.5 * (time_s[run][0] + time_s[run][-1])
    shown = np.flatnonzero(np.abs(time_s - middle) <= 0.5 * stretch_s)
    phi = np.concatenate([record.phi for record in one.test.records])
    rising = np.gradient(phi) > 0.0
    ax.plot(time_s[shown], left[shown], ".", color=DOTS, ms=3)
    for colour, state in ((RISING, rising), (FALLING, ~rising)):
        ax.plot(time_s[shown], np.where(state[shown], pure[shown], np.nan), color=colour, lw=1.6)
    ax.set_xlabel("facility clock [s]", fontsize=9)
    ax.set_ylabel("residual [noise rms]", fontsize=9)
    ax.set_title("some cycles of the second (dots: with the noise)", fontsize=9, loc="left")
    ax.margins(x=0.01)


def _over_phi(ax: Axes, one: Hidden, pure: FloatArray) -> None:
    phi = np.concatenate([record.phi for record in one.test.records])
    rate = np.concatenate([np.gradient(record.phi) for record in one.test.records])
    edges = np.linspace(phi.min(), phi.max(), BINS + 1)
    place = np.digitize(phi, edges) - 1
    for colour, state, label in (
        (RISING, rate > 0.0, "φ rising"),
        (FALLING, rate <= 0.0, "φ falling"),
    ):
        rows = [pure[(place == b) & state & np.isfinite(pure)] for b in range(BINS)]
        kept = [b for b in range(BINS) if rows[b].size >= LEAST_IN_BIN]
        middle = 0.5 * (edges[kept] + edges[[b + 1 for b in kept]])
        mean = np.array([rows[b].mean() for b in kept])
        low, high = (np.array([np.quantile(rows[b], q) for b in kept]) for q in (0.1, 0.9))
        ax.fill_between(middle, low, high, color=colour, alpha=0.18, lw=0)
        ax.plot(middle, mean, color=colour, lw=1.6, label=label)
    ax.axhline(0.0, color=INK, lw=0.7)
    ax.set_xlabel("flow coefficient φ", fontsize=9)
    ax.set_title("over φ: mean, and 10 to 90 %", fontsize=9, loc="left")
    legend(ax, loc="best")


def save_picture(figure: Figure, file: Path) -> None:
    """Write a figure as a PNG of few colours, the same bytes for the same picture.

    Parameters
    ----------
    figure : matplotlib Figure
        With its own resolution.
    file : path
        Its file.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    # Matplotlib's canvas carries no types.
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3])
    few = pixels.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    file.parent.mkdir(parents=True, exist_ok=True)
    few.save(file, optimize=True)
