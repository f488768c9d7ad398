"""Pictures of what was added to a lag model, each with what it shows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.shown import (
    contributions,
    held_out_run,
    steady_curves,
    stretch,
)
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

    from comparisons.missing_effect.diagnosis import Diagnosis
    from comparisons.missing_effect.shown import Curve
    from comparisons.missing_effect.where import Where
    from surge_core.types import FloatArray

__all__ = [
    "AFTER",
    "BEFORE",
    "characteristics_before_and_after",
    "contributions_in_time",
    "plot_curves",
    "residual_spectra",
]

BEFORE, AFTER = MARK, ACCENT
TINY = 7.5
# Curves that lie closer than this share of the noise are one line in the picture.
SAME = 0.01
POINTS_DRAWN = 4000
# Of a spectrum, along its axis.
STEPS = 160
_DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))


def characteristics_before_and_after(d: Diagnosis) -> Picture:
    """Draw the characteristic before and after, and the difference of the two.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    figure = new_figure(height_in=6.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1])
    scored = d.data.scored()
    step = -(-int(np.count_nonzero(scored)) // POINTS_DRAWN)
    phi = d.data.sampled(d.data["phi"])[scored]
    dress(upper).plot(
        phi[::step],
        d.data.measured[scored][::step],
        ".",
        ms=2.6,
        color=FAINT,
        label="measured, with the lag in it",
    )
    old = steady_curves(d.before, d.data)
    new = steady_curves(d.after, d.data) if d.missing else ()
    values = plot_curves(upper, old, new)
    upper.set_ylim(*robust_limits(*values, d.data.measured[scored], margin=0.06))
    upper.set_ylabel(r"$\psi'$, $\psi'_{\mathrm{QS}}$ [-]")
    dress(lower).axhline(0.0, color=INK, lw=0.8)
    for number, curve in enumerate(new):
        difference = curve.value - old[0].value
        lower.plot(curve.phi, difference, color=AFTER, lw=1.6, ls=_DASHES[number % len(_DASHES)])
    lower.axhspan(-d.gap.floor_rms, d.gap.floor_rms, color=SHADE, lw=0, label="± noise")
    lower.set_ylabel("after − before" if new else "nothing added")
    lower.set_xlabel(r"flow coefficient $\varphi$ [-]")
    legend(lower, loc="best")
    legend_above(figure, upper, columns=4)
    return Picture.of(
        "Characteristic before and after",
        figure,
        _curve_words(d, old[0], new),
        "As a slow sweep would draw it: with two branches where there is hysteresis, at both ends "
        "of the test where it drifts. The measured points lie off the curve by the lag.",
    )


def contributions_in_time(d: Diagnosis) -> Picture:
    """Draw what each effect adds to the free run, over all records and in a held-out stretch.

    Parameters
    ----------
    d : Diagnosis
        One that found something.

    Returns
    -------
    Picture
        A row for each effect: the free run less the same with its amplitude at zero.
    """
    parts = contributions(d)
    data, run = d.data, held_out_run(d)
    shown = stretch(d, run)
    figure = new_figure(height_in=0.9 + 1.9 * len(parts))
    panels = figure.subplots(len(parts), 2, squeeze=False, width_ratios=[1.7, 1], sharey="row")
    for row, part in zip(panels, parts, strict=True):
        value = part.value
        for ax in row:
            dress(ax).axhspan(-d.gap.floor_rms, d.gap.floor_rms, color=SHADE, lw=0)
            ax.axhline(0.0, color=INK, lw=0.8)
        row[0].plot(*broken(run.time_s, value, list(data.slices)), color=ACCENT, lw=0.6)
        row[1].plot(run.time_s[shown], value[shown], color=ACCENT, lw=1.4)
        row[0].axvspan(run.time_s[shown][0], run.time_s[shown][-1], color=MARK, alpha=0.15, lw=0)
        row[0].set_title(
            f"{printable(part.effect)}: rms {part.rms:.3g}, {part.rms / d.gap.floor_rms:.1f} times "
            "the noise",
            fontsize=9,
            loc="left",
            color=INK,
        )
        row[0].set_ylabel(r"in $\psi'$ [-]")
        row[0].set_ylim(*robust_limits(value, margin=0.12))
    panels[0][1].set_title("the shaded stretch", fontsize=9, loc="left", color=INK)
    for ax in panels[-1]:
        ax.set_xlabel("facility clock [s]", fontsize=9)
    shown_words = "; ".join(
        f"{part.effect} rms {part.rms:.3g}, {part.rms / d.gap.floor_rms:.1f} times the noise, at "
        f"most {np.nanmax(np.abs(part.value)):.3g}"
        for part in parts
    )
    return Picture.of(
        "Contribution of each effect in time",
        figure,
        f"What each effect adds to ψ' in the free run: {shown_words}.",
        "The free run with everything, less the same with this effect's amplitude at zero and all "
        "other numbers as they are; the band is the noise. A part of it the model before could "
        "mimic with another τ and another curve: that part does not show in the residual.",
    )


def residual_spectra(before: Where, after: Where | None = None) -> Picture:
    """Draw the spectrum of the residual before and after over that of the noise.

    Parameters
    ----------
    before, after : Where
        Of the model before and after.
    """
    figure = new_figure(height_in=4.0)
    ax = dress(figure.add_subplot())
    highest = 1.0
    alone = after is None
    for where, colour, label in (
        (before, AFTER if alone else BEFORE, "the model" if alone else "before"),
        (after, AFTER, "after"),
    ):
        if where is None:
            continue
        # The last line, at half the sample rate, has no bandwidth of its own.
        shown = (where.spectrum_hz > 0.0) & (where.spectrum_hz < where.spectrum_hz[-1])
        frequency, ratio = thinned(where.spectrum_hz[shown], where.spectrum_ratio[shown], STEPS)
        ax.loglog(frequency, ratio, color=colour, lw=1.5, label=label)
        highest = max(highest, float(ratio.max()))
    ax.axhline(1.0, color=INK, lw=1.0, ls=(0, (5, 2)), label="noise")
    ax.set_ylim(0.3, max(2.0 * highest, 5.0))
    ax.set_xlim(float(before.spectrum_hz[1]), float(before.spectrum_hz[-1]))
    marked = False
    for line in before.lines:
        if line.harmonic > 1:
            continue
        ax.axvline(line.frequency_hz, color=QUIET, lw=0.8, ls=(0, (2, 2)), zorder=1)
        word = "surge" if line.source == "flow" else f"{line.frequency_hz:.3g} Hz"
        if line.source == "flow" and marked:
            continue
        marked = marked or line.source == "flow"
        ax.annotate(
            word,
            (line.frequency_hz, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(2, -2),
            textcoords="offset points",
            va="top",
            fontsize=TINY,
            color=QUIET,
        )
    plain_numbers(ax.xaxis, ax.yaxis)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("power of the residual over the noise's")
    legend_above(figure, ax)
    largest = []
    for where, word in ((before, "" if alone else " before"), (after, " after")):
        if where is not None:
            row = max(where.frequency, key=lambda each: each.ratio)
            band = f"{row.low_hz:.3g} to {row.high_hz:.3g} Hz"
            largest.append(f"largest{word} in {band}, {row.ratio:.3g} times")
    return Picture.of(
        "Spectrum of the residual",
        figure,
        f"Power of the residual over that of the noise: {'; '.join(largest)}.",
        "At 1 there is nothing but noise. Peaks at surge and its harmonics follow φ; a rise at the "
        "left is drift; a line far above surge is cells that turn.",
    )


def plot_curves(ax: Axes, before: tuple[Curve, ...], after: tuple[Curve, ...]) -> list[FloatArray]:
    """Draw the characteristics of two models and return their values.

    Parameters
    ----------
    ax : Axes
        Where.
    before, after : tuple of Curve
        Of the model before and after; the second is empty where nothing was added.
    """
    for curves, colour, word in ((before, BEFORE, "before"), (after, AFTER, "after")):
        for number, curve in enumerate(curves):
            words = (word if after else "the model", curve.label)
            ax.plot(
                curve.phi,
                curve.value,
                color=colour if after else AFTER,
                lw=1.7,
                ls=_DASHES[number % len(_DASHES)],
                label=", ".join(filter(None, words)),
            )
    return [curve.value for curve in (*before, *after)]


def _curve_words(d: Diagnosis, old: Curve, new: tuple[Curve, ...]) -> str:
    """Say the ends of the characteristics before and after, and where they part most."""
    ends = f"{old.value[0]:.3g} to {old.value[-1]:.3g}"
    words = (
        f"Quasi-steady characteristic over φ from {old.phi[0]:.3g} to {old.phi[-1]:.3g}: {ends} by "
        f"the model{' before' if d.missing else ''}"
    )
    if not d.missing:
        return f"{words}; nothing was added."
    after = []
    for curve in new:
        difference = curve.value - old.value
        at = int(np.argmax(np.abs(difference)))
        apart = f"furthest from it, {difference[at]:+.2g}, at φ = {curve.phi[at]:.3g}"
        same = abs(difference[at]) < SAME * d.gap.floor_rms
        label = f", {curve.label}" if curve.label else ""
        ends = f"{curve.value[0]:.3g} to {curve.value[-1]:.3g}"
        after.append(f"{ends} after{label}, {'the same' if same else apart}")
    return f"{words}; {'; '.join(after)}."
