"""Figures 11 and 16 to 19: the quasi-steady surge cycles at 98.5 %."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classic_ml.flow import LBM_KG
from comparisons.page.style import ACCENT, INK, MARK, QUIET, legend_above
from comparisons.paper.figures_common import (
    CYCLES_S,
    MEDIUM,
    PAPER_THRESHOLD_LBM_S,
    PSI_PA,
    RANKINE_PER_K,
    TRUTH,
    PaperFigure,
    between,
    kilograms_above,
    kpa_right,
    one_panel,
    pounds,
    secondary_y,
    shade_unstalled,
)
from comparisons.paper.figures_truth import (
    in_stall_psi_p,
    phi_of_flow,
    pressure_ratio,
    stall_point,
    temperature_K,
    unstalled_psi_p,
)
from comparisons.paper.instabilities import InstabilityRun
from surge_core.segments import runs_of
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_cycle_figures"]

WINDOW_WORDS = f"{CYCLES_S[0]:g} < t < {CYCLES_S[1]:g} s"


def draw_cycle_figures(run: InstabilityRun) -> list[PaperFigure]:
    """Draw Figures 11 and 16 to 19 from the 98.5 % test.

    Parameters
    ----------
    run : InstabilityRun
        The 98.5 % test.
    """
    return [_migration(run), _flow(run), _inlet(run), _exit(run), _temperature(run)]


def _migration(run: InstabilityRun) -> PaperFigure:
    record, rows = run.paper.record, _rows(run)
    flow, ratio = pounds(record["Wc25_kg_s"]), record["pressure_ratio"]
    stalled = _stalled(run)
    figure, ax = one_panel(MEDIUM + 0.8)
    for state, colour, word in (
        (stalled, ACCENT, "in stall"),
        (~stalled, MARK, f"unstalled, above {PAPER_THRESHOLD_LBM_S:g} lbm/s"),
    ):
        # One row more at each end, so that the two colours meet.
        near = np.convolve(state, np.ones(3), mode="same") > 0.5
        ax.plot(
            np.where(rows & near, flow, np.nan),
            np.where(rows & near, ratio, np.nan),
            color=colour,
            lw=0.8,
            label=word,
        )
    speed = float(np.median(record["Nc_frac"][rows & ~stalled]))
    point = _truth_lines(ax, run, speed, float(flow[rows].max()))
    ax.axvline(0.0, color=INK, lw=0.6)
    ax.axvline(PAPER_THRESHOLD_LBM_S, color=QUIET, lw=0.9, linestyle="-.")
    ax.set_xlim(float(flow[rows].min()) - 4.0, float(flow[rows].max()) + 10.0)
    ax.set_ylim(1.0, 1.12 * max(float(ratio[rows].max()), point[1]))
    ax.set_xlabel("inlet corrected flow $W_{c25}$ [lbm/s]")
    ax.set_ylabel("pressure ratio $P_{31}/P_{25}$ [-]")
    kilograms_above(ax)
    legend_above(figure, ax, columns=3)
    cycles = _n_cycles(rows, stalled)
    caption = (
        f"Pressure ratio over corrected flow, {WINDOW_WORDS}: {cycles} cycles that repeat each "
        f"other, between {ratio[rows].min():.1f} and {ratio[rows].max():.1f} in pressure ratio and "
        f"{flow[rows].min():.0f} and {flow[rows].max():.0f} lbm/s. "
        f"{PAPER_THRESHOLD_LBM_S:g} lbm/s parts the regimes. The recoveries reach towards the "
        f"rig's own speed line at {100 * speed:.0f} %, the speed that the heated inlet leaves, and "
        f"its stall point ({point[1]:.1f} at {point[0]:.0f} lbm/s); the lag keeps the loops off "
        "the quasi-steady curves."
    )
    return PaperFigure(
        11,
        "Quasi-steady surge cycles, 98.5 % speed",
        figure,
        caption,
        "Operating Point Migration, 98.5% Nc Quasi-Steady Surge Cycles for 1.8 < Time < 3.6 "
        "Seconds.",
    )


def _truth_lines(
    ax: Axes, run: InstabilityRun, speed: float, most_lbm_s: float
) -> tuple[float, float]:
    """Draw both of the rig's quasi-steady curves at a speed; return the stall point."""
    inlet_K = temperature_K(run, speed)
    flow = np.linspace(0.0, most_lbm_s + 8.0, 400)
    phi = phi_of_flow(run, flow, inlet_K)
    phi_s, psi_s = stall_point(run, speed)
    stalled = in_stall_psi_p(run, phi)
    below = stalled <= unstalled_psi_p(run, phi, speed)
    ax.plot(
        flow[below],
        pressure_ratio(run, stalled[below], inlet_K),
        **(TRUTH | {"lw": 1.6, "label": "rig, in stall, quasi-steady"}),
    )
    stable = phi >= phi_s
    ax.plot(
        flow[stable],
        pressure_ratio(run, unstalled_psi_p(run, phi[stable], speed), inlet_K),
        color=INK,
        lw=1.6,
        label=f"rig, speed line at {100 * speed:.0f} %",
    )
    at = float(np.interp(phi_s, phi, flow))
    ratio = float(pressure_ratio(run, psi_s, inlet_K))
    ax.plot(
        at,
        ratio,
        marker="*",
        markersize=13,
        linestyle="none",
        color=INK,
        markeredgecolor="white",
        zorder=5,
        label="its stall point",
    )
    return at, ratio


