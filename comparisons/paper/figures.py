"""Six counterparts of the paper's figures: those that show physics."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from classic_ml.calibration import calibrate
from classic_ml.coefficients import flow_coefficient
from classic_ml.filters import low_pass, peak_frequency_hz, power_spectrum
from classic_ml.flow import LBM_KG
from comparisons.harness.reconstruction import reconstruct_record
from comparisons.page.blocks import Picture
from comparisons.page.style import (
    ACCENT,
    INK,
    MARK,
    MEASURED,
    PHI,
    broken,
    coefficient_symbol,
    legend_above,
    panel,
    robust_limits,
)
from comparisons.paper.claims_identification import steady_points
from comparisons.paper.instabilities import (
    STEADY_STALL,
    THRESHOLD_LBM_S,
    TRIAL_TIME_CONSTANT_S,
    WRONG_TIME_CONSTANT_S,
    Instabilities,
    InstabilityRun,
)
from comparisons.results import FittedLag, Reconstruction
from comparisons.rig.gas import PSI_PA
from surge_core.segments import runs_of
from surge_core.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TIME, ACTUAL = "time [s]", f"instantaneous {coefficient_symbol('psi_p')} [-]"
CURVE = coefficient_symbol("psi_p", quasi_steady=True)
HEIGHT_IN = 5.4
# How the rig's own signals and curves are drawn in every picture.
TRUTH: dict[str, Any] = {"color": INK, "lw": 1.8, "linestyle": (0, (1, 1.2))}
# The two orders that the paper tried, numbered so in its Fig 5, and the probe shown there.
ORDERS = {3: (ACCENT, "-"), 5: (MARK, (0, (4, 1.5)))}
PROBE = "P25_A_tip_forward"
CELL_BAND_HZ = (60.0, 105.0)
# Ranges of φ in which the paper trusts its curves, at 98.5 % and at 90 %, and what is drawn beyond.
PAPER_PHI_985 = (-0.025, 0.175)
PAPER_PHI_90 = (0.0, 0.1)
DRAWN_BEYOND = 0.03
SHOWN_S = 1.2


def draw_figures(runs: Instabilities) -> tuple[Picture, ...]:
    """Draw the six pictures, in the order of the paper, the validation last."""
    high, low = runs["985"], runs["90"]
    return (
        _spectra(low),
        _migration(high),
        _pressure_characteristic(high, runs[STEADY_STALL]),
        _low_speed_characteristics(low),
        _reconstruction(low),
        _validation(high, runs["985-second"]),
    )


def _picture(name: str, figure: Figure, seen: dict[str, Any]) -> Picture:
    """Return a picture under its words of figures.toml, with the numbers that were seen."""
    words = tomllib.loads(files("comparisons.paper").joinpath("figures.toml").read_text("utf-8"))
    own = words[name]
    return Picture(own["title"], figure, own["shows"].format(**seen), own["beside"])


def _ends(values: FloatArray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _spectra(run: InstabilityRun) -> Picture:
    """Draw Fig 4 and 5: stall cells in the inlet pressure, and what the filters leave of them."""
    settings, rate_hz = run.paper.settings, run.rig.raw.sample_rate_hz
    plain = calibrate(run.rig.raw, run.paper.test)[PROBE] / PSI_PA
    signals = {0: plain} | {
        order: low_pass(plain, rate_hz, order=order, cutoff_hz=settings.cutoff_hz, phase="causal")
        for order in ORDERS
    }
    figure, ax = panel("frequency [Hz]", "power spectral density [psi²/Hz]", HEIGHT_IN)
    density: dict[int, FloatArray] = {}
    for order, signal in signals.items():
        frequency, density[order] = power_spectrum(signal[run.window], rate_hz)
        colour, dashes = ORDERS.get(order, (MEASURED, "-"))
        word = f"({order}) filter of order {order}" if order else "(1) unfiltered"
        ax.semilogy(
            frequency[1:], density[order][1:], color=colour, linestyle=dashes, lw=1.2, label=word
        )
    ax.axvline(settings.cutoff_hz, color=INK, lw=0.9, linestyle="--", label="cut-off")
    ax.set_xlim(0.0, 200.0)
    ax.set_ylim(1e-10 * density[0].max(), 6.0 * density[0].max())
    legend_above(figure, ax, columns=4)
    cells = peak_frequency_hz(frequency, density[0], *CELL_BAND_HZ)
    at = int(np.argmin(np.abs(frequency - cells)))
    loss = {order: 10.0 * np.log10(density[0][at] / density[order][at]) for order in ORDERS}
    seen = {"cells": cells, "third": loss[3], "fifth": loss[5], "cutoff": settings.cutoff_hz}
    return _picture("spectra", figure, seen)


def _migration(run: InstabilityRun) -> Picture:
    """Draw Fig 11: the operating point in the quasi-steady cycles, over the rig's own curves."""
    record, rows = run.paper.record, run.window
    flow, ratio = record["Wc25_kg_s"] / LBM_KG, record["pressure_ratio"]
    stalled = flow < THRESHOLD_LBM_S
    figure, ax = panel(
        "inlet corrected flow $W_{c25}$ [lbm/s]", "pressure ratio $P_{31}/P_{25}$ [-]", HEIGHT_IN
    )
    for state, colour, word in (
        (stalled, ACCENT, "in stall"),
        (~stalled, MARK, f"unstalled, above {THRESHOLD_LBM_S:g} lbm/s"),
    ):
        # One row more at each end, so that the two colours meet.
        near = rows & (np.convolve(state, np.ones(3), mode="same") > 0.5)
        x, y = np.where(near, flow, np.nan), np.where(near, ratio, np.nan)
        ax.plot(x, y, color=colour, lw=0.8, label=word)
    speed = float(np.median(record["Nc_frac"][rows & ~stalled]))
    # The speed is constant, so that its corrected value says how warm the inlet is.
    case = run.machine
    inlet_K = case.supply_temperature_k * (case.corrected_speed_frac / speed) ** 2
    grid = np.linspace(0.0, float(flow[rows].max()) + 8.0, 400)
    phi = phi_of_flow(run, grid, inlet_K)
    phi_s, psi_s = case.stall_point(speed)
    below = case.in_stall_psi_p(phi) <= case.unstalled_psi_p(phi, speed)
    curve = pressure_ratio(run, case.in_stall_psi_p(phi[below]), inlet_K)
    ax.plot(grid[below], curve, **TRUTH, label="rig, in stall, quasi-steady")
    stable = phi >= phi_s
    line = pressure_ratio(run, case.unstalled_psi_p(phi[stable], speed), inlet_K)
    ax.plot(grid[stable], line, color=INK, lw=1.6, label=f"rig, speed line at {100 * speed:.0f} %")
    point = (float(np.interp(phi_s, phi, grid)), float(pressure_ratio(run, psi_s, inlet_K)))
    ax.plot(*point, "*", markersize=13, color=INK, label="its stall point")
    ax.axvline(0.0, color=INK, lw=0.6)
    legend_above(figure, ax)
    ends = {"ratio": _ends(ratio[rows]), "flow": _ends(flow[rows])}
    return _picture("migration", figure, ends | {"speed": 100.0 * speed, "point": point})


