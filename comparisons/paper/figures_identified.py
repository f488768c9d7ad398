"""Figures 23 to 27: the identified characteristics, where φ dwells, and the reconstruction."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from classic_ml.coefficients import PSI_MINIMUM_PHI
from comparisons.harness.reconstruction import reconstruct_record
from comparisons.page.style import (
    ACCENT,
    INK,
    MARK,
    MEASURED,
    QUIET,
    broken,
    coefficient_symbol,
    legend_above,
    robust_limits,
)
from comparisons.paper.figures_common import (
    HIGH,
    MEDIUM,
    TRUTH,
    PaperFigure,
    one_panel,
    panels,
    pounds,
    shade_band,
)
from comparisons.paper.figures_truth import in_stall_psi, in_stall_psi_p
from comparisons.paper.instabilities import (
    TRIAL_TIME_CONSTANT_S,
    WRONG_TIME_CONSTANT_S,
    InstabilityRun,
)
from comparisons.results import FittedLag, Reconstruction
from surge_core.segments import runs_of
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_identified_figures"]

COLUMN = "#9db8cf"
PHI = r"flow coefficient $\varphi$ [-]"
# Ranges of φ in which the paper trusts its curves: at 98.5 % and at 90 %.
PAPER_PHI_985 = (-0.025, 0.175)
PAPER_PHI_90 = (0.0, 0.1)
BIN = 0.0125
BAND = 2.0
STEADY_POINTS = 9
SHOWN_S = 1.2
DRAWN_BEYOND = 0.03
TRIED_S = (0.005, 0.4)
TRIALS = 25
TICKS_MS = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 400.0)


def draw_identified_figures(
    high: InstabilityRun, low: InstabilityRun, steady: InstabilityRun | None
) -> list[PaperFigure]:
    """Draw Figures 23 to 27.

    Parameters
    ----------
    high, low : InstabilityRun
        The 98.5 % and the 90 % test.
    steady : InstabilityRun or None
        The 75 % test with steady rotating stall.
    """
    return [
        _pressure_characteristic(high, steady),
        _histogram_high(high),
        _both_characteristics(low),
        _histogram_low(low),
        _reconstruction(low),
    ]


def _pressure_characteristic(run: InstabilityRun, steady: InstabilityRun | None) -> PaperFigure:
    figure, ax = one_panel(MEDIUM + 0.6)
    shade_band(ax, *PAPER_PHI_985, r"$\varphi$ that the paper relies on", across=True)
    model = run.fits["psi_p"]
    low, high = PAPER_PHI_985
    _curve(ax, model, (low, high), ACCENT, "estimate, 98.5 % speed, ± 2 s.e.")
    grid = np.linspace(low - DRAWN_BEYOND, high + DRAWN_BEYOND, 121)
    ax.plot(grid, in_stall_psi_p(run, grid), **(TRUTH | {"lw": 1.8}))
    words = " No steady record at 75 % speed is at hand to compare with."
    if steady is not None:
        phi, psi_p, spread = _steady_points(steady)
        ax.errorbar(
            phi,
            psi_p,
            yerr=spread,
            fmt="s",
            color=MARK,
            ms=6,
            capsize=2.5,
            lw=1.0,
            label="75 % speed, steady rotating stall",
        )
        inside = (phi >= low) & (phi <= high)
        gap = psi_p[inside] - model.quasi_steady(phi[inside])
        words = (
            f" The steady points at 75 % (mean and standard deviation of each) lie above it, by "
            f"{gap[0]:.2f} at φ = {phi[inside][0]:.2f} and {gap[-1]:.2f} at "
            f"{phi[inside][-1]:.2f}: surge follows a lower and steeper curve than rotating stall, "
            "as the paper found and as the rig was built."
            if gap.size and gap.min() > 0.0
            else " The steady points at 75 % do not all lie above it."
        )
    inside_grid = grid[(grid >= low) & (grid <= high)]
    off = np.abs(model.quasi_steady(inside_grid) - in_stall_psi_p(run, inside_grid)).max()
    true = in_stall_psi_p(run, inside_grid)
    ax.set_xlim(grid[0], grid[-1])
    ax.set_ylim(0.0)
    ax.set_xlabel(PHI)
    ax.set_ylabel(f"quasi-steady {coefficient_symbol('psi_p', quasi_steady=True)} [-]")
    legend_above(figure, ax, columns=4)
    tau_ms = 1e3 * model.time_constant_s
    caption = (
        "In-stall pressure characteristic of the 98.5 % test by the paper's estimator, from the "
        f"paper's reduction: within φ = {low:g} to {high:g} off the rig's own by at most {off:.2f} "
        f"of {true.min():.1f} to {true.max():.1f}, with a time constant of {tau_ms:.0f} ms for the "
        f"rig's {1e3 * float(run.rig.truth_parameters['tau_s']):.0f}." + words
    )
    return PaperFigure(
        23,
        "In-stall pressure characteristic, 98.5 % speed",
        figure,
        caption,
        "A Comparison Between the 98.5% Nc Estimated Pressure Coefficient and 75% Nc Test Data.",
    )


def _steady_points(run: InstabilityRun) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return φ, mean ψ' and its standard deviation at steady points along the slow sweep."""
    series = run.paper.series
    phi, psi_p = series.phi[series.scored], series.psi_p[series.scored]
    low, high = (float(end) for end in np.percentile(phi, [1.0, 99.0]))
    edges = np.linspace(low, high, STEADY_POINTS + 1)
    which = np.digitize(phi, edges) - 1
    groups = [which == i for i in range(STEADY_POINTS) if np.count_nonzero(which == i) > 1]
    rows = [(np.mean(phi[g]), np.mean(psi_p[g]), np.std(psi_p[g], ddof=1)) for g in groups]
    table = np.asarray(rows, dtype=np.float64).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2]


