"""Picture of what each added effect contributes to the free run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.shown import contributions, held_out_run, stretch
from comparisons.page.blocks import Picture
from comparisons.page.style import (
    ACCENT,
    INK,
    MARK,
    SHADE,
    broken,
    dress,
    new_figure,
    printable,
    robust_limits,
)

if TYPE_CHECKING:
    from comparisons.missing_effect.diagnosis import Diagnosis

__all__ = ["contributions_in_time"]


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
