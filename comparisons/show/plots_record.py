"""Pictures of a reduced record, each with what it shows: operating points, cycles, spectra."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.flow import LBM_KG
from comparisons.harness.residual_analysis import stall_inception
from comparisons.page.blocks import Picture
from comparisons.page.style import (
    ACCENT,
    FAINT,
    INK,
    MARK,
    QUIET,
    SHADE,
    dress,
    legend_above,
    new_figure,
)
from surge_core.rounding import significant
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axes._secondary_axes import SecondaryAxis

    from classic_ml.reduction import Reduction

__all__ = [
    "cycle_words",
    "hub_and_tip",
    "inlet_spectra",
    "operating_points",
    "span",
    "surge_cycles",
]

CELL_HZ = 82.5  # rotating stall, from interstage wall pressures (paper, p. 3)
# Half the width over which the line of the stall cells is summed up.
CELL_BAND_HZ = 2.0
DECADES_SHOWN = 1e-9
DIGITS = 3


def operating_points(reduction: Reduction) -> Picture:
    """Draw pressure ratio over inlet corrected flow (paper, Fig 9 and 11).

    On the left the whole record with the quasi-steady cycles in colour and the stall inception
    marked, on the right the cycles alone; kg/s below and lbm/s above.

    Parameters
    ----------
    reduction : Reduction
        A reduced record.
    """
    record, keep = reduction.record, _window_rows(reduction)
    flow, ratio = record["Wc25_kg_s"], record["pressure_ratio"]
    figure = new_figure(height_in=5.2)
    whole, cycles = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    for ax in (whole, cycles):
        dress(ax).set_xlabel("inlet corrected flow $W_{c25}$ [kg/s]")
        ax.axvline(0.0, color=INK, lw=0.6)
        _pounds_above(ax)
    _migration(whole, reduction, flow)
    cycles.plot(flow[keep], ratio[keep], color=ACCENT, lw=0.7, alpha=0.8)
    whole.set_ylabel("pressure ratio $P_{31}/P_{25}$ [-]")
    start = None
    if reduction.series.in_stall is not None:
        start = stall_inception(ratio, reduction.series.in_stall, record.sample_rate_hz)
    stall = "The record shows no inception of stall."
    if start is not None:
        at_s = record.time_s[start]
        star: dict[str, Any] = {
            "markersize": 13,
            "markeredgecolor": "white",
            "linestyle": "none",
            "zorder": 5,
        }
        label = f"stall inception, {at_s:.2f} s"
        whole.plot(flow[start], ratio[start], "*", color=MARK, label=label, **star)
        stall = (
            f"Stall begins at {at_s:.2f} s, at a ratio of "
            f"{significant(float(ratio[start]), DIGITS)} and "
            f"{significant(float(flow[start]), DIGITS)} kg/s."
        )
    legend_above(figure, whole)
    from_s, to_s = reduction.window_s
    return Picture.of(
        "Face average",
        figure,
        f"Pressure ratio over inlet corrected flow. Whole record: ratio {span(ratio)}, flow "
        f"{span(flow, 'kg/s')}. Quasi-steady cycles, {from_s:.2f} to {to_s:.2f} s: ratio "
        f"{span(ratio[keep])}, flow {span(flow[keep], 'kg/s')}. {stall}",
        "As Fig 9 (left) and Fig 11 (right) of the paper. The star marks the highest pressure "
        "ratio before the first stall. From there the machine reverses, blows down at reversed "
        "flow and settles into cycles that need not return to the first stall point: the heated "
        "inlet drives corrected speed down.",
    )


def hub_and_tip(reduction: Reduction) -> Picture | None:
    """Draw the operating points of the tip and of the hub probes (paper, Fig 14 and 15).

    Parameters
    ----------
    reduction : Reduction
        A reduced record.

    Returns
    -------
    Picture or None
        Two panels on the same axes; None where the record lacks an immersion.
    """
    record, keep = reduction.record, _window_rows(reduction)
    names = {"tip": "Wc25_tip_kg_s", "hub": "Wc25_hub_kg_s"}
    if not all(name in record for name in names.values()):
        return None
    figure = new_figure(height_in=4.4)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    shown = []
    for ax, (place, name) in zip(panels, names.items(), strict=True):
        _migration(dress(ax), reduction, record[name])
        ax.axvline(0.0, color=INK, lw=0.6)
        ax.set_xlabel(f"{place} probes: $W_{{c25}}$ [kg/s]")
        _pounds_above(ax)
        flow = record[name][keep]
        reverse = 100.0 * float(np.mean(flow < 0.0))
        shown.append(f"{place} {span(flow, 'kg/s')}, reversed {reverse:.0f} % of the time")
    panels[0].set_ylabel("pressure ratio $P_{31}/P_{25}$ [-]")
    legend_above(figure, panels[0])
    return Picture.of(
        "Tip and hub",
        figure,
        "Pressure ratio over the corrected flow of the tip probes and of the hub probes. In the "
        f"quasi-steady cycles: {'; '.join(shown)}.",
        "As Fig 14 and 15 of the paper. Flow at the tip reverses further than at the hub: the "
        "reversal is not axisymmetric, and an average of both hides it.",
    )


def surge_cycles(reduction: Reduction) -> Picture:
    """Draw the quasi-steady cycles in time (paper, Fig 12, 13 and 16 to 19).

    Parameters
    ----------
    reduction : Reduction
        A reduced record.
    """
    record, keep = reduction.record, _window_rows(reduction)
    time_s, in_stall = record.time_s[keep], reduction.series.in_stall
    signals = {
        "inlet corrected flow": ("$W_{c25}$ [kg/s]", record["Wc25_kg_s"][keep], "kg/s"),
        "inlet total pressure": ("$P_{25}$ [kPa]", 1e-3 * record["P25_Pa"][keep], "kPa"),
        "exit total pressure": ("$P_{31}$ [kPa]", 1e-3 * record["P31_Pa"][keep], "kPa"),
        "inlet total temperature": ("$T_{25}$ [K]", record["T25_K"][keep], "K"),
        "corrected speed": ("$N_c$ [% design]", 100.0 * record["Nc_frac"][keep], "% of design"),
    }
    figure = new_figure(height_in=8.2)
    panels = figure.subplots(len(signals), 1, sharex=True)
    for ax, (label, values, _) in zip(panels, signals.values(), strict=True):
        dress(ax).set_ylabel(label)
        if in_stall is not None:
            _shade_unstalled(ax, time_s, in_stall[keep])
        ax.plot(time_s, values, color=ACCENT, lw=1.0)
    panels[0].axhline(0.0, color=INK, lw=0.6)
    _in_pounds(panels[0].secondary_yaxis("right", functions=(_to_pounds, _to_kilograms)), "right")
    panels[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    panels[-1].set_xlabel("facility clock [s]")
    if panels[0].get_legend_handles_labels()[1]:
        legend_above(figure, panels[0])
    figure.align_ylabels(panels)
    always = in_stall is None or bool(np.all(in_stall[record["window"] > 0.5]))
    shaded = "The machine is in stall throughout the window." if always else "Shaded: unstalled."
    spans = "; ".join(f"{name} {span(values, unit)}" for name, (_, values, unit) in signals.items())
    warmer = _drift(time_s, signals["inlet total temperature"][1])
    faster = _drift(time_s, signals["corrected speed"][1])
    return Picture.of(
        "Quasi-steady surge cycles",
        figure,
        f"From {reduction.window_s[0]:.2f} to {reduction.window_s[1]:.2f} s: {spans}. "
        f"{cycle_words(record['P31_Pa'][keep], record.sample_rate_hz)} Over the window the "
        f"temperature drifts by {warmer:+.2g} K and the speed by {faster:+.2g} %.",
        "As Fig 12, 13 and 16 to 19 of the paper. A cycle starts at stall: flow and exit pressure "
        "collapse and the flow reverses; inlet temperature rises in stall and falls as the machine "
        f"recovers; corrected speed mirrors it. {shaded} A slow slope of temperature or speed over "
        "the cycles is the facility, not the compressor.",
    )


def inlet_spectra(reduction: Reduction) -> Picture:
    """Draw the power spectra of inlet pressure and flow before and after the filter (Fig 4 to 6).

    Parameters
    ----------
    reduction : Reduction
        A reduced record.
    """
    from classic_ml.spectra import power_spectrum

    record, settings, keep = reduction.record, reduction.settings, _window_rows(reduction)
    filtered = settings.phase != "none"
    figure = new_figure(height_in=6.6)
    panels = figure.subplots(2, 1, sharex=True)
    signals = {
        "inlet total pressure": ("P25_unfiltered_Pa", "P25_Pa", "$P_{25}$ density [Pa²/Hz]"),
        "inlet corrected flow": (
            "Wc25_unfiltered_kg_s",
            "Wc25_kg_s",
            "$W_{c25}$ density [(kg/s)²/Hz]",
        ),
    }
    shown = []
    for ax, (name, (before, after, label)) in zip(panels, signals.items(), strict=True):
        hertz, raw = power_spectrum(record[before][keep], record.sample_rate_hz)
        density = power_spectrum(record[after][keep], record.sample_rate_hz)[1]
        dress(ax).set_ylabel(label)
        ax.semilogy(hertz[1:], raw[1:], color=FAINT, lw=1.6, label="before the filter")
        word = "after the filter" if filtered else "as used (no filter)"
        ax.semilogy(hertz[1:], density[1:], color=ACCENT, lw=1.1, label=word)
        highest = float(density[1:].max())
        # A filter leaves decades below the converter's noise, where nothing is to be seen.
        ax.set_ylim(
            max(DECADES_SHOWN * highest, 0.5 * float(density[1:].min())),
            4.0 * max(highest, float(raw[1:].max())),
        )
        if filtered:
            ax.axvline(settings.cutoff_hz, color=MARK, lw=0.9, linestyle="--")
        ax.axvline(CELL_HZ, color=INK, lw=0.9, linestyle=":")
        shown.append(_spectrum_words(name, hertz, raw, density, filtered=filtered))
    marks = [(CELL_HZ, f"stall cells, {CELL_HZ:g} Hz", INK)]
    if filtered:
        marks.append((settings.cutoff_hz, f"cut-off, {settings.cutoff_hz:g} Hz", MARK))
    box: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
    for hertz_at, text, colour in marks:
        place: dict[str, Any] = {
            "xycoords": ("data", "axes fraction"),
            "textcoords": "offset points",
        }
        look: dict[str, Any] = {
            "fontsize": 8.5,
            "color": colour,
            "va": "top",
            "rotation": 90,
            "bbox": box,
        }
        panels[0].annotate(text, (hertz_at, 1.0), xytext=(4, -2), **place, **look)
    legend_above(figure, panels[0])
    panels[-1].set_xlim(0.0, min(250.0, 0.5 * record.sample_rate_hz))
    panels[-1].set_xlabel("frequency [Hz]")
    low_pass = "no low-pass was used"
    if filtered:
        low_pass = (
            f"Butterworth of order {settings.filter_order} at {settings.cutoff_hz:g} Hz, phase "
            f"“{settings.phase}”"
        )
    return Picture.of(
        "Inlet total pressure and corrected flow",
        figure,
        f"Power spectra before and after the filter ({low_pass}): {'; '.join(shown)}.",
        "As Fig 4 to 6 of the paper, over the quasi-steady window, first-order trend removed. "
        "The comb at low frequency is the surge cycle and its harmonics; the peak at 82.5 Hz and "
        "its harmonic are rotating stall cells, which a one-dimensional model cannot use. In the "
        "flow the filter attenuates less, and above the cut-off it can add: the flow is a square "
        "root of the filtered pressures, and that makes new harmonics.",
    )


def span(values: FloatArray, unit: str = "") -> str:
    """Return the least and the greatest of a signal's finite values.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The signal.
    unit : str
        Its unit; empty for none.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "not known"
    low, high = (significant(float(end), DIGITS) for end in (finite.min(), finite.max()))
    return f"{low} to {high} {unit}".rstrip()


