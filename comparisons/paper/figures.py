"""Counterparts of the paper's figures that set its estimates beside the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.harness.reconstruction import reconstruct_record
from comparisons.page.blocks import Picture
from comparisons.page.style import (
    ACCENT,
    INK,
    MARK,
    MEASURED,
    broken,
    dress,
    legend_above,
    new_figure,
    robust_limits,
)
from comparisons.paper.claims_identification import steady_points
from comparisons.paper.instabilities import (
    STEADY_STALL,
    TRIAL_TIME_CONSTANT_S,
    WRONG_TIME_CONSTANT_S,
    Instabilities,
    InstabilityRun,
    in_stall_psi,
    in_stall_psi_p,
)
from comparisons.results import FittedLag, Reconstruction
from surge_core.segments import runs_of
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_figures", "held_run"]

PHI = r"flow coefficient $\varphi$ [-]"
HEIGHT_IN = 5.4
# How the rig's own signals and curves are drawn in every picture.
TRUTH: dict[str, Any] = {"color": INK, "lw": 1.8, "linestyle": (0, (1, 1.2))}
# Ranges of φ in which the paper trusts its curves, at 98.5 % and at 90 %, and what is drawn beyond.
PAPER_PHI_985 = (-0.025, 0.175)
PAPER_PHI_90 = (0.0, 0.1)
DRAWN_BEYOND = 0.03
SHOWN_S = 1.2


def draw_figures(runs: Instabilities) -> tuple[Picture, ...]:
    """Draw Fig 23, 25 and 27, with the truth of the rig.

    Parameters
    ----------
    runs : Instabilities
        All runs.

    Returns
    -------
    tuple of Picture
        In the order of the paper; each names the figure that it stands beside.
    """
    return (
        _pressure_characteristic(runs["985"], runs[STEADY_STALL]),
        _low_speed_characteristics(runs["90"]),
        _reconstruction(runs["90"]),
    )


def held_run(
    run: InstabilityRun, tau_s: float, other: InstabilityRun | None = None
) -> Reconstruction:
    """Return the free run of a test's curve with a time constant held.

    Parameters
    ----------
    run : InstabilityRun
        The test that the curve was fitted to.
    tau_s : float
        The time constant, in seconds.
    other : InstabilityRun, optional
        The test whose measured flow is run through it; by default the same.
    """
    model = replace(run.fits["psi_p"], time_constant_s=float(tau_s), time_constant_stderr_s=0.0)
    over = other or run
    return reconstruct_record(model, replace(over.paper.series, source=f"case {over.case}"))


def _panel(x: str, y: str) -> tuple[Figure, Axes]:
    figure = new_figure(height_in=HEIGHT_IN)
    ax = dress(figure.add_subplot())
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    return figure, ax


def _curve(
    ax: Axes,
    model: FittedLag,
    trusted: tuple[float, float],
    colour: str,
    label: str,
    grid: FloatArray,
) -> None:
    """Draw a characteristic with its band, full in the range of trust and faint beyond."""
    phi, _, stderr = np.asarray(model.table).T
    value, band = model.quasi_steady(grid), 2.0 * np.interp(grid, phi, stderr)
    inside = (grid >= trusted[0]) & (grid <= trusted[1])
    ax.plot(grid, value, color=colour, lw=1.0, alpha=0.45)
    ax.plot(np.where(inside, grid, np.nan), value, color=colour, lw=2.0, label=label)
    ax.fill_between(grid, value - band, value + band, color=colour, alpha=0.18, lw=0.0)


def _pressure_characteristic(run: InstabilityRun, steady: InstabilityRun) -> Picture:
    """Draw Fig 23: the identified ψ'_QS beside the truth and beside steady rotating stall."""
    low, high = PAPER_PHI_985
    grid = np.linspace(low - DRAWN_BEYOND, high + DRAWN_BEYOND, 121)
    model = run.fits["psi_p"]
    figure, ax = _panel(PHI, r"quasi-steady $\psi'_{\mathrm{QS}}$ [-]")
    _curve(ax, model, PAPER_PHI_985, ACCENT, "estimate, 98.5 % speed, ± 2 s.e.", grid)
    ax.plot(grid, in_stall_psi_p(run, grid), **TRUTH, label="truth of the rig")
    phi, psi_p, spread = steady_points(steady.paper.series)
    word = "75 % speed, steady rotating stall"
    ax.errorbar(phi, psi_p, yerr=spread, fmt="s", color=MARK, ms=6, capsize=2.5, lw=1.0, label=word)
    ax.set_xlim(grid[0], grid[-1])
    ax.set_ylim(0.0)
    legend_above(figure, ax)
    inside = np.linspace(low, high, 81)
    true = in_stall_psi_p(run, inside)
    off = np.abs(model.quasi_steady(inside) - true).max()
    gap = psi_p - model.quasi_steady(phi)
    return Picture(
        "In-stall pressure characteristic, 98.5 % speed",
        figure,
        "In-stall pressure characteristic by the paper's estimator from the paper's reduction: "
        f"within φ = {low:g} to {high:g} off the rig's own by at most {off:.2f} of "
        f"{true.min():.1f} to {true.max():.1f}, with a time constant of "
        f"{1e3 * model.time_constant_s:.0f} ms for the rig's {1e3 * run.true_tau_s:.0f}. Steady "
        f"rotating stall at 75 % lies above it, by {gap.min():.2f} to {gap.max():.2f}.",
        "In the paper: Figure 23.",
    )


