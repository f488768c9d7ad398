"""Figures 7 to 9 and 12 to 15: the onset of the 98.5 % instability."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classic_ml.flow import LBM_KG, T_STANDARD_K
from comparisons.harness.residual_analysis import stall_inception
from comparisons.page.style import (
    ACCENT,
    INK,
    MARK,
    QUIET,
    dress,
    legend_above,
    new_figure,
)
from comparisons.paper.figures_common import (
    INCEPTION_S,
    MEDIUM,
    PAPER_THRESHOLD_LBM_S,
    RANKINE_PER_K,
    TRUTH,
    PaperFigure,
    between,
    clipped_rows,
    cycles_s,
    kilograms_above,
    mark_time,
    one_panel,
    pounds,
    secondary_y,
    shade_band,
    shade_unstalled,
    stall_time_s,
)
from comparisons.paper.instabilities import InstabilityRun
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_inception_figures"]

# Paper, "Data Analysis".
PAPER_SETTLING_S = 1.4
PAPER_SPEED_PERCENT = (70.0, 80.0)
MIGRATION_MAP = "viridis"


def draw_inception_figures(run: InstabilityRun) -> list[PaperFigure]:
    """Draw Figures 7 to 9 and 12 to 15 from the 98.5 % test.

    Parameters
    ----------
    run : InstabilityRun
        The 98.5 % test.
    """
    return [
        _pressure_ratio(run),
        _corrected_flow(run),
        _migration_figure(run),
        _temperature(run),
        _corrected_speed(run),
        _place(run, 14, "tip"),
        _place(run, 15, "hub"),
    ]


def _pressure_ratio(run: InstabilityRun) -> PaperFigure:
    record, rows = run.paper.record, _rows(run)
    ratio = record["pressure_ratio"]
    truth = run.rig.truth
    figure, ax = one_panel()
    ax.plot(truth.time_s, truth["P31_Pa"] / truth["P25_Pa"], **TRUTH)
    _clipped(ax, run, ratio)
    _over_time(ax, run, ratio, "face average pressure ratio $P_{31}/P_{25}$ [-]")
    ax.set_ylim(0.0, 1.12 * float(ratio[rows].max()))
    legend_above(figure, ax, columns=4)
    first, settled = stall_time_s(run), cycles_s(run)[0]
    later = run.paper.series.time_s > settled
    caption = (
        f"Face average pressure ratio over time, 98.5 % speed, unstalled stretches shaded. From "
        f"{_at(run, ratio, first):.1f} it collapses within the first reversal to a blowdown and "
        f"settles {settled - first:.2f} s after the first stall (paper: about "
        f"{PAPER_SETTLING_S} s) into cycles whose peaks reach no more than "
        f"{ratio[later].max():.1f}." + _clipped_words(run, "the ratio")
    )
    return PaperFigure(
        7,
        "Pressure ratio at stall inception, 98.5 % speed",
        figure,
        caption,
        "Face Average Pressure Ratio, 98.5% Nc Stall Inception.",
    )


def _corrected_flow(run: InstabilityRun) -> PaperFigure:
    record, rows = run.paper.record, _rows(run)
    flow = pounds(record["Wc25_kg_s"])
    truth = run.rig.truth
    figure, ax = one_panel()
    ax.plot(truth.time_s, pounds(truth["Wc25_kg_s"]), **TRUTH)
    _clipped(ax, run, flow)
    _over_time(ax, run, flow, "face average corrected flow $W_{c25}$ [lbm/s]")
    ax.axhline(0.0, color=INK, lw=0.6)
    ax.axhline(
        PAPER_THRESHOLD_LBM_S,
        color=QUIET,
        lw=0.9,
        linestyle="-.",
        label=f"threshold {PAPER_THRESHOLD_LBM_S:g} lbm/s",
    )
    ax.set_ylim(1.25 * float(flow[rows].min()), 1.12 * float(flow[rows].max()))
    secondary_y(ax, LBM_KG, "[kg/s]")
    legend_above(figure, ax, columns=5)
    later = run.paper.series.time_s > cycles_s(run)[0]
    reversed_s = float(np.sum(flow[rows] < 0.0)) * record.sample_period_s
    caption = (
        f"Face average corrected inlet flow over time, 98.5 % speed: "
        f"{_at(run, flow, stall_time_s(run)):.0f} lbm/s at stall, reversed for {reversed_s:.2f} s "
        f"of the {INCEPTION_S[1]:g} s shown, down to {flow[rows].min():.0f} lbm/s, while in the "
        f"cycles it recovers to {flow[later].max():.0f} lbm/s. The filtered pressures overshoot "
        "and are late at each sharp drop, where they show deeper reversals than the truth."
        + _clipped_words(run, "the flow")
    )
    return PaperFigure(
        8,
        "Inlet corrected flow at stall inception, 98.5 % speed",
        figure,
        caption,
        "Face Average Inlet Corrected Airflow Rate, 98.5% Nc Stall Inception.",
    )


def _migration_figure(run: InstabilityRun) -> PaperFigure:
    record = run.paper.record
    flow, ratio = pounds(record["Wc25_kg_s"]), record["pressure_ratio"]
    figure, _ = _migration(run, flow, "inlet corrected flow $W_{c25}$ [lbm/s]")
    later = run.paper.series.time_s > cycles_s(run)[0]
    begin = _inception_row(run)
    caption = (
        f"Pressure ratio over inlet corrected flow, coloured by time, from the initial stall (star:"
        f" {ratio[begin]:.1f} at {flow[begin]:.0f} lbm/s) through blowdown at reversed flow to the "
        f"first surge cycles. The recoveries come back to {ratio[later].max():.1f} at most and "
        f"{flow[later].max():.0f} lbm/s, far below the first stall point: the machine recovers at "
        "a much lower corrected speed."
    )
    return PaperFigure(
        9,
        "Operating point migration at stall inception, 98.5 % speed",
        figure,
        caption,
        "Operating Point Migration, 98.5% Nc Stall Inception.",
    )


def _temperature(run: InstabilityRun) -> PaperFigure:
    record, rows = run.paper.record, _rows(run)
    measured = RANKINE_PER_K * record["T25_K"]
    truth = run.rig.truth
    figure, ax = one_panel()
    ax.plot(truth.time_s, RANKINE_PER_K * truth["T25_K"], **TRUTH)
    _over_time(ax, run, measured, "inlet total temperature $T_{25}$ [°R]", word_at=0.5)
    secondary_y(ax, 1.0 / RANKINE_PER_K, "[K]")
    ax.set_ylim(0.94 * float(measured[rows].min()), 1.05 * float(measured[rows].max()))
    legend_above(figure, ax, columns=4)
    begin = _at(run, measured, stall_time_s(run))
    level = float(np.mean(measured[_settled(run)]))
    caption = (
        f"Inlet total temperature, 98.5 % speed: {begin:.0f} °R at stall, {level:.0f} °R on "
        f"average in the quasi-steady cycles, a ratio of {level / begin:.2f}. Reversed, heated gas "
        "and tip recirculation fill the inlet. The thermocouple, of 10 ms, and the filter round "
        "off what the truth does in every cycle."
    )
    return PaperFigure(
        12,
        "Inlet temperature at stall inception, 98.5 % speed",
        figure,
        caption,
        "Compressor Inlet Total Temperature, 98.5% Nc Stall Inception.",
    )


def _corrected_speed(run: InstabilityRun) -> PaperFigure:
    record, rows = run.paper.record, _rows(run)
    speed = 100.0 * record["Nc_frac"]
    truth = run.rig.truth
    figure, ax = one_panel()
    low, high = PAPER_SPEED_PERCENT
    shade_band(ax, low, high, f"{low:g} to {high:g} %, as the paper states")
    ax.plot(truth.time_s, 100.0 * truth["Nc_frac"], **TRUTH)
    _over_time(ax, run, speed, "corrected speed $N_c$ [% of design]")
    ax.set_ylim(min(66.0, 0.97 * float(speed[rows].min())), 103.0)
    legend_above(figure, ax, columns=5)
    settled = speed[_settled(run)]
    rpm = float(run.rig.test["test"]["rotor_speed_rpm"])
    caption = (
        f"Corrected speed, 98.5 % case: at a constant {rpm:,.0f} rpm the heated inlet drives it "
        f"from {_at(run, speed, stall_time_s(run)):.1f} % down to between {settled.min():.1f} and "
        f"{settled.max():.1f} % in the quasi-steady cycles (paper: between {low:g} and {high:g} %),"
        f" as N/√(T25/{RANKINE_PER_K * T_STANDARD_K:.1f} °R) must."
    )
    return PaperFigure(
        13,
        "Corrected speed at stall inception, 98.5 % speed",
        figure,
        caption,
        "Compressor Corrected Speed, 98.5% Nc Stall Inception.",
    )


def _place(run: InstabilityRun, number: int, place: str) -> PaperFigure:
    """Draw the migration at the tip or at the hub; both have the same axes."""
    record, rows = run.paper.record, _rows(run)
    both = {p: pounds(record[f"Wc25_{p}_kg_s"]) for p in ("tip", "hub")}
    flow = both[place]
    figure, ax = _migration(run, flow, f"{place} corrected flow $W_{{c25}}$ [lbm/s]")
    edges = np.concatenate([values[rows] for values in both.values()])
    pad = 0.05 * float(np.ptp(edges))
    ax.set_xlim(float(edges.min()) - pad, float(edges.max()) + pad)
    low = {p: float(values[_settled(run)].min()) for p, values in both.items()}
    share = {p: 100.0 * float(np.mean(v[_settled(run)] < 0.0)) for p, v in both.items()}
    other = "hub" if place == "tip" else "tip"
    more = "further and far longer than" if place == "tip" else "less far and far more briefly than"
    caption = (
        f"Pressure ratio over the corrected flow of the {place} probe pairs alone, 98.5 % speed, "
        f"on the axes of Fig {29 - number}. In the cycles the flow at the {place} reverses {more} "
        f"at the {other}: to {low[place]:.0f} against {low[other]:.0f} lbm/s, and during "
        f"{share[place]:.0f} against {share[other]:.0f} % of the time. The difference is a radial "
        "recirculation that the face average hides."
    )
    return PaperFigure(
        number,
        f"Operating point migration at the {place}, 98.5 % speed",
        figure,
        caption,
        f"{place.capitalize()} Operating Point Migration, 98.5% Nc Stall Inception.",
    )


def _migration(run: InstabilityRun, flow: FloatArray, label: str) -> tuple[Figure, Axes]:
    """Draw pressure ratio over a flow in lbm/s, coloured by time."""
    from matplotlib.collections import LineCollection

    record, rows = run.paper.record, _rows(run)
    x, y, time_s = flow[rows], record["pressure_ratio"][rows], record.time_s[rows]
    figure = new_figure(height_in=MEDIUM + 0.8)
    ax = dress(figure.add_subplot())
    points = np.column_stack([x, y])
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    # A collection of many short pieces in place of one line: each has the colour of its time.
    line = LineCollection(list(pieces), cmap=MIGRATION_MAP, linewidths=1.2, capstyle="round")
    line.set_array(time_s[:-1])
    ax.add_collection(line)
    bar = figure.colorbar(line, ax=ax, pad=0.02)
    bar.set_label("time [s]", fontsize=9)
    bar.ax.tick_params(labelsize=8.5)
    begin = _inception_row(run)
    ax.plot(
        flow[begin],
        record["pressure_ratio"][begin],
        marker="*",
        markersize=14,
        linestyle="none",
        color=MARK,
        markeredgecolor="white",
        zorder=5,
        label=f"stall inception, {record.time_s[begin]:.2f} s",
    )
    ax.axvline(0.0, color=INK, lw=0.6)
    ax.margins(0.05)
    ax.autoscale_view()
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel(label)
    ax.set_ylabel("pressure ratio $P_{31}/P_{25}$ [-]")
    kilograms_above(ax)
    legend_above(figure, ax)
    return figure, ax


def _over_time(
    ax: Axes, run: InstabilityRun, values: FloatArray, label: str, *, word_at: float = 0.97
) -> None:
    """Draw a signal of the reduction over the stall inception, regimes shaded, stall marked."""
    time_s, rows = run.paper.record.time_s, _rows(run)
    ax.plot(time_s[rows], values[rows], color=ACCENT, lw=1.2, label="reduced as in the paper")
    stalled = run.paper.series.in_stall
    if stalled is not None:
        shade_unstalled(ax, time_s[rows], stalled[rows])
    mark_time(ax, stall_time_s(run), "first stall", height=0.8, left=True)
    if cycles_s(run)[0] < INCEPTION_S[1]:
        mark_time(ax, cycles_s(run)[0], "quasi-steady", colour=QUIET, height=word_at)
    ax.set_xlim(float(time_s[rows][0]), float(time_s[rows][-1]))
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)


def _clipped(ax: Axes, run: InstabilityRun, values: FloatArray) -> None:
    """Mark where a transducer at plane 25 is at the end of its range."""
    record = run.paper.record
    bad = clipped_rows(record) & _rows(run)
    if bad.any():
        ax.plot(
            record.time_s,
            np.where(bad, values, np.nan),
            color="#E69F00",
            lw=5.0,
            alpha=0.55,
            solid_capstyle="butt",
            label="a transducer clips",
        )


def _clipped_words(run: InstabilityRun, what: str) -> str:
    bad = clipped_rows(run.paper.record) & _rows(run)
    if not bad.any():
        return ""
    times = run.paper.record.time_s[bad]
    return (
        f" From {times[0]:.2f} to {times[-1]:.2f} s the inlet pressure is at times beyond the "
        f"transducers' range, where {what} is not to be trusted."
    )


def _rows(run: InstabilityRun) -> NDArray[np.bool_]:
    return between(run.paper.record.time_s, INCEPTION_S)


def _settled(run: InstabilityRun) -> NDArray[np.bool_]:
    return between(run.paper.record.time_s, cycles_s(run))


def _at(run: InstabilityRun, values: FloatArray, time_s: float) -> float:
    return float(np.interp(time_s, run.paper.record.time_s, values))


def _inception_row(run: InstabilityRun) -> int:
    """Return the row of the highest pressure ratio before the first stall."""
    record, stalled = run.paper.record, run.paper.series.in_stall
    found = None
    if stalled is not None:
        found = stall_inception(record["pressure_ratio"], stalled, record.sample_rate_hz)
    if found is not None:
        return int(found)
    return int(np.argmin(np.abs(record.time_s - stall_time_s(run))))