def _window_rows(reduction: Reduction) -> BoolArray:
    time_s = reduction.record.time_s
    from_s, to_s = reduction.window_s
    return np.asarray((time_s >= from_s) & (time_s <= to_s))


def _migration(ax: Axes, reduction: Reduction, flow: FloatArray) -> None:
    keep, ratio = _window_rows(reduction), reduction.record["pressure_ratio"]
    from_s, to_s = reduction.window_s
    label = f"quasi-steady cycles, {from_s:.2f} to {to_s:.2f} s"
    ax.plot(flow, ratio, color=FAINT, lw=0.9, label="whole record")
    ax.plot(flow[keep], ratio[keep], color=ACCENT, lw=0.9, alpha=0.8, label=label)


def _shade_unstalled(ax: Axes, time_s: FloatArray, in_stall: BoolArray) -> None:
    label: str | None = "unstalled"
    for run in runs_of(in_stall, in_stall.size):
        if not in_stall[run.start]:
            ends = float(time_s[run.start]), float(time_s[run.stop - 1])
            ax.axvspan(*ends, color=SHADE, lw=0, zorder=0, label=label)
            label = None


def _pounds_above(ax: Axes) -> None:
    _in_pounds(ax.secondary_xaxis("top", functions=(_to_pounds, _to_kilograms)), "top")


