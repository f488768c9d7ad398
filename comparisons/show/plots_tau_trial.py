"""Picture of τ by trial: the error of the reconstruction over the τ that is held."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.page import style
from comparisons.page.blocks import Picture
from comparisons.results import SYMBOLS, TauTrial
from surge_core.rounding import significant

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BAND = 2.0
HEADROOM = 0.08


def tau_trial(trial: TauTrial, true_tau_s: float | None = None, *, whole_runs: bool) -> Picture:
    """Draw the reconstruction error over τ with what the estimators found.

    Parameters
    ----------
    trial : TauTrial
        Reconstruction error over τ.
    true_tau_s : float, optional
        Truth of a simulated record, in seconds.
    whole_runs : bool
        Whether the error is that of the free run through the unfiltered signals.

    Returns
    -------
    Picture
        Error of the free run with the curve refitted to each τ; shaded, the values of τ that are
        no worse within two paired errors; each estimator as a ring at its τ and the error of its
        own reconstruction, with ± 2 standard errors.
    """
    figure = style.new_figure(height_in=4.8)
    ax = style.dress(figure.add_subplot())
    _errors(ax, trial)
    low, high = (1e3 * edge for edge in trial.interval_s)
    label = "no worse within two paired errors"
    ax.axvspan(low, high, color=style.SHADE, lw=0, zorder=0, label=label)
    _estimates(ax, trial)
    if true_tau_s is not None:
        ax.axvline(1e3 * true_tau_s, color=style.QUIET, lw=1.0, ls=(0, (1, 1.5)))
        title = f"dotted: truth, {1e3 * true_tau_s:.3g} ms"
        ax.set_title(title, fontsize=8.5, color=style.QUIET, loc="right")
    ax.set_xscale("log")
    ax.set_xlim(1e3 * float(trial.tau_s[0]), 1e3 * float(trial.tau_s[-1]))
    style.plain_numbers(ax.xaxis)
    ax.set_xlabel(r"time constant $\tau$ [ms]")
    ax.set_ylabel(f"rms of the reconstruction of {style.coefficient_symbol(trial.target)} [-]")
    style.legend_above(figure, ax, columns=2)
    found = ", ".join(f"{each.label} {1e3 * each.tau_s:.3g} ms" for each in trial.estimates)
    where = (
        "the scored rows of the free run through the unfiltered signals"
        if whole_runs
        else "the fitted rows, from each segment's own start"
    )
    return Picture(
        "Reconstruction error over τ",
        figure,
        f"Error of the free run of {SYMBOLS[trial.target]} over the τ that is held, "
        f"{1e3 * trial.tau_s[0]:.3g} to {1e3 * trial.tau_s[-1]:.3g} ms: least, "
        f"{significant(trial.least_rms, 3)}, at {1e3 * trial.best_tau_s:.3g} ms, no worse from "
        f"{low:.3g} to {high:.3g} ms." + (f" Found: {found}." if found else ""),
        f"Scored on {where}. As the paper found its 18 ms, by trial. A flat bottom says that the "
        "record hardly determines τ; a least error far from an estimate says that the two answer "
        "different questions. `compare --tau` holds a value.",
    )


def _errors(ax: Axes, trial: TauTrial) -> None:
    tau_ms, best_ms = 1e3 * trial.tau_s, 1e3 * trial.best_tau_s
    ax.plot(
        tau_ms, trial.refitted_rms, color=style.INK, lw=2.0, label=r"curve refitted to each $\tau$"
    )
    label = f"least error, at {best_ms:.3g} ms"
    ax.plot(best_ms, trial.least_rms, "v", color=style.INK, markersize=7, label=label)
    own = [estimate.rms for estimate in trial.estimates]
    shown = np.concatenate([trial.refitted_rms, own, [trial.least_rms]])
    bottom, top = float(np.nanmin(shown)), float(np.max(shown[np.isfinite(shown)]))
    pad = HEADROOM * (top - bottom)
    ax.set_ylim(max(bottom - pad, 0.0), top + pad)


def _estimates(ax: Axes, trial: TauTrial) -> None:
    """Mark each estimator at its τ and its own error, with ± 2 standard errors of τ."""
    styles = style.estimator_styles(estimate.name for estimate in trial.estimates)
    for number, estimate in enumerate(trial.estimates):
        tau_ms, reach_ms = 1e3 * estimate.tau_s, 1e3 * BAND * estimate.stderr_s
        colour = styles[estimate.name].colour
        # Open marks, so that those of one τ do not hide each other.
        ring: dict[str, Any] = {"mfc": "none", "mec": colour, "mew": 1.6, "zorder": 4}
        label = f"{style.printable(estimate.label, 34)}, {tau_ms:.3g} ms"
        ax.plot(tau_ms, estimate.rms, "o", **ring, markersize=5.0 + 2.5 * number, label=label)
        if math.isfinite(reach_ms):
            # On a logarithmic axis an interval that reaches zero has no left end.
            ends = [max(tau_ms - reach_ms, 1e-3 * tau_ms), tau_ms + reach_ms]
            ax.plot(ends, [estimate.rms] * 2, color=colour, lw=1.6, solid_capstyle="butt")
