"""Pictures of a record: operating-point migration, surge cycles, spectra, loops."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.coefficients import psi_is_known
from classic_ml.flow import LBM_KG
from classic_ml.series import CoefficientSeries
from comparisons.harness.residual_analysis import stall_inception
from comparisons.page.style import (
    ACCENT,
    FAINT,
    INK,
    MARK,
    QUIET,
    SHADE,
    axes_of,
    coefficient_symbol,
    dress,
    legend,
    legend_above,
    new_figure,
    robust_limits,
)
from surge_core.errors import InputError
from surge_core.segments import runs_of
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from classic_ml.reduction import Reduction

__all__ = [
    "plot_hub_and_tip",
    "plot_inlet_spectra",
    "plot_loops",
    "plot_operating_points",
    "plot_series",
    "plot_surge_cycles",
    "rows_drawn",
    "where_defined",
    "window_rows",
]

CELL_HZ = 82.5  # rotating stall, from interstage wall pressures (paper, p. 3)
FLOW_LABEL = "inlet corrected flow $W_{c25}$ [kg/s]"
LOOP_ROWS = 20_000
DECADES_SHOWN = 1e-9
# Of a longer record only so much is drawn over time.
LONGEST_S = 4.0


def plot_operating_points(reduction: Reduction) -> Figure:
    """Draw pressure ratio over inlet corrected flow (paper, Fig 9 and 11).

    Parameters
    ----------
    reduction : Reduction
        A reduced record.

    Returns
    -------
    Figure
        On the left the whole record in grey with the quasi-steady cycles in colour and the stall
        inception marked, on the right the cycles alone; kg/s below and lbm/s above.
    """
    record = reduction.record
    flow, ratio = record["Wc25_kg_s"], record["pressure_ratio"]
    figure = new_figure(height_in=5.2)
    whole, cycles = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    for ax in (whole, cycles):
        dress(ax)
        ax.set_xlabel(FLOW_LABEL)
        ax.axvline(0.0, color=INK, lw=0.6)
        _pounds_above(ax)
    _migration(whole, reduction, flow)
    start = None
    if reduction.series.in_stall is not None:
        start = stall_inception(ratio, reduction.series.in_stall, record.sample_rate_hz)
    if start is not None:
        whole.plot(
            flow[start],
            ratio[start],
            marker="*",
            markersize=13,
            linestyle="none",
            color=MARK,
            markeredgecolor="white",
            zorder=5,
            label=f"stall inception, {record.time_s[start]:.2f} s",
        )
    keep = window_rows(reduction)
    cycles.plot(flow[keep], ratio[keep], color=ACCENT, lw=0.7, alpha=0.8)
    whole.set_ylabel("pressure ratio $P_{31}/P_{25}$ [-]")
    legend_above(figure, whole)
    return figure


def plot_hub_and_tip(reduction: Reduction) -> Figure | None:
    """Draw the operating points of the tip and of the hub probes (paper, Fig 14 and 15).

    Parameters
    ----------
    reduction : Reduction
        A reduced record.

    Returns
    -------
    Figure or None
        Two panels on the same axes; None where the record lacks an immersion.
    """
    record = reduction.record
    names = {"tip": "Wc25_tip_kg_s", "hub": "Wc25_hub_kg_s"}
    if not all(name in record for name in names.values()):
        return None
    figure = new_figure(height_in=4.4)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for ax, (place, name) in zip(panels, names.items(), strict=True):
        dress(ax)
        _migration(ax, reduction, record[name])
        ax.axvline(0.0, color=INK, lw=0.6)
        ax.set_xlabel(f"{place} probes: $W_{{c25}}$ [kg/s]")
        _pounds_above(ax)
    panels[0].set_ylabel("pressure ratio $P_{31}/P_{25}$ [-]")
    legend_above(figure, panels[0])
    return figure


def plot_surge_cycles(reduction: Reduction) -> Figure:
    """Draw the quasi-steady cycles in time (paper, Fig 12, 13 and 16 to 19).

    Parameters
    ----------
    reduction : Reduction
        A reduced record.

    Returns
    -------
    Figure
        Corrected flow, P25, P31, T25 and corrected speed, one above the other; the unstalled
        stretches shaded.
    """
    record = reduction.record
    keep = window_rows(reduction)
    rows: list[tuple[str, FloatArray]] = [
        ("$W_{c25}$ [kg/s]", record["Wc25_kg_s"]),
        ("$P_{25}$ [kPa]", 1e-3 * record["P25_Pa"]),
        ("$P_{31}$ [kPa]", 1e-3 * record["P31_Pa"]),
        ("$T_{25}$ [K]", record["T25_K"]),
        ("$N_c$ [% design]", 100.0 * record["Nc_frac"]),
    ]
    figure = new_figure(height_in=8.2)
    panels = figure.subplots(len(rows), 1, sharex=True)
    time_s = record.time_s[keep]
    in_stall = reduction.series.in_stall
    for ax, (label, values) in zip(panels, rows, strict=True):
        dress(ax)
        if in_stall is not None:
            _shade_unstalled(ax, time_s, in_stall[keep])
        ax.plot(time_s, values[keep], color=ACCENT, lw=1.0)
        ax.set_ylabel(label)
    panels[0].axhline(0.0, color=INK, lw=0.6)
    secondary = panels[0].secondary_yaxis("right", functions=(_to_pounds, _to_kilograms))
    secondary.set_ylabel("[lbm/s]", fontsize=9, color=QUIET)
    secondary.tick_params(labelsize=8.5, colors=QUIET)
    secondary.spines["right"].set_color("#888888")
    panels[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    panels[-1].set_xlabel("facility clock [s]")
    if panels[0].get_legend_handles_labels()[1]:
        legend_above(figure, panels[0])
    figure.align_ylabels(panels)
    return figure


def plot_inlet_spectra(reduction: Reduction) -> Figure:
    """Draw the power spectra of inlet pressure and flow before and after the filter (Fig 4 to 6).

    Parameters
    ----------
    reduction : Reduction
        A reduced record.

    Returns
    -------
    Figure
        Two panels over the quasi-steady window, first-order trend removed; the filter's cut-off
        and the stall cells marked.
    """
    from classic_ml.spectra import power_spectrum

    record = reduction.record
    keep = window_rows(reduction)
    figure = new_figure(height_in=6.6)
    panels = figure.subplots(2, 1, sharex=True)
    signals = (
        ("P25_unfiltered_Pa", "P25_Pa", "$P_{25}$ density [Pa²/Hz]"),
        ("Wc25_unfiltered_kg_s", "Wc25_kg_s", "$W_{c25}$ density [(kg/s)²/Hz]"),
    )
    filtered = reduction.settings.phase != "none"
    for ax, (before, after, label) in zip(panels, signals, strict=True):
        dress(ax)
        peak = 0.0
        for name, colour, width, word in (
            (before, FAINT, 1.6, "before the filter"),
            (after, ACCENT, 1.1, "after the filter" if filtered else "as used (no filter)"),
        ):
            frequency, density = power_spectrum(record[name][keep], record.sample_rate_hz)
            ax.semilogy(frequency[1:], density[1:], color=colour, lw=width, label=word)
            peak, floor = max(peak, float(density[1:].max())), float(density[1:].min())
        # A filter leaves decades below the converter's noise, where nothing is to be seen.
        ax.set_ylim(max(DECADES_SHOWN * peak, 0.5 * floor), 4.0 * peak)
        if filtered:
            ax.axvline(reduction.settings.cutoff_hz, color=MARK, lw=0.9, linestyle="--")
        ax.axvline(CELL_HZ, color=INK, lw=0.9, linestyle=":")
        ax.set_ylabel(label)
    _mark(panels[0], reduction.settings.cutoff_hz if filtered else None)
    legend_above(figure, panels[0])
    panels[-1].set_xlim(0.0, min(250.0, 0.5 * record.sample_rate_hz))
    panels[-1].set_xlabel("frequency [Hz]")
    return figure


def plot_loops(series: CoefficientSeries, target: str = "psi_p", ax: Axes | None = None) -> Axes:
    """Draw the coefficient over φ, as the record ran through it.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record.
    target : {"psi_p", "psi"}
        Which coefficient.
    ax : Axes, optional
        Where to draw; a new figure without it.

    Returns
    -------
    Axes
        All rows in grey, the rows in the intervals to be fitted in colour.
    """
    ax = axes_of(ax, 5.4)
    values = series.psi_p if target == "psi_p" else where_defined(series)
    if values is None:
        raise InputError(series.source, expected=f"a column {target}", found="none")
    # A longer record would only blacken the paper.
    some = slice(0, LOOP_ROWS)
    phi, shown, scored = series.phi[some], values[some], series.scored[some]
    everything = bool(scored.all())
    if not everything:
        ax.plot(phi, shown, color=FAINT, lw=0.7, label="whole record")
    ax.plot(
        np.where(scored, phi, np.nan),
        np.where(scored, shown, np.nan),
        color=ACCENT,
        lw=0.7,
        alpha=0.7,
        label="record" if everything else "intervals that are fitted",
    )
    ax.set_ylim(*robust_limits(shown))
    ax.set_xlim(*robust_limits(phi))
    ax.set_xlabel(r"flow coefficient $\varphi$ [-]")
    ax.set_ylabel(f"instantaneous {coefficient_symbol(target)} [-]")
    legend(ax, loc="best")
    return ax


def plot_series(series: CoefficientSeries, longest_s: float = LONGEST_S) -> Figure:
    """Draw φ and the coefficients in time, of a record of which no more is known.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record.
    longest_s : float
        Of a longer record only so much is drawn, from the first interval to be fitted on.

    Returns
    -------
    Figure
        φ, ψ' and, where known, ψ, T25 and corrected speed; rows to be fitted in colour.
    """
    rows: list[tuple[str, FloatArray | None]] = [
        (r"$\varphi$ [-]", series.phi),
        (f"{coefficient_symbol('psi_p')} [-]", series.psi_p),
        (f"{coefficient_symbol('psi')} [-]", where_defined(series)),
        ("$T_{25}$ [K]", series.T25_K),
        ("$N_c$ [% design]", None if series.Nc_frac is None else 100.0 * series.Nc_frac),
    ]
    known = [(label, values) for label, values in rows if values is not None]
    keep = rows_drawn(series, longest_s)
    time_s, scored = series.time_s[keep], series.scored[keep]
    figure = new_figure(height_in=1.2 + 1.45 * len(known))
    panels = np.atleast_1d(np.asarray(figure.subplots(len(known), 1, sharex=True)))
    for ax, (label, values) in zip(panels, known, strict=True):
        dress(ax)
        ax.plot(time_s, values[keep], color=FAINT, lw=0.9)
        ax.plot(time_s, np.where(scored, values[keep], np.nan), color=ACCENT, lw=0.9)
        ax.set_ylim(*robust_limits(values[keep]))
        ax.set_ylabel(label)
    panels[-1].set_xlim(float(time_s[0]), float(time_s[-1]))
    panels[-1].set_xlabel("facility clock [s]")
    figure.align_ylabels(list(panels))
    return figure


def rows_drawn(series: CoefficientSeries, longest_s: float = LONGEST_S) -> slice:
    """Return the rows that are drawn over time: from the first interval to be fitted on.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record.
    longest_s : float
        So much of it, in seconds.
    """
    first = int(np.argmax(series.scored)) if series.scored.any() else 0
    count = int(longest_s * series.sample_rate_hz) + 1
    start = max(0, min(first, series.n_samples - count))
    return slice(start, start + count)


def where_defined(series: CoefficientSeries) -> FloatArray | None:
    """Return ψ with a gap where it was interpolated: at small and at reversed flow.

    Parameters
    ----------
    series : CoefficientSeries
        A reduced record.
    """
    if series.psi is None:
        return None
    return np.where(psi_is_known(series.phi), series.psi, np.nan)


def _migration(ax: Axes, reduction: Reduction, flow: FloatArray) -> None:
    record = reduction.record
    from_s, to_s = reduction.window_s
    keep = window_rows(reduction)
    ratio = record["pressure_ratio"]
    ax.plot(flow, ratio, color=FAINT, lw=0.9, label="whole record")
    ax.plot(
        flow[keep],
        ratio[keep],
        color=ACCENT,
        lw=0.9,
        alpha=0.8,
        label=f"quasi-steady cycles, {from_s:.2f} to {to_s:.2f} s",
    )


def window_rows(reduction: Reduction) -> NDArray[np.bool_]:
    """Return the rows of the quasi-steady cycles.

    Parameters
    ----------
    reduction : Reduction
        A reduced record.
    """
    time_s = reduction.record.time_s
    from_s, to_s = reduction.window_s
    return np.asarray((time_s >= from_s) & (time_s <= to_s))


def _shade_unstalled(ax: Axes, time_s: FloatArray, in_stall: NDArray[np.bool_]) -> None:
    label: str | None = "unstalled"
    for run in runs_of(in_stall, in_stall.size):
        if not in_stall[run.start]:
            ax.axvspan(
                float(time_s[run.start]),
                float(time_s[run.stop - 1]),
                color=SHADE,
                lw=0,
                zorder=0,
                label=label,
            )
            label = None


def _mark(ax: Axes, cutoff_hz: float | None) -> None:
    marks = [(CELL_HZ, f"stall cells, {CELL_HZ:g} Hz", INK)]
    if cutoff_hz is not None:
        marks.append((cutoff_hz, f"cut-off, {cutoff_hz:g} Hz", MARK))
    for frequency, text, colour in marks:
        ax.annotate(
            text,
            (frequency, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(4, -2),
            textcoords="offset points",
            fontsize=8.5,
            color=colour,
            va="top",
            rotation=90,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )


def _pounds_above(ax: Axes) -> None:
    secondary = ax.secondary_xaxis("top", functions=(_to_pounds, _to_kilograms))
    secondary.set_xlabel("[lbm/s]", fontsize=9, color=QUIET)
    secondary.tick_params(labelsize=8.5, colors=QUIET)
    secondary.spines["top"].set_color("#888888")


def _to_pounds(kilograms: ArrayLike) -> ArrayLike:
    return np.asarray(kilograms, dtype=np.float64) / LBM_KG


def _to_kilograms(pounds: ArrayLike) -> ArrayLike:
    return np.asarray(pounds, dtype=np.float64) * LBM_KG