def _in_pounds(axis: SecondaryAxis, side: str) -> None:
    (axis.set_xlabel if side == "top" else axis.set_ylabel)("[lbm/s]", fontsize=9, color=QUIET)
    axis.tick_params(labelsize=8.5, colors=QUIET)
    axis.spines[side].set_color("#888888")


def _to_pounds(kilograms: ArrayLike) -> ArrayLike:
    return np.asarray(kilograms, dtype=np.float64) / LBM_KG


def _to_kilograms(pounds: ArrayLike) -> ArrayLike:
    return np.asarray(pounds, dtype=np.float64) * LBM_KG


def _spectrum_words(
    name: str, hertz: FloatArray, raw: FloatArray, density: FloatArray, *, filtered: bool
) -> str:
    peak = 1 + int(np.argmax(density[1:]))
    words = f"{name} is strongest at {significant(float(hertz[peak]), DIGITS)} Hz"
    near = np.abs(hertz - CELL_HZ) <= CELL_BAND_HZ
    if not (filtered and near.any() and density[near].sum() > 0.0):
        return words
    change_db = 10.0 * np.log10(density[near].sum() / raw[near].sum())
    return f"{words}, and the filter changes its power at {CELL_HZ:g} Hz by {change_db:+.1f} dB"


def cycle_words(values: FloatArray, sample_rate_hz: float) -> str:
    """Say how long a surge cycle takes: of the pressure, since flow can be stronger at twice it.

    Parameters
    ----------
    values : ndarray of shape (n,)
        The pressure, or its coefficient.
    sample_rate_hz : float
        Its sample rate.
    """
    from comparisons.missing_effect.excitation import surge_frequency_hz

    surge_hz = surge_frequency_hz(values, sample_rate_hz) if np.ptp(values) > 0.0 else 0.0
    if surge_hz <= 0.0:
        return "No cycle stands out."
    period = significant(1e3 / surge_hz, DIGITS)
    return f"A cycle takes {period} ms ({significant(surge_hz, DIGITS)} Hz)."


def _drift(time_s: FloatArray, values: FloatArray) -> float:
    """Return what a straight line through a signal changes over its rows."""
    slope = float(np.polyfit(time_s - time_s[0], values, 1)[0])
    return slope * float(time_s[-1] - time_s[0])
