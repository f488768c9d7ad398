"""Pictures of a small system with an effect that its model lacks: check record and errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from system_effects import picture_seed, worst_output
from system_truths_of_pages import NOISE, found

from comparisons.page.style import ACCENT, INK, MARK, MEASURED, SHADE, dress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["draw_system"]

DPI = 100
ROWS_SHOWN = 260
BAND = 2.0
DASHES = (0, (4, 1.4))


def draw_system(name: str) -> Figure:
    """Draw a stretch of the check record, measured and simulated without and with what was found.

    Parameters
    ----------
    name : str
        Of the effect.
    """
    from matplotlib.figure import Figure

    one = found(name, picture_seed(name))
    run = one.diagnosis.checks[0]
    j = worst_output(one)
    unit = one.model.outputs[run.outputs[j]]
    errors = run.measured[:, j] - run.before[:, j]
    sums = np.convolve(errors**2, np.ones(ROWS_SHOWN), "valid")
    # The stretch of middling error: the worst is often a start or a spike.
    first = int(np.argsort(sums[run.settle :])[sums[run.settle :].size // 2]) + run.settle
    rows = slice(first, first + ROWS_SHOWN)
    time_s = one.check.sample_period_s * np.arange(run.measured.shape[0])[rows]
    noise = NOISE * float(np.std(run.measured[:, j]))
    figure = Figure(figsize=(8.2, 4.2), dpi=DPI, layout="constrained")
    upper, lower = (dress(figure.add_subplot(2, 1, k)) for k in (1, 2))
    upper.plot(time_s, run.measured[rows, j], color=MEASURED, lw=3, alpha=0.8, label="measured")
    upper.plot(time_s, run.before[rows, j], color=MARK, lw=1.3, label="without the effect")
    upper.plot(
        time_s,
        run.after[rows, j],
        color=ACCENT,
        lw=1.2,
        ls=DASHES,
        label="with what was found",
    )
    upper.set_ylabel(f"{run.outputs[j]} [{unit}]", fontsize=9)
    upper.legend(loc="lower left", bbox_to_anchor=(0.0, 0.98), ncols=3, fontsize=8.5, frameon=False)
    lower.axhspan(-BAND, BAND, color=SHADE, lw=0)
    lower.axhline(0.0, color=INK, lw=0.7)
    lower.plot(time_s, errors[rows] / noise, color=MARK, lw=1.2)
    after = (run.measured[rows, j] - run.after[rows, j]) / noise
    lower.plot(time_s, after, color=ACCENT, lw=1.0)
    lower.set_ylabel("error [noise rms]", fontsize=9)
    lower.set_xlabel("time [s]", fontsize=9)
    for ax in (upper, lower):
        ax.set_xlim(time_s[0], time_s[-1])
    return figure