def _histogram_high(run: InstabilityRun) -> PaperFigure:
    phi = run.paper.series.phi[run.paper.series.scored]
    figure, ax = one_panel()
    shade_band(ax, *PAPER_PHI_985, r"$\varphi$ that the paper relies on", across=True)
    _histogram(ax, phi, COLUMN, "in-stall rows")
    ends = np.percentile(phi, [5.0, 95.0])
    _percentiles(ax, ends)
    legend_above(figure, ax)
    inside = float(np.mean((phi >= PAPER_PHI_985[0]) & (phi <= PAPER_PHI_985[1])))
    truth = _true_phi(run)
    low, high = np.percentile(truth, [5.0, 95.0])
    caption = (
        f"Flow coefficient of the {phi.size} in-stall rows behind Fig 23, in bins of {BIN:g}: "
        f"{100 * inside:.0f} % of them lie in the paper's {PAPER_PHI_985[0]:g} to "
        f"{PAPER_PHI_985[1]:g}. From its 5th to its 95th percentile the measured φ runs from "
        f"{ends[0]:.3f} to {ends[1]:.3f}, the rig's true one at the same rows from {low:.3f} to "
        f"{high:.3f}: filtered pressures overshoot at each reversal and are late."
    )
    return PaperFigure(
        24,
        "Where φ dwells in stall, 98.5 % speed",
        figure,
        caption,
        "Histogram of In-Stall Flow Coefficient, 98.5% Nc.",
    )


