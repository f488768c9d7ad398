"""Figures 20 to 22: the two modes of response, and the inputs of the work coefficient."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classic_ml import PiecewiseLinear
from comparisons.page.style import (
    ACCENT,
    FAINT,
    INK,
    MARK,
    QUIET,
    dress,
    legend,
    legend_above,
    new_figure,
)
from comparisons.paper.figures_common import (
    HIGH,
    MACHINE,
    MEDIUM,
    TRUTH,
    VOLUME,
    PaperFigure,
    add_arrow,
    add_box,
    between,
    case_table,
    cycles_s,
    panels,
    stall_time_s,
)
from comparisons.paper.figures_truth import (
    in_stall_psi,
    in_stall_psi_p,
    reverse_flow_psi_p,
    stall_point,
    unstalled_psi_p,
)
from comparisons.paper.instabilities import InstabilityRun
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_responses", "draw_work_inputs"]

GREEN, ORANGE = "#009E73", "#E69F00"
PHI, PSI_P = r"flow coefficient $\varphi$ [-]", r"pressure coefficient $\psi'$ [-]"
# Without a record of steady stall the operating point is drawn at this flow.
SKETCHED_PHI = 0.14
SHOWN_INPUTS_S = 0.5


def draw_responses(high: InstabilityRun, steady: InstabilityRun | None) -> list[PaperFigure]:
    """Draw Figures 20 and 21: the operating point in rotating stall and in surge.

    Parameters
    ----------
    high : InstabilityRun
        The 98.5 % test.
    steady : InstabilityRun or None
        The 75 % test with steady rotating stall; without it Fig 20 is a sketch.
    """
    return [
        _sketched_low_speed(high) if steady is None else _low_speed(steady),
        _high_speed(high),
    ]


LOW_SPEED_TITLE = "Low-speed response: a decay into rotating stall"


def _low_speed(run: InstabilityRun) -> PaperFigure:
    truth = run.rig.truth
    stall, tau = stall_time_s(run), float(run.rig.truth_parameters["tau_s"])
    figure, grid = panels(1, 2, height_in=MEDIUM, width_ratios=(1.15, 1.0))
    plane, clock = grid[0]
    time_s, phi, psi_p = truth.time_s, truth["phi"], truth["psi_p"]
    speed = float(truth["Nc_frac"][0])
    _curves(plane, run, speed, (0.0, float(phi.max()) + 0.03), "in stall (rotating stall)")
    settled = stall + 0.25
    rows = between(time_s, (0.0, settled))
    plane.plot(phi[rows], psi_p[rows], color=MARK, lw=1.8, label="stall of the 75 % test")
    after = time_s > settled
    plane.plot(phi[after], psi_p[after], color=ACCENT, lw=1.2, label="throttle moved slowly")
    for count in range(1, 6):
        at = stall + 0.02 * count
        plane.plot(np.interp(at, time_s, phi), np.interp(at, time_s, psi_p), "o", color=MARK, ms=4)
    plane.set_ylim(bottom=0.0)
    shown = between(time_s, (stall - 0.06, settled))
    ms = 1e3 * (time_s - stall)
    clock.plot(ms[shown], psi_p[shown], color=MARK, lw=1.8, label="stall of the 75 % test")
    target = truth["psi_p_qs"]
    clock.plot(ms[shown], target[shown], **(TRUTH | {"label": r"$\psi'_{\mathrm{QS}}(\varphi)$"}))
    falls = float(time_s[np.flatnonzero(target < 0.5 * (target[rows].max() + psi_p[rows][-1]))[0]])
    level, top = float(np.interp(settled, time_s, psi_p)), float(np.interp(falls, time_s, psi_p))
    since = np.maximum(time_s - falls, 0.0)
    decay = level + (top - level) * np.exp(-since / tau)
    late = shown & (time_s >= falls)
    label = f"first-order decay, τ = {1e3 * tau:.0f} ms"
    clock.plot(ms[late], decay[late], color=GREEN, lw=1.4, linestyle="--", label=label)
    clock.set_xlabel("time after stall [ms]")
    clock.set_ylabel(PSI_P)
    legend_above(figure, plane, clock, columns=4)
    caption = (
        f"From the 75 % record of the rig. Left: the operating point leaves the unstalled branch "
        f"at ψ' = {np.interp(stall, time_s, psi_p):.1f} and ends on the in-stall characteristic "
        f"at {level:.1f}, where it stays and follows the throttle; dots every 20 ms. Right: the "
        f"same in time, beside a first-order decay with the rig's {1e3 * tau:.0f} ms; the real one "
        "is slower at its end because the flow, and with it ψ'_QS, settles with the plenum."
    )
    return PaperFigure(20, LOW_SPEED_TITLE, figure, caption, "Low Speed Compressor Response.")


def _sketched_low_speed(run: InstabilityRun) -> PaperFigure:
    low_speed = float(case_table(run)["stall_speeds"][0])
    phi_s, psi_s = stall_point(run, low_speed)
    tau_ms = 1e3 * float(run.rig.truth_parameters["tau_s"])
    end = (SKETCHED_PHI, float(in_stall_psi_p(run, SKETCHED_PHI)))
    figure, grid = panels(1, 2, height_in=MEDIUM, width_ratios=(1.15, 1.0))
    plane, clock = grid[0]
    _curves(plane, run, low_speed, (0.0, phi_s + 0.05), "in stall")
    share = np.exp(-np.arange(5.0))
    x, y = end[0] + (phi_s - end[0]) * share, end[1] + (psi_s - end[1]) * share
    plane.plot((phi_s, end[0]), (psi_s, end[1]), color=MARK, lw=1.8, label="first-order decay")
    plane.plot(x, y, "o", color=MARK, ms=4)
    plane.set_ylim(bottom=0.0)
    ms = np.linspace(-tau_ms, 5.0 * tau_ms, 200)
    decay = end[1] + (psi_s - end[1]) * np.exp(-np.maximum(ms, 0.0) / tau_ms)
    clock.plot(ms, decay, color=MARK, lw=1.8)
    clock.set_xlabel("time after stall [ms]")
    clock.set_ylabel(PSI_P)
    legend_above(figure, plane, columns=4)
    caption = (
        "A sketch on the rig's characteristics, without a record of it: at "
        f"{100 * low_speed:.0f} % speed the operating point leaves the stall point at ψ' = "
        f"{psi_s:.1f} and decays to a steady rotating-stall point at {end[1]:.1f}, here with τ = "
        f"{tau_ms:.0f} ms; dots at every time constant."
    )
    return PaperFigure(20, LOW_SPEED_TITLE, figure, caption, "Low Speed Compressor Response.")


def _curves(
    ax: Axes, run: InstabilityRun, speed: float, span: tuple[float, float], stalled_word: str
) -> None:
    """Draw the unstalled branch at a speed and the in-stall one up to where they meet."""
    phi = np.linspace(*span, 400)
    phi_s, _ = stall_point(run, speed)
    free, stalled = unstalled_psi_p(run, phi, speed), in_stall_psi_p(run, phi)
    stable = phi >= phi_s
    label = f"unstalled, {100 * speed:.0f} % speed"
    ax.plot(phi[stable], free[stable], color=INK, lw=1.8, label=label)
    below = (stalled <= free) & (phi >= 0.0)
    ax.plot(phi[below], stalled[below], **(TRUTH | {"lw": 1.8, "label": stalled_word}))
    ax.set_xlabel(PHI)
    ax.set_ylabel(PSI_P)


def _high_speed(run: InstabilityRun) -> PaperFigure:
    truth = run.rig.truth
    figure = new_figure(height_in=HIGH + 0.6)
    axes = figure.subplots(2, 1, height_ratios=(4.4, 1.0))
    ax = dress(axes[0])
    phi, psi_p = truth["phi"], truth["psi_p"]
    stall, begin = stall_time_s(run), cycles_s(run)[0]
    cycle = _one_cycle(run)
    settled = truth.time_s > begin
    unstalled = settled & (truth["in_stall"] < 0.5)
    speed = float(np.median(truth["Nc_frac"][unstalled]))
    early = between(truth.time_s, (stall - 0.05, begin))
    _curves(ax, run, speed, (0.0, 0.36), "in stall, forward flow")
    high_speed = float(case_table(run)["corrected_speed_frac"])
    grid = np.linspace(stall_point(run, high_speed)[0], float(phi.max()) + 0.01, 60)
    ax.plot(
        grid,
        unstalled_psi_p(run, grid, high_speed),
        color=ORANGE,
        lw=2.4,
        label=f"unstalled, {100 * high_speed:.1f} % speed",
    )
    backward = np.linspace(min(-0.06, float(phi.min())), 0.0, 80)
    ax.plot(
        backward,
        reverse_flow_psi_p(run, backward),
        color=GREEN,
        lw=1.8,
        linestyle="--",
        label="in stall, reversed flow",
    )
    ax.plot(phi[early], psi_p[early], color=FAINT, lw=1.2, label="first reversal and blowdown")
    ax.plot(phi[cycle], psi_p[cycle], color=ACCENT, lw=2.0, label="one surge cycle")
    _arrows_along(ax, phi[cycle], psi_p[cycle], ACCENT)
    ax.axvline(0.0, color=INK, lw=0.6)
    ax.set_ylim(0.0, 1.08 * float(psi_p[early | cycle].max()))
    ax.set_xlabel(PHI)
    ax.set_ylabel(PSI_P)
    _block_diagram(axes[1], 1e3 * float(run.rig.truth_parameters["tau_s"]))
    legend_above(figure, ax, columns=3)
    length_ms = 1e3 * np.count_nonzero(cycle) / truth.sample_rate_hz
    caption = (
        "The operating point of the rig in surge over its quasi-steady branches, the 98.5 % test "
        f"in truth: one cycle of {length_ms:.0f} ms visits the unstalled branch of "
        f"{100 * speed:.0f} % speed, the in-stall one and, down to φ = {phi[cycle].min():.2f}, "
        "that of reversed flow, and never rests on any; compare Fig 9 and 11. Below: the model "
        "that is fitted (dashed: φ in, ψ' out), and what ties ψ' to the measurements."
    )
    return PaperFigure(
        21,
        "High-speed response: the surge cycle over its branches",
        figure,
        caption,
        "High Speed Compressor Response.",
    )


def _one_cycle(run: InstabilityRun) -> NDArray[np.bool_]:
    """Return the rows from one stall to the next in the middle of the quasi-steady cycles."""
    from_s, to_s = cycles_s(run)
    stalls = [t for t in run.rig.truth_parameters["stall_times_s"] if from_s <= t <= to_s]
    if len(stalls) < 2:
        return between(run.rig.truth.time_s, cycles_s(run))
    middle = len(stalls) // 2
    return between(run.rig.truth.time_s, (stalls[middle - 1], stalls[middle]))


def _arrows_along(ax: Axes, x: FloatArray, y: FloatArray, colour: str) -> None:
    """Put arrow heads on a path, evenly along its length on the page."""
    scaled = np.hypot(np.diff(x) / np.ptp(x), np.diff(y) / np.ptp(y))
    length = np.concatenate([[0.0], np.cumsum(scaled)])
    for share in (0.12, 0.3, 0.5, 0.68, 0.86):
        at = int(np.searchsorted(length, share * length[-1]))
        before = max(at - 2, 0)
        ax.annotate(
            "",
            (x[at], y[at]),
            (x[before], y[before]),
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8, "mutation_scale": 16},
        )


def _block_diagram(ax: Axes, tau_ms: float) -> None:
    """Draw φ → characteristic → lag → ψ', and where the momentum of the gas enters."""
    from matplotlib.patches import Rectangle

    ax.set_axis_off()
    ax.set_xlim(0.0, 18.0)
    ax.set_ylim(0.0, 3.0)
    frame = Rectangle((3.0, 0.1), 9.2, 2.8, fill=False, edgecolor=QUIET, linestyle="--", lw=1.0)
    ax.add_patch(frame)
    curve = "characteristic\n" + r"$\psi'_{\mathrm{QS}}=\sum_i \beta_i s_i(\varphi)$"
    add_box(ax, (3.5, 0.5), (3.7, 2.0), curve, VOLUME)
    lag = f"lag (rig: {tau_ms:.0f} ms)\n" + r"$\tau\,\dot\psi'+\psi'=\psi'_{\mathrm{QS}}$"
    add_box(ax, (8.3, 0.5), (3.4, 2.0), lag, VOLUME)
    momentum = "momentum (Eq 5)\n" + r"$P_{31},\,P_{25},\,dW_{25}/dt$"
    add_box(ax, (13.6, 0.5), (3.9, 2.0), momentum, MACHINE)
    add_arrow(ax, (1.6, 1.5), (3.5, 1.5))
    add_arrow(ax, (7.2, 1.5), (8.3, 1.5))
    add_arrow(ax, (11.7, 1.5), (13.6, 1.5))
    ax.text(1.5, 1.5, r"measured $\varphi$", ha="right", va="center", fontsize=9)
    ax.text(12.9, 1.8, r"$\psi'$", ha="center", fontsize=10)