def _flow(run: InstabilityRun) -> PaperFigure:
    values = pounds(run.paper.record["Wc25_kg_s"])
    truth = pounds(run.rig.truth["Wc25_kg_s"])
    figure, ax = one_panel()
    _over_time(ax, run, values, truth, "inlet corrected flow $W_{c25}$ [lbm/s]")
    ax.axhline(0.0, color=INK, lw=0.6)
    ax.axhline(
        PAPER_THRESHOLD_LBM_S,
        color=QUIET,
        lw=0.9,
        linestyle="-.",
        label=f"threshold {PAPER_THRESHOLD_LBM_S:g} lbm/s",
    )
    secondary_y(ax, LBM_KG, "[kg/s]")
    legend_above(figure, ax, columns=4)
    rows = _rows(run)
    period_ms = _period_ms(run)
    caption = (
        f"Inlet corrected flow over the cycles, {WINDOW_WORDS}: period {period_ms:.0f} ms, "
        f"{values[rows].min():.0f} to {values[rows].max():.0f} lbm/s, and "
        f"reversed {100.0 * float(np.mean(values[rows] < 0.0)):.0f} % of the time (in truth "
        f"{100.0 * float(np.mean(truth[rows] < 0.0)):.0f} %, to {truth[rows].min():.0f} lbm/s: "
        "pressures that were filtered before the flow is computed from them overshoot at each "
        "drop). After each drop one mild oscillation in stall precedes the next recovery."
    )
    return PaperFigure(
        16,
        "Inlet corrected flow in the cycles, 98.5 % speed",
        figure,
        caption,
        "Inlet Corrected Airflow, 98.5% Nc Quasi-Steady Surge Cycles.",
    )


def _inlet(run: InstabilityRun) -> PaperFigure:
    values = run.paper.record["P25_Pa"] / PSI_PA
    truth = run.rig.truth["P25_Pa"] / PSI_PA
    figure, ax = one_panel()
    _over_time(ax, run, values, truth, "inlet total pressure $P_{25}$ [psia]")
    kpa_right(ax)
    legend_above(figure, ax, columns=4)
    rows = _rows(run)
    slope = _slope_per_s(run, values)
    caption = (
        f"Inlet total pressure over the cycles: {values[rows].min():.1f} to "
        f"{values[rows].max():.1f} psia, {truth[rows].max():.1f} in truth. Stall blocks the flow, "
        "and the inertia of the gas before the compressor drives a spike that a drop follows at "
        f"once. On top of the cycles the level drifts by {slope:+.2f} psi/s, which is the facility,"
        " not the compressor."
    )
    return PaperFigure(
        17,
        "Inlet pressure in the cycles, 98.5 % speed",
        figure,
        caption,
        "Inlet Total Pressure, 98.5% Nc Quasi-Steady Surge Cycles.",
    )