def _both_characteristics(run: InstabilityRun) -> PaperFigure:
    figure, ax = one_panel(MEDIUM + 0.6)
    shade_band(ax, *PAPER_PHI_90, r"$\varphi$ that the paper relies on", across=True)
    grid = np.linspace(PAPER_PHI_90[0] - 2.0 * DRAWN_BEYOND, 0.2, 121)
    pressure, work = run.fits["psi_p"], run.fits.get("psi")
    symbol = coefficient_symbol("psi_p", quasi_steady=True)
    _curve(ax, pressure, PAPER_PHI_90, ACCENT, f"estimated {symbol}, ± 2 s.e.", grid)
    ax.plot(grid, in_stall_psi_p(run, grid), **(TRUTH | {"lw": 1.8}))
    inside = np.linspace(*PAPER_PHI_90, 50)
    off = np.abs(pressure.quasi_steady(inside) - in_stall_psi_p(run, inside)).max()
    words = f"ψ' is off the rig's own by at most {off:.2f} there"
    top = float(in_stall_psi_p(run, grid).max())
    if work is None:
        words += "; ψ could not be had from this record, whose exit temperature is not known"
    else:
        symbol = coefficient_symbol("psi", quasi_steady=True)
        forward = grid[grid >= 0.0]
        sure = (PSI_MINIMUM_PHI, PAPER_PHI_90[1])
        _curve(ax, work, sure, MARK, f"estimated {symbol}, ± 2 s.e.", forward, dashes="--")
        ax.plot(grid, in_stall_psi(run, grid), **(TRUTH | {"lw": 1.8}))
        known = np.linspace(*sure, 50)
        off = np.abs(work.quasi_steady(known) - in_stall_psi(run, known)).max()
        words += (
            f", ψ by at most {off:.2f} above φ = {PSI_MINIMUM_PHI:g}, below which it is a power "
            "over almost no flow and the curve is continued, not fitted"
        )
        top = max(top, float(work.quasi_steady(forward).max()), float(in_stall_psi(run, grid)[0]))
    ax.set_xlim(grid[0], grid[-1])
    ax.set_ylim(0.0, 1.08 * top)
    ax.set_xlabel(PHI)
    ax.set_ylabel("quasi-steady coefficient [-]")
    legend_above(figure, ax, columns=4)
    caption = (
        "Pressure coefficient (a parabola) and work coefficient (the pieces of Fig 22) of the 90 % "
        f"test, of which no row is taken out as unstalled. The paper trusts them from φ = "
        f"{PAPER_PHI_90[0]:g} to {PAPER_PHI_90[1]:g}: {words}." + _work_form_words(run)
    )
    return PaperFigure(
        25,
        "Pressure and work characteristics, 90 % speed",
        figure,
        caption,
        "Pressure and Work Coefficient Estimation Model, 90% Nc.",
    )


def _work_form_words(run: InstabilityRun) -> str:
    """Say where ψ comes from, if not from the flows of both planes."""
    forms = [e.parameters.get("form") for e in run.paper.record.history]
    if "psi" not in run.fits or "temperature-rise" not in forms:
        return ""
    return (
        " ψ is taken from the temperature rise alone, since the measured flows of the two planes "
        "disagree; that leaves out what is stored between them and makes it too high."
    )