def draw_work_inputs(run: InstabilityRun) -> PaperFigure:
    """Draw Figure 22: the piecewise-linear model of the work coefficient and its inputs.

    Parameters
    ----------
    run : InstabilityRun
        The 90 % test, whose φ makes the input signals.
    """
    first, second = (float(b) for b in run.rig.truth_parameters["psi_breaks"])
    figure = new_figure(height_in=HIGH)
    axes = figure.subplot_mosaic([["model", "inputs"], ["time", "time"]], height_ratios=(1.35, 1.0))
    for ax in axes.values():
        dress(ax)
    phi = np.linspace(-0.05, 0.25, 301)
    _work_model(axes["model"], run, phi, (first, second))
    columns = _inputs(phi, (first, second))
    _input_curves(axes["inputs"], phi, columns, (first, second))
    _input_signals(axes["time"], run, (first, second))
    figure.align_ylabels([axes["model"], axes["time"]])
    slopes = run.rig.truth_parameters["psi_slopes"]
    caption = (
        f"(a) The model of ψ_QS: three straight pieces that meet at δ₁ = {first:g} and δ₂ = "
        f"{second:g}, here with the rig's slopes {', '.join(f'{s:g}' for s in slopes)}. (b) Its "
        "inputs as functions of φ and, below, as signals in time of the 90 % record. The figure is "
        "lost in the scan; one constant and three slopes are the only continuous reading of four "
        "inputs with two breakpoints."
    )
    return PaperFigure(
        22,
        "Inputs of the work coefficient model",
        figure,
        caption,
        "(a) Work Coefficient Estimation Model. (b) Input Signals For Work Coefficient Estimation.",
    )