def _low_speed_characteristics(run: InstabilityRun) -> Picture:
    """Draw Fig 25: ψ'_QS and ψ_QS at 90 % beside the truth."""
    grid = np.linspace(PAPER_PHI_90[0] - DRAWN_BEYOND, 0.2, 121)
    inside = np.linspace(0.05, PAPER_PHI_90[1], 41)
    figure, ax = _panel(PHI, "quasi-steady coefficient [-]")
    off = []
    for target, truth, colour, symbol in (
        ("psi_p", in_stall_psi_p, ACCENT, r"$\psi'_{\mathrm{QS}}$"),
        ("psi", in_stall_psi, MARK, r"$\psi_{\mathrm{QS}}$"),
    ):
        model = run.fits[target]
        _curve(ax, model, PAPER_PHI_90, colour, f"estimated {symbol}, ± 2 s.e.", grid)
        ax.plot(grid, truth(run, grid), **TRUTH, label="truth of the rig")
        off.append(np.abs(model.quasi_steady(inside) - truth(run, inside)).max())
    ax.set_xlim(grid[0], grid[-1])
    ax.set_ylim(0.0, 1.3 * float(in_stall_psi(run, grid).max()))
    legend_above(figure, ax)
    return Picture(
        "Pressure and work characteristics, 90 % speed",
        figure,
        "Pressure coefficient (a parabola) and work coefficient (three straight pieces) of the "
        "90 % test, of which no row is taken out as unstalled. From φ = 0.05 to 0.1 ψ' is off the "
        f"rig's own by at most {off[0]:.2f} and ψ by {off[1]:.2f}: ψ is taken from the temperature "
        "rise alone, which leaves out what is stored between the planes.",
        "In the paper: Figure 25.",
    )


def _reconstruction(run: InstabilityRun) -> Picture:
    """Draw Fig 27: ψ' from the measured flow alone, with the two time constants of the paper."""
    good, bad = (held_run(run, tau) for tau in (TRIAL_TIME_CONSTANT_S, WRONG_TIME_CONSTANT_S))
    rows = good.rows
    pieces = runs_of(rows.labels, rows.measured.size)
    figure, ax = _panel("time [s]", r"instantaneous $\psi'$ [-]")
    actual = broken(rows.time_s, rows.measured, pieces)
    ax.plot(*actual, color=MEASURED, lw=2.4, label="actual")
    for one, colour, dashes in ((good, ACCENT, "-"), (bad, MARK, "--")):
        word = f"reconstructed, τ = {1e3 * one.model.time_constant_s:.0f} ms"
        line = broken(rows.time_s, one.reconstructed, pieces)
        ax.plot(*line, color=colour, linestyle=dashes, lw=1.4, label=word)
    from_s = float(rows.time_s[0])
    near = rows.time_s <= from_s + SHOWN_S
    ax.set_xlim(from_s, from_s + SHOWN_S)
    shown = (rows.measured, good.reconstructed, bad.reconstructed)
    ax.set_ylim(*robust_limits(*(values[near] for values in shown)))
    legend_above(figure, ax)
    return Picture(
        "Reconstructed pressure coefficient, 90 % speed",
        figure,
        "Actual ψ' of the 90 % test and its free run from the measured φ through the curve of "
        f"Fig 25. The rms error over the window is {good.score.rms:.2f} "
        f"({good.score.fit_percent:.0f} % fit) with 18 ms and {bad.score.rms:.2f} with the 243 ms "
        "that the paper found at 98.5 %.",
        "In the paper: Figure 27.",
    )