def phi_of_flow(run: InstabilityRun, flow_lbm_s: FloatArray, inlet_K: float) -> FloatArray:
    """Return φ of corrected flows in lbm/s at an inlet temperature (Eq 7)."""
    test = run.paper.test
    heat = np.full(flow_lbm_s.size, inlet_K)
    flow = LBM_KG * flow_lbm_s
    return flow_coefficient(flow, heat, test.areas_m2[25], test.rotor_velocity_m_s, test.compressor)


def pressure_ratio(run: InstabilityRun, psi_p: ArrayLike, inlet_K: float) -> FloatArray:
    """Return the pressure ratio of a ψ' at an inlet temperature."""
    gas = run.paper.test.compressor
    head = run.paper.test.rotor_velocity_m_s**2 / (2.0 * gas.specific_heat_J_kg_K * inlet_K)
    power = gas.gamma / (gas.gamma - 1.0)
    return np.asarray(np.maximum(1.0 + np.asarray(psi_p) * head, 0.0) ** power)


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
    figure, ax = panel(PHI, f"quasi-steady {CURVE} [-]", HEIGHT_IN)
    _curve(ax, model, PAPER_PHI_985, ACCENT, "estimate, 98.5 % speed, ± 2 s.e.", grid)
    ax.plot(grid, run.machine.in_stall_psi_p(grid), **TRUTH, label="truth of the rig")
    phi, psi_p, spread = steady_points(steady.paper.series)
    word = "75 % speed, steady rotating stall"
    ax.errorbar(phi, psi_p, yerr=spread, fmt="s", color=MARK, ms=6, capsize=2.5, lw=1.0, label=word)
    ax.set_xlim(grid[0], grid[-1])
    ax.set_ylim(0.0)
    legend_above(figure, ax)
    inside = np.linspace(low, high, 81)
    true = run.machine.in_stall_psi_p(inside)
    off = np.abs(model.quasi_steady(inside) - true).max()
    gap = psi_p - model.quasi_steady(phi)
    seen = {"phi": PAPER_PHI_985, "off": off, "true": _ends(true), "gap": _ends(gap)}
    seen["tau"] = (1e3 * model.time_constant_s, 1e3 * run.machine.tau_s)
    return _picture("pressure", figure, seen)