def _exit(run: InstabilityRun) -> PaperFigure:
    values = run.paper.record["P31_Pa"] / PSI_PA
    truth = run.rig.truth["P31_Pa"] / PSI_PA
    figure, ax = one_panel()
    _over_time(ax, run, values, truth, "exit total pressure $P_{31}$ [psia]")
    kpa_right(ax)
    legend_above(figure, ax, columns=4)
    rows = _rows(run)
    before = float(np.mean(run.rig.truth["P31_Pa"][:100])) / PSI_PA
    caption = (
        f"Exit total pressure over the cycles: {values[rows].min():.0f} to {values[rows].max():.0f}"
        f" psia, against {before:.0f} psia before the instability. It falls from the moment of "
        "stall, oscillates mildly about its in-stall level and rises with the recovering flow."
    )
    return PaperFigure(
        18,
        "Exit pressure in the cycles, 98.5 % speed",
        figure,
        caption,
        "Exit Total Pressure 98.5% Nc Quasi-Steady Surge Cycles.",
    )


def _temperature(run: InstabilityRun) -> PaperFigure:
    values = RANKINE_PER_K * run.paper.record["T25_K"]
    truth = RANKINE_PER_K * run.rig.truth["T25_K"]
    figure, ax = one_panel()
    _over_time(ax, run, values, truth, "inlet total temperature $T_{25}$ [°R]")
    secondary_y(ax, 1.0 / RANKINE_PER_K, "[K]")
    legend_above(figure, ax, columns=4)
    rows = _rows(run)
    slope = _slope_per_s(run, values)
    caption = (
        f"Inlet total temperature over the cycles: {values[rows].min():.0f} to "
        f"{values[rows].max():.0f} °R, {truth[rows].min():.0f} to {truth[rows].max():.0f} in truth."
        " It rises in stall, when the tips send heated gas back, and falls as the machine recovers "
        f"and draws cold gas; the slow trend is {slope:+.1f} °R/s."
    )
    return PaperFigure(
        19,
        "Inlet temperature in the cycles, 98.5 % speed",
        figure,
        caption,
        "Inlet Total Temperature, 98.5% Nc Quasi-Steady Surge Cycles.",
    )


def _over_time(
    ax: Axes, run: InstabilityRun, values: FloatArray, truth: FloatArray, label: str
) -> None:
    time_s, rows = run.paper.record.time_s, _rows(run)
    ax.plot(time_s[rows], truth[rows], **TRUTH)
    ax.plot(time_s[rows], values[rows], color=ACCENT, lw=1.2, label="reduced as in the paper")
    shade_unstalled(ax, time_s[rows], _stalled(run)[rows])
    ax.set_xlim(float(time_s[rows][0]), float(time_s[rows][-1]))
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)


def _rows(run: InstabilityRun) -> NDArray[np.bool_]:
    return between(run.paper.record.time_s, CYCLES_S)


def _stalled(run: InstabilityRun) -> NDArray[np.bool_]:
    """Return the in-stall rows as the paper tells them, by the threshold of the flow."""
    return np.asarray(pounds(run.paper.record["Wc25_kg_s"]) < PAPER_THRESHOLD_LBM_S)


def _n_cycles(rows: NDArray[np.bool_], stalled: NDArray[np.bool_]) -> int:
    inside = stalled[rows]
    return sum(not inside[run.start] for run in runs_of(inside, inside.size))


def _period_ms(run: InstabilityRun) -> float:
    """Return the median time between two drops below the threshold."""
    stalled = _stalled(run)[_rows(run)]
    drops = np.flatnonzero(np.diff(stalled.astype(np.int8)) > 0)
    return float(np.median(np.diff(drops))) * 1e3 / run.paper.record.sample_rate_hz


def _slope_per_s(run: InstabilityRun, values: FloatArray) -> float:
    """Return the first-order trend of a signal over the cycles."""
    rows = _rows(run)
    return float(np.polyfit(run.paper.record.time_s[rows], values[rows], 1)[0])
