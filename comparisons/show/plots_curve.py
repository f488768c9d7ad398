"""Pictures of curves: characteristics over φ, and the error of a reconstruction over τ."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.harness.fit_quality import dwelt_on
from comparisons.page import style
from comparisons.page.blocks import Picture
from comparisons.results import SYMBOLS, Comparison, Curve, EstimatorResult, TauTrial, Truth
from comparisons.results.names import NAMES
from surge_core.fit_state import WITHHOLDING
from surge_core.rounding import round_to_error, significant
from surge_core.segments import intervals_where
from surge_core.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Standard errors that a band takes: of several curves, and of one, where it is that of 95 %.
BAND, BAND95 = 2.0, 1.96
# Share of the picture's height that the histogram under the curves takes.
HISTOGRAM_BINS = 60
HISTOGRAM_SHARE = 0.32
COLUMN = "#bcc5d0"
# So small a figure stays legible at the width of a phone.
WIDTH_IN, HEIGHT_IN = 4.8, 4.1
POINTS_DRAWN = 2000
CENTRAL = (1.0, 95.0)
HEADROOM = 0.08


def characteristics(comparison: Comparison, truth: Truth | None = None) -> Picture:
    """Draw each estimator's quasi-steady characteristic over the histogram of φ (Fig 23 to 26).

    Curves with bands of ± 2 standard errors, each where the φ of its own rows dwells.
    """
    first = comparison.first
    rows, ends = first.rows, first.model.valid_phi
    scored_phi = _scored_phi(first)
    symbol = style.coefficient_symbol(rows.target, quasi_steady=True)
    called = f"quasi-steady {NAMES[rows.target].rpartition(' ')[0]} {symbol} [-]"
    figure, ax = style.panel(style.PHI, called, 6.0)
    _histogram_behind(ax, scored_phi, ends)
    seen, shown = [], []
    for result in comparison.results:
        phi, value, stderr = np.asarray(result.model.table).T
        low, high = result.model.valid_phi
        inside = (phi >= low) & (phi <= high) & dwelt_on(phi, _scored_phi(result))
        if result.state in WITHHOLDING or not (inside.any() and np.isfinite(value[inside]).all()):
            continue
        seen.append(value[inside])
        _curve_with_band(ax, comparison, result, inside)
        at_ends = (
            round_to_error(float(np.interp(end, phi, value)), float(np.interp(end, phi, stderr)))
            + f" at φ = {end:.3f}"
            for end in (low, high)
        )
        shown.append(f"{result.label} {' and '.join(at_ends)}")
    if truth is not None:
        _draw_truth(ax, truth, ends)
        seen.append(truth.quasi_steady[(truth.phi >= ends[0]) & (truth.phi <= ends[1])])
        if truth.phi[0] <= ends[0] and ends[1] <= truth.phi[-1]:
            true = (significant(v, 3) for v in np.interp(ends, truth.phi, truth.quasi_steady))
            shown.append(f"{truth.label} {' and '.join(true)}")
    central = np.percentile(rows.measured, [2.0, 98.0])
    bottom, top = style.robust_limits(*seen, central, margin=0.12)
    ax.set_ylim(bottom - HISTOGRAM_SHARE * 0.5 * (top - bottom), top)
    ax.set_xlim(*style.robust_limits(scored_phi, margin=0.02))
    style.legend_above(figure, ax)
    known = "" if truth is None else f" Dotted black: {truth.label}."
    return Picture(
        f"Quasi-steady {NAMES[rows.target]}",
        figure,
        f"Quasi-steady {SYMBOLS[rows.target]} over φ, the histogram that of {first.label}. "
        f"{'; '.join(shown)}.",
        "As Fig 23 to 26 of the paper. Bands are ± 2 standard errors of scatter. Shaded: where "
        f"the φ of {first.label} dwells, from 5th to 95th percentile. Each curve is "
        f"drawn where the φ of its own rows dwells.{known}",
    )


def curve_picture(
    curve: Curve,
    estimator: str = "",
    truth: Truth | None = None,
    *,
    histogram: bool = False,
    more: str = "",
) -> Picture:
    """Draw a characteristic with its band over the scored points, where φ was scored.

    Its colour is that of the estimator that found it; with ``histogram`` that of φ stands behind,
    in a larger picture; ``more`` are further words on how to read it.
    """
    size = (6.0,) if histogram else (HEIGHT_IN, WIDTH_IN)
    called = NAMES[curve.target].rpartition(" ")[0]
    words = f"{called} {style.coefficient_symbol(curve.target)} [-]"
    figure, ax = style.panel(style.PHI, words, *size)
    if histogram:
        _histogram_behind(ax, curve.measured_phi, curve.valid_phi)
    step = -(-curve.measured.size // POINTS_DRAWN)
    phi, measured = curve.measured_phi[::step], curve.measured[::step]
    rising = curve.rising[::step]
    # Where φ moves fast, the lag holds the points off the curve.
    for label, rows, mark, grey in (
        ("φ falling", ~rising, "v", style.QUIET),
        ("φ rising", rising, "^", style.FAINT),
    ):
        look: dict[str, Any] = {"ms": 3.0, "mew": 0, "color": grey}
        ax.plot(phi[rows], measured[rows], mark, **look, label=f"measured, {label}")
    colour = style.estimator_styles([estimator or "classic_ml"])[estimator or "classic_ml"].colour
    if np.any(np.isfinite(curve.stderr)):
        band = curve.value - BAND95 * curve.stderr, curve.value + BAND95 * curve.stderr
        ax.fill_between(curve.phi, *band, color=colour, alpha=0.25, lw=0, label="95 % band")
    symbol = style.coefficient_symbol(curve.target, quasi_steady=True)
    ax.plot(curve.phi, curve.value, color=colour, lw=2.0, label=symbol + r"$(\varphi)$")
    if truth is not None:
        _draw_truth(ax, truth, curve.valid_phi)
    # Rows just behind the entry into stall lie far above the curve, by the lag.
    ends = np.percentile(curve.measured, CENTRAL) if curve.measured.size else np.zeros(0)
    ax.set_ylim(*style.robust_limits(curve.value, ends, margin=0.12))
    style.legend_above(figure, ax, columns=3 if histogram else 2)
    at = [
        f"{round_to_error(float(value), float(error))} at φ = {phi:.3f}"
        for phi, value, error in zip(curve.phi, curve.value, curve.stderr, strict=True)
    ]
    name = f"{SYMBOLS[curve.target]}_QS"
    shown = f"{at[0]} and {at[-1]}" if at else "nowhere"
    return Picture(
        f"{name} over φ",
        figure,
        f"{name} over φ: {shown}.",
        f"{name} with its 95 % band where φ was scored. Where φ moves fast, the lag holds the "
        f"measured points off the curve. {more}".rstrip(),
    )


def tau_trial(trial: TauTrial, true_tau_s: float | None = None) -> Picture:
    """Draw the reconstruction error over τ with what the estimators found.

    Error of the free run with the curve refitted to each τ; shaded, the values of τ that are no
    worse within two paired errors; each estimator as a ring at its τ and the error of its own
    reconstruction, with ± 2 standard errors.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    words = f"rms of the reconstruction of {style.coefficient_symbol(trial.target)} [-]"
    figure, ax = style.panel(r"time constant $\tau$ [ms]", words, 4.8)
    _trial_errors(ax, trial)
    low, high = (1e3 * edge for edge in trial.interval_s)
    label = "no worse within two paired errors"
    ax.axvspan(low, high, color=style.SHADE, lw=0, zorder=0, label=label)
    _trial_estimates(ax, trial)
    if true_tau_s is not None:
        ax.axvline(1e3 * true_tau_s, color=style.QUIET, lw=1.0, ls=(0, (1, 1.5)))
        title = f"dotted: truth, {1e3 * true_tau_s:.3g} ms"
        ax.set_title(title, fontsize=8.5, color=style.QUIET, loc="right")
    ax.set_xscale("log")
    ax.set_xlim(1e3 * float(trial.tau_s[0]), 1e3 * float(trial.tau_s[-1]))
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    style.legend_above(figure, ax, columns=2)
    found = ", ".join(
        f"{result.label} {1e3 * result.model.time_constant_s:.3g} ms"
        for result, _ in trial.estimates
    )
    where = (
        "the scored rows of the free run through the unfiltered signals"
        if any(result.whole_run is not None for result, _ in trial.estimates)
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


def _draw_truth(ax: Axes, truth: Truth, ends: tuple[float, float]) -> None:
    drawn = (truth.phi >= ends[0]) & (truth.phi <= ends[1])
    dots: dict[str, Any] = {"color": "black", "lw": 1.5, "linestyle": (0, (1, 1.5))}
    label = style.printable(truth.label)
    ax.plot(truth.phi[drawn], truth.quasi_steady[drawn], **dots, label=label)


def _scored_phi(result: EstimatorResult) -> FloatArray:
    """Return φ of the rows that hold the curve: a whole run's in forward flow."""
    trusted = result.rows.phi if result.whole_run is None else result.whole_run.trusted_phi
    return trusted if trusted.size else result.rows.phi


def _curve_with_band(
    ax: Axes, comparison: Comparison, result: EstimatorResult, inside: BoolArray
) -> None:
    phi, value, stderr = np.asarray(result.model.table).T
    own = style.estimator_styles(each.name for each in comparison.results)[result.name]
    look: dict[str, Any] = {"color": own.colour, "linestyle": own.dashes}
    full = np.where(inside, value, np.nan)
    ax.plot(phi, full, **look, lw=1.8, label=style.printable(result.label))
    ends = value - BAND * stderr, value + BAND * stderr
    ax.fill_between(phi, *ends, where=inside.tolist(), color=own.colour, alpha=0.16, lw=0)


def _histogram_behind(ax: Axes, phi: FloatArray, valid_phi: tuple[float, float]) -> None:
    density, edges = np.histogram(phi, bins=HISTOGRAM_BINS, density=True)
    behind = ax.twinx()
    behind.set_zorder(0)
    ax.set_zorder(1)
    ax.patch.set_visible(False)
    # A record can leave a hole in the range: there the curve rests on nothing.
    grid = np.linspace(*valid_phi, 400)
    for start, stop in intervals_where(dwelt_on(grid, phi)):
        behind.axvspan(grid[start], grid[stop - 1], color=style.SHADE, lw=0)
    # Entries of the legend for what lies on the axes behind.
    ax.fill([], [], color=style.SHADE, label=r"where $\varphi$ dwells (5th to 95th percentile)")
    ax.fill([], [], color=COLUMN, label=r"histogram of $\varphi$")
    behind.stairs(density, edges, fill=True, color=COLUMN, lw=0)
    top = float(density.max())
    behind.set_ylim(0.0, top / HISTOGRAM_SHARE)
    words = r"histogram: share of rows per unit $\varphi$"
    behind.set_ylabel(words, fontsize=8.5, color="#777777", loc="bottom")
    behind.set_yticks([0.0, top], ["0", f"{top:.2g}"])
    behind.tick_params(labelsize=8, colors="#777777")
    behind.spines[:].set_visible(False)


def _trial_errors(ax: Axes, trial: TauTrial) -> None:
    tau_ms, best_ms = 1e3 * trial.tau_s, 1e3 * trial.best_tau_s
    ax.plot(
        tau_ms, trial.refitted_rms, color=style.INK, lw=2.0, label=r"curve refitted to each $\tau$"
    )
    label = f"least error, at {best_ms:.3g} ms"
    ax.plot(best_ms, trial.least_rms, "v", color=style.INK, markersize=7, label=label)
    own = [rms for _, rms in trial.estimates]
    shown = np.concatenate([trial.refitted_rms, own, [trial.least_rms]])
    bottom, top = float(np.nanmin(shown)), float(np.max(shown[np.isfinite(shown)]))
    pad = HEADROOM * (top - bottom)
    ax.set_ylim(max(bottom - pad, 0.0), top + pad)


def _trial_estimates(ax: Axes, trial: TauTrial) -> None:
    """Mark each estimator at its τ and its own error, with ± 2 standard errors of τ."""
    styles = style.estimator_styles(result.name for result, _ in trial.estimates)
    for number, (result, rms) in enumerate(trial.estimates):
        model, colour = result.model, styles[result.name].colour
        tau_ms, reach_ms = 1e3 * model.time_constant_s, 1e3 * BAND * model.time_constant_stderr_s
        # Open marks, so that those of one τ do not hide each other.
        ring: dict[str, Any] = {"mfc": "none", "mec": colour, "mew": 1.6, "zorder": 4}
        label = f"{style.printable(result.label, 34)}, {tau_ms:.3g} ms"
        ax.plot(tau_ms, rms, "o", **ring, markersize=5.0 + 2.5 * number, label=label)
        if math.isfinite(reach_ms):
            # On a logarithmic axis an interval that reaches zero has no left end.
            ends = [max(tau_ms - reach_ms, 1e-3 * tau_ms), tau_ms + reach_ms]
            ax.plot(ends, [rms] * 2, color=colour, lw=1.6, solid_capstyle="butt")