def _low_speed_characteristics(run: InstabilityRun) -> Picture:
    """Draw Fig 25: ψ'_QS and ψ_QS at 90 % beside the truth."""
    grid = np.linspace(PAPER_PHI_90[0] - DRAWN_BEYOND, 0.2, 121)
    inside = np.linspace(0.05, PAPER_PHI_90[1], 41)
    figure, ax = panel(PHI, "quasi-steady coefficient [-]", HEIGHT_IN)
    off, case = {}, run.machine
    for target, truth, colour, symbol in (
        ("psi_p", case.in_stall_psi_p, ACCENT, CURVE),
        ("psi", case.in_stall_psi, MARK, r"$\psi_{\mathrm{QS}}$"),
    ):
        model = run.fits[target]
        _curve(ax, model, PAPER_PHI_90, colour, f"estimated {symbol}, ± 2 s.e.", grid)
        ax.plot(grid, truth(grid), **TRUTH, label="truth of the rig")
        off[target] = np.abs(model.quasi_steady(inside) - truth(inside)).max()
    ax.set_xlim(grid[0], grid[-1])
    ax.set_ylim(0.0, 1.3 * float(case.in_stall_psi(grid).max()))
    legend_above(figure, ax)
    return _picture("low_speed", figure, off)


def _held(run: InstabilityRun, tau_s: float, other: InstabilityRun | None = None) -> Reconstruction:
    """Return the free run of a test's curve with a time constant held, over its record or other."""
    model = replace(run.fits["psi_p"], time_constant_s=float(tau_s), time_constant_stderr_s=0.0)
    return reconstruct_record(model, (other or run).paper.series)


def _over_time(*shown: tuple[Reconstruction, str, Any]) -> Figure:
    """Draw measured ψ' and reconstructions of it over the first second of the window."""
    figure, ax = panel(TIME, ACTUAL, HEIGHT_IN)
    rows = shown[0][0].rows
    pieces = runs_of(rows.labels, rows.measured.size)
    actual = broken(rows.time_s, rows.measured, pieces)
    ax.plot(*actual, color=MEASURED, lw=2.4, label="actual")
    for one, colour, dashes in shown:
        word = f"reconstructed, τ = {1e3 * one.model.time_constant_s:.0f} ms"
        line = broken(rows.time_s, one.reconstructed, pieces)
        ax.plot(*line, color=colour, linestyle=dashes, lw=1.4, label=word)
    from_s = float(rows.time_s[0])
    near = rows.time_s <= from_s + SHOWN_S
    ax.set_xlim(from_s, from_s + SHOWN_S)
    ax.set_ylim(
        *robust_limits(rows.measured[near], *(one.reconstructed[near] for one, *_ in shown))
    )
    legend_above(figure, ax)
    return figure


def _reconstruction(run: InstabilityRun) -> Picture:
    """Draw Fig 27: ψ' from the measured flow alone, with the two time constants of the paper."""
    good, bad = (_held(run, tau) for tau in (TRIAL_TIME_CONSTANT_S, WRONG_TIME_CONSTANT_S))
    figure = _over_time((good, ACCENT, "-"), (bad, MARK, (0, (4, 1.5))))
    return _picture("reconstruction", figure, {"good": good.score, "bad": bad.score})


def _validation(run: InstabilityRun, other: InstabilityRun) -> Picture:
    """Draw the curve of one 98.5 % instability run over the measured flow of the other."""
    own, new = (_held(run, TRIAL_TIME_CONSTANT_S, over) for over in (run, other))
    return _picture(
        "validation", _over_time((new, ACCENT, "-")), {"new": new.score, "own": own.score}
    )