def _histogram_low(run: InstabilityRun) -> PaperFigure:
    record, series = run.paper.record, run.paper.series
    phi = series.phi[series.scored]
    figure, grid = panels(1, 2, height_in=MEDIUM, width_ratios=(1.3, 1.0))
    ax, flows = grid[0]
    shade_band(ax, *PAPER_PHI_90, r"$\varphi$ that the paper relies on", across=True)
    _histogram(ax, phi, COLUMN, "rows that are fitted")
    _percentiles(ax, np.percentile(phi, [5.0, 95.0]))
    inlet = pounds(record["W25_kg_s"][series.scored])
    leaving = pounds(run.rig.truth["W31_kg_s"][series.scored])
    word = "W31, truth of the rig"
    if "W31_kg_s" in record:
        leaving, word = pounds(record["W31_kg_s"][series.scored]), "$W_{31}$ at the exit"
    edges = np.arange(np.floor(min(inlet.min(), leaving.min())), inlet.max() + 4.0, 4.0)
    for values, colour, label in ((inlet, ACCENT, "$W_{25}$ at the inlet"), (leaving, MARK, word)):
        flows.hist(values, bins=edges.tolist(), histtype="step", color=colour, lw=1.6, label=label)
    flows.axvline(0.0, color=INK, lw=0.6)
    flows.set_xlabel("physical flow [lbm/s]")
    flows.set_ylabel("rows")
    legend_above(figure, ax, flows, columns=3)
    share = {name: float(np.mean(v < 0.0)) for name, v in (("in", inlet), ("out", leaving))}
    caption = (
        f"Left: flow coefficient of the {phi.size} rows behind Fig 25, in bins of {BIN:g}, "
        f"{100 * float(np.mean(phi < 0.0)):.0f} % of them reversed; no regime is split off at 90 %,"
        " so that in-stall here means all of them. Right: the flow reverses to "
        f"{inlet.min():.0f} lbm/s at the inlet and to {leaving.min():.0f} at the exit, during "
        f"{100 * share['in']:.0f} and {100 * share['out']:.0f} % of the time: weaker at the exit, "
        "though in the rig not much rarer; the difference is stored between the planes."
    )
    return PaperFigure(
        26,
        "Where φ dwells, 90 % speed",
        figure,
        caption,
        "Histogram of the In-Stall Flow Coefficient, 90% Nc.",
    )


def _reconstruction(run: InstabilityRun) -> PaperFigure:
    model, record = run.fits["psi_p"], run.paper.series
    good, bad = (
        reconstruct_record(_with_time_constant(model, tau_s), record)
        for tau_s in (TRIAL_TIME_CONSTANT_S, WRONG_TIME_CONSTANT_S)
    )
    figure, grid = panels(2, height_in=HIGH, height_ratios=(1.7, 1.0))
    ax, trial = grid[:, 0]
    time_s, measured = good.rows.time_s, good.rows.measured
    pieces = runs_of(good.rows.labels, measured.size)
    ax.plot(*broken(time_s, measured, pieces), color=MEASURED, lw=2.4, label="actual")
    for one, colour, dashes in ((good, ACCENT, "-"), (bad, MARK, (0, (4, 1.5)))):
        label = f"reconstructed, τ = {_ms(one)} ms"
        line = broken(time_s, one.reconstructed, pieces)
        ax.plot(*line, color=colour, linestyle=dashes, lw=1.4, label=label)
        trial.plot(1e3 * one.model.time_constant_s, one.score.rms, "o", color=colour, ms=8)
    until_s = min(float(time_s[0]) + SHOWN_S, float(time_s[-1]))
    shown = time_s <= until_s
    ax.set_ylim(
        *robust_limits(measured[shown], good.reconstructed[shown], bad.reconstructed[shown])
    )
    ax.set_xlim(float(time_s[0]), until_s)
    ax.set_ylabel(f"instantaneous {coefficient_symbol('psi_p')} [-]")
    ax.set_xlabel("time [s]")
    tried = np.geomspace(*TRIED_S, TRIALS)
    rms = [reconstruct_record(_with_time_constant(model, t), record).score.rms for t in tried]
    trial.plot(1e3 * tried, rms, color=INK, lw=1.2, zorder=1)
    true_ms = 1e3 * float(run.rig.truth_parameters["tau_s"])
    trial.axvline(true_ms, **(TRUTH | {"zorder": 0}))
    trial.set_xscale("log")
    trial.set_xticks(TICKS_MS, [f"{tick:g}" for tick in TICKS_MS])
    trial.set_xticks([], minor=True)
    trial.set_ylim(0.0, 1.1 * max(rms))
    trial.set_xlabel("time constant tried [ms]")
    trial.set_ylabel("rms error [-]")
    figure.align_ylabels([ax, trial])
    legend_above(figure, ax, trial, columns=4)
    best_ms = 1e3 * float(tried[int(np.argmin(rms))])
    caption = (
        "Above: actual ψ' of the 90 % test and its free run from the measured φ through the curve "
        f"of Fig 25, the first {SHOWN_S:g} s of the window. Below: the paper's trial and error, "
        "the curve kept and the time constant changed. The rms error over the window is "
        f"{good.score.rms:.2f} ({good.score.fit_percent:.0f} % fit) with {_ms(good)} ms, "
        f"{bad.score.rms:.2f} with the {_ms(bad)} ms that the paper found at 98.5 %, and least "
        f"near {best_ms:.0f} ms (true: {true_ms:.0f} ms)." + _refitted_words(run)
    )
    return PaperFigure(
        27,
        "Reconstructed pressure coefficient, 90 % speed",
        figure,
        caption,
        "A Comparison of the Actual and Reconstructed Instantaneous Pressure Coefficient, 90% Nc.",
    )


