"""What the pictures of a diagnosis show, in numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from comparisons.missing_effect.quantities import tau_ms
from comparisons.missing_effect.shown import contributions, held_out_run, steady_curves, stretch
from comparisons.show.plots_missing_effect import title
from surge_core.rounding import significant

if TYPE_CHECKING:
    from comparisons.missing_effect.diagnosis import Diagnosis
    from comparisons.missing_effect.shown import Curve
    from comparisons.missing_effect.where import Where

__all__ = ["characteristics_words", "contributions_words", "diagnosis_words", "spectra_words"]

# Curves that lie closer than this share of the noise are one line in the picture.
SAME = 0.01


def diagnosis_words(d: Diagnosis) -> str:
    """Return what the picture of a diagnosis shows.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    gap, run = d.gap, held_out_run(d)
    shown = stretch(d, run)
    from_s, to_s = run.time_s[shown][0], run.time_s[shown][-1]
    before = f"{significant(gap.before_rms, 3)} and τ {tau_ms(d.tau_before_s)}"
    words = f"{title(d)}. Held-out rms of ψ' {before}"
    if d.missing:
        after = f"{significant(gap.after_rms, 3)} and τ {tau_ms(d.tau_after_s)}"
        words += f" before, {after} after"
    return (
        f"{words}; noise {significant(gap.floor_rms, 3)}. Drawn over time: {from_s:.4g} to "
        f"{to_s:.4g} s, where the model before is worst."
    )


def characteristics_words(d: Diagnosis) -> str:
    """Return what the characteristics before and after show: where they part most.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.
    """
    old = steady_curves(d.before, d.data)[0]
    words = (
        f"Quasi-steady characteristic over φ from {old.phi[0]:.3g} to {old.phi[-1]:.3g}: "
        f"{_ends(old)} by the model{' before' if d.missing else ''}"
    )
    if not d.missing:
        return f"{words}; nothing was added."
    told = []
    for curve in steady_curves(d.after, d.data):
        difference = curve.value - old.value
        at = int(np.argmax(np.abs(difference)))
        label = f", {curve.label}" if curve.label else ""
        apart = f"furthest from it, {difference[at]:+.2g}, at φ = {curve.phi[at]:.3g}"
        same = abs(difference[at]) < SAME * d.gap.floor_rms
        told.append(f"{_ends(curve)} after{label}, {'the same' if same else apart}")
    return f"{words}; {'; '.join(told)}."


def contributions_words(d: Diagnosis) -> str:
    """Return what each effect adds to the free run.

    Parameters
    ----------
    d : Diagnosis
        One that found something.
    """
    floor = d.gap.floor_rms
    told = "; ".join(
        f"{part.effect} rms {part.rms:.3g}, {part.rms / floor:.1f} times the noise, at most "
        f"{np.nanmax(np.abs(part.value)):.3g}"
        for part in contributions(d)
    )
    return f"What each effect adds to ψ' in the free run: {told}."


def spectra_words(before: Where, after: Where | None = None) -> str:
    """Return what the spectra of the residual show.

    Parameters
    ----------
    before, after : Where
        Of the model before and after.
    """
    told = []
    for where, word in ((before, "before" if after is not None else ""), (after, "after")):
        if where is None:
            continue
        row = max(where.frequency, key=lambda r: r.ratio)
        band = f"{row.low_hz:.3g} to {row.high_hz:.3g} Hz"
        told.append(f"largest {word} in {band}, {row.ratio:.3g} times".replace("  ", " "))
    return f"Power of the residual over that of the noise: {'; '.join(told)}."


def _ends(curve: Curve) -> str:
    return f"{curve.value[0]:.3g} to {curve.value[-1]:.3g}"