INPUT_STYLES = ((QUIET, "--"), (ACCENT, "-"), (MARK, (0, (5, 1.5))), (GREEN, (0, (2, 1))))
INPUT_NAMES = (
    "$s_1=1$",
    r"$s_2=\min(\varphi,\delta_1)$",
    r"$s_3$: from $\delta_1$ to $\delta_2$",
    r"$s_4=(\varphi-\delta_2)_+$",
)


def _inputs(phi: FloatArray, breaks: tuple[float, float]) -> FloatArray:
    """Return s_1 to s_4 of Eq 14, as the estimator itself makes them."""
    return np.asarray(PiecewiseLinear(breaks).fit_transform(phi[:, None]), dtype=np.float64)


def _work_model(
    ax: Axes, run: InstabilityRun, phi: FloatArray, breaks: tuple[float, float]
) -> None:
    value = in_stall_psi(run, phi)
    ax.plot(phi, value, color=ACCENT, lw=2.0)
    ends = (float(phi[0]), *breaks, float(phi[-1]))
    for number, (low, high) in enumerate(pairwise(ends), start=2):
        middle = 0.5 * (low + high)
        ax.annotate(
            rf"slope $\beta_{number}$",
            (middle, float(in_stall_psi(run, middle))),
            xytext=(-24, -24) if number == 3 else (6, 10),
            textcoords="offset points",
            fontsize=9,
        )
    start = float(in_stall_psi(run, 0.0))
    ax.plot(0.0, start, "o", color=INK, ms=5)
    ax.annotate(
        r"$\beta_1$", (0.0, start), xytext=(-6, -14), textcoords="offset points", fontsize=9
    )
    _break_lines(ax, breaks)
    ax.set_ylim(float(value.min()) - 0.5, float(value.max()) + 0.4)
    ax.set_xlabel(f"(a)  {PHI}")
    ax.set_ylabel(r"work coefficient $\psi_{\mathrm{QS}}$ [-]")


