"""How pictures look: colours, axes, labels, and their way into a file."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# 9 in wide: sharp on paper, and when a report enlarges it.
DPI = 150
WIDTH_IN = 9.0
INK = "#222222"
MEASURED = "#8f8f8f"
QUIET = "#4d4d4d"
FAINT = "#b8b8b8"
ACCENT = "#0072B2"
MARK = "#D55E00"
SHADE = "#f0ece0"
PHI = r"flow coefficient $\varphi$ [-]"


@dataclass(frozen=True)
class LineStyle:
    """How an estimator is drawn in every picture, apart from others in a print in grey too."""

    colour: str
    dashes: str | tuple[float, tuple[float, ...]]


# Okabe and Ito's palette, for readers with any colour vision; without its yellow,
# which white paper swallows.
KNOWN_STYLES = {
    "classic_ml": LineStyle("#0072B2", "-"),
    "paper": LineStyle("#56B4E9", (0, (7, 1.5))),
    "classic_ml_arx": LineStyle("#E69F00", (0, (6, 2))),
    "classic_ml_output_error": LineStyle("#009E73", (0, (4, 1.5, 1, 1.5))),
    "sindy": LineStyle("#D55E00", (0, (2.5, 1))),
}
SPARE_STYLES = (
    LineStyle("#CC79A7", "-"),
    LineStyle("#7a5c00", (0, (1, 1))),
    LineStyle("#000000", (0, (3, 1, 1, 1))),
)


def estimator_styles(names: Iterable[str]) -> dict[str, LineStyle]:
    """Return the style of each estimator; a known one has the same in every report."""
    spare = cycle(SPARE_STYLES)
    return {name: KNOWN_STYLES.get(name) or next(spare) for name in names}


def new_figure(width_in: float = WIDTH_IN, height_in: float = 5.0) -> Figure:
    """Return an empty figure that no global state knows of."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def dress(ax: Axes) -> Axes:
    """Give axes the quiet look of all pictures."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color("#888888")
    ax.tick_params(colors=INK, labelsize=9)
    ax.grid(True, color="#e4e4e4", linewidth=0.6)
    ax.set_axisbelow(True)
    return ax


def panel(
    x: str, y: str, height_in: float = 5.0, width_in: float = WIDTH_IN
) -> tuple[Figure, Axes]:
    """Return an empty figure of one panel, with the words below and beside it."""
    figure = new_figure(width_in, height_in)
    ax = dress(figure.add_subplot())
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    return figure, ax


def strips(n: int, height_in: float, x: str, **options: Any) -> tuple[Figure, list[Axes]]:
    """Return an empty figure of panels one below the other over one axis, with its words."""
    figure = new_figure(height_in=height_in)
    panels = [dress(ax) for ax in figure.subplots(n, 1, sharex=True, squeeze=False, **options).flat]
    panels[-1].set_xlabel(x)
    return figure, panels


def legend(ax: Axes, **options: Any) -> None:
    """Add a legend that hides nothing of what lies under it."""
    options = {"fontsize": 8.5, "frameon": True, "framealpha": 0.9, "edgecolor": "none"} | options
    ax.legend(**options)


def legend_above(figure: Figure, *panels: Axes, columns: int = 3) -> None:
    """Add one legend above all panels, each name once."""
    entries: dict[str, Any] = {}
    for ax in panels:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(
        entries.values(),
        entries.keys(),
        loc="outside upper left",
        ncols=columns,
        fontsize=8.5,
        frameon=False,
        columnspacing=1.8,
    )


def figure_to_data_uri(figure: Figure) -> str:
    """Return a figure as a PNG in a data URI, the same bytes for the same picture.

    Lines on white need few colours: a palette makes the file a third as large.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    # Matplotlib's canvas carries no types.
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3])
    stream = io.BytesIO()
    picture.quantize(256, dither=Image.Dither.NONE).save(stream, format="png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def coefficient_symbol(target: str, *, quasi_steady: bool = False) -> str:
    """Return ψ' or ψ as mathtext, optionally with the index of the quasi-steady curve."""
    # The prime as a glyph: matplotlib draws that of mathtext as 0 where a font of its is not found.
    symbol = "\\psi\u2032" if target == "psi_p" else r"\psi"
    index = r"_{\mathrm{QS}}" if quasi_steady else ""
    return f"${symbol}{index}$"


def printable(text: str, longest: int = 60) -> str:
    """Return text that a picture can show as it is: no mathtext, no glyph that the font lacks."""
    short = text if len(text) <= longest else text[: longest - 1] + "…"
    known = _glyphs()
    shown = "".join(c if ord(c) in known else "?" for c in short)
    return shown.replace("$", r"\$")


def broken(
    time_s: FloatArray, values: FloatArray, runs: list[slice]
) -> tuple[FloatArray, FloatArray]:
    """Return a signal with a gap between its segments, so that no line joins two."""
    ends = [run.stop for run in runs]
    return np.insert(time_s, ends, np.nan), np.insert(values, ends, np.nan)


def robust_limits(*signals: FloatArray, margin: float = 0.08) -> tuple[float, float]:
    """Return limits of an axis that hold all of the signals but for one row in a thousand."""
    finite = [signal[np.isfinite(signal)] for signal in signals]
    edges = [np.percentile(signal, [0.05, 99.95]) for signal in finite if signal.size]
    if not edges:
        return 0.0, 1.0
    low, high = min(e[0] for e in edges), max(e[1] for e in edges)
    pad = margin * (high - low) or max(abs(high), 1.0) * margin
    return float(low - pad), float(high + pad)


@cache
def _glyphs() -> frozenset[int]:
    from matplotlib.font_manager import findfont
    from matplotlib.ft2font import FT2Font

    return frozenset(FT2Font(findfont("DejaVu Sans")).get_charmap())