def _refitted_words(run: InstabilityRun) -> str:
    """Say what a curve fitted for the wrong time constant makes of it."""
    model = run.fits.get("psi_p_243ms")
    if model is None:
        return ""
    rms = reconstruct_record(model, run.paper.series).score.rms
    low, high = model.quasi_steady(PAPER_PHI_90)
    return (
        f" A curve fitted for the wrong time constant brings its error down to {rms:.2f}, but runs "
        f"from {low:.1f} to {high:.1f} between φ = {PAPER_PHI_90[0]:g} and {PAPER_PHI_90[1]:g}."
    )


def _with_time_constant(model: FittedLag, tau_s: float) -> FittedLag:
    return replace(model, time_constant_s=float(tau_s), time_constant_stderr_s=0.0)


def _ms(run: Reconstruction) -> str:
    return f"{1e3 * run.model.time_constant_s:.0f}"


def _curve(
    ax: Axes,
    model: FittedLag,
    trusted: tuple[float, float],
    colour: str,
    label: str,
    grid: FloatArray | None = None,
    dashes: str = "-",
) -> None:
    """Draw a characteristic with its band, full in the range of trust and faint beyond."""
    phi, _, stderr = np.asarray(model.table).T
    if grid is None:
        grid = np.linspace(trusted[0] - DRAWN_BEYOND, trusted[1] + DRAWN_BEYOND, 121)
    value, wide = model.quasi_steady(grid), np.interp(grid, phi, stderr)
    inside = (grid >= trusted[0]) & (grid <= trusted[1])
    ax.plot(grid, value, color=colour, lw=1.0, linestyle=dashes, alpha=0.45)
    ax.plot(
        np.where(inside, grid, np.nan), value, color=colour, lw=2.0, linestyle=dashes, label=label
    )
    ax.fill_between(
        grid, value - BAND * wide, value + BAND * wide, color=colour, alpha=0.18, lw=0.0
    )


def _histogram(ax: Axes, phi: FloatArray, colour: str, label: str) -> None:
    low, high = BIN * np.floor(phi.min() / BIN), BIN * np.ceil(phi.max() / BIN)
    # Half a bin more, so that the last edge is not lost to rounding.
    edges = np.arange(low, high + 0.5 * BIN, BIN)
    edges[-1] = max(edges[-1], float(phi.max()))
    edges[0] = min(edges[0], float(phi.min()))
    ax.hist(phi, bins=edges.tolist(), color=colour, edgecolor="white", linewidth=0.6, label=label)
    ax.axvline(0.0, color=INK, lw=0.6)
    ax.set_xlabel(PHI)
    ax.set_ylabel("rows")


def _percentiles(ax: Axes, ends: FloatArray) -> None:
    for at, label in zip(ends, ("5th and 95th percentile", None), strict=True):
        ax.axvline(float(at), color=QUIET, lw=1.0, linestyle="--", label=label)


def _true_phi(run: InstabilityRun) -> FloatArray:
    """Return the rig's own φ at the rows that are fitted."""
    return run.rig.truth["phi"][run.paper.series.scored]