def _input_curves(
    ax: Axes, phi: FloatArray, columns: FloatArray, breaks: tuple[float, float]
) -> None:
    for column, name, (colour, dashes) in zip(
        columns.T[1:], INPUT_NAMES[1:], INPUT_STYLES[1:], strict=True
    ):
        ax.plot(phi, column, color=colour, linestyle=dashes, lw=1.8, label=name)
    _break_lines(ax, breaks)
    low, high = float(columns[:, 1:].min()), float(columns[:, 1:].max())
    # s_1 is ten times as large: a line at the top with its value says all there is to it.
    ax.axhline(1.25 * high, color=QUIET, linestyle="--", lw=1.8, label=INPUT_NAMES[0])
    ax.text(float(phi[0]), 1.29 * high, "1 (off the scale)", fontsize=8.5, color=QUIET)
    ax.set_ylim(1.15 * low, 1.5 * high)
    ax.set_xlabel(f"(b)  {PHI}")
    ax.set_ylabel("inputs $s_i$ [-]")
    legend(ax, loc="center left", bbox_to_anchor=(0.0, 0.58))


def _break_lines(ax: Axes, breaks: tuple[float, float]) -> None:
    for number, at in enumerate(breaks, start=1):
        ax.axvline(at, color=INK, lw=0.9, linestyle=":")
        ax.annotate(
            rf"$\delta_{number}$",
            (at, 0.0),
            xycoords=("data", "axes fraction"),
            xytext=(3, 4),
            textcoords="offset points",
            fontsize=10,
        )


def _input_signals(ax: Axes, run: InstabilityRun, breaks: tuple[float, float]) -> None:
    series = run.paper.series
    begin = run.paper.window_s[0]
    rows = between(series.time_s, (begin, begin + SHOWN_INPUTS_S))
    columns = _inputs(series.phi[rows], breaks)
    for column, (colour, dashes) in zip(columns.T[1:], INPUT_STYLES[1:], strict=True):
        ax.plot(series.time_s[rows], column, color=colour, linestyle=dashes, lw=1.4)
    ax.axhline(0.0, color=INK, lw=0.6)
    ax.set_xlim(begin, begin + SHOWN_INPUTS_S)
    ax.set_xlabel("(b)  time [s]")
    ax.set_ylabel("inputs $s_2$ to $s_4$ [-]")
