"""One record of a test at the level of coefficients, without noise, for effects of given size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from comparisons.rig.coefficient_effects import (
    CHARACTERISTIC,
    LAG,
    OUTPUT,
    Parameters,
    crossed_levels,
)
from comparisons.rig.coefficient_kernels import backlash, constant_lag, varying_lag
from comparisons.rig.coefficient_plant import Plant, Points, lay_grid, sample_points
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["check_together", "lagged", "run_record"]

Planted = Mapping[str, Parameters]


def run_record(
    plant: Plant,
    record: int,
    time_s: FloatArray,
    planted: Planted,
    *,
    substeps: int,
    curve_offset: FloatArray | None = None,
) -> FloatArray:
    """Simulate ψ' of one record.

    Parameters
    ----------
    plant : Plant
        The test.
    record : int
        Number of the record, from 0.
    time_s : ndarray of shape (n,)
        The samples on the facility clock, in seconds, uniform.
    planted : mapping of str to mapping
        Parameters of each effect, by name; empty for none.
    substeps : int
        Steps of integration from one sample to the next. A lag with constant τ is exact for a
        ψ'_QS that is a parabola over a step, any other is of fourth order in it.
    curve_offset : ndarray of shape (n,), optional
        Added to ψ'_QS, held from each sample to the next.

    Returns
    -------
    ndarray of shape (n,)
        ψ' at the samples, without noise.
    """
    levels = [level for name, p in planted.items() for level in crossed_levels(name, p)]
    grid = lay_grid(
        plant,
        record,
        time_s,
        substeps=substeps,
        delay_s=planted.get("transport_delay", {}).get("delay_s", 0.0),
        levels=levels,
        turns="asymmetric_lag" in planted,
        slow_tau_s=planted.get("second_slow_mode", {}).get("slow_tau_s", 0.0),
    )
    curve = plant.quasi_steady(grid.phi)
    for name, parameters in planted.items():
        if name in CHARACTERISTIC:
            curve = CHARACTERISTIC[name](parameters, grid, curve)
    if curve_offset is not None:
        place = np.clip(np.searchsorted(time_s, grid.time_s[1]) - 1, 0, time_s.size - 1)
        curve = curve + curve_offset[place]
    psi = lagged(grid, curve, planted)
    if "sensor_backlash" in planted:
        psi = cast(FloatArray, backlash(psi, planted["sensor_backlash"]["half_width"]))
    shown = psi[grid.samples]
    at = sample_points(plant, record, time_s)
    for name, parameters in planted.items():
        if name in OUTPUT:
            shown = OUTPUT[name](parameters, at, shown)
    return shown


def lagged(grid: Points, curve: FloatArray, planted: Planted) -> FloatArray:
    """Pass ψ'_QS through the lag.

    Parameters
    ----------
    grid : Points
        Steps of integration.
    curve : ndarray of shape (3, m)
        ψ'_QS at the start, the middle and the end of each step.
    planted : mapping of str to mapping
        The effects.

    Returns
    -------
    ndarray of shape (m + 1,)
        ψ' at the ends of the steps, begun from the quasi-steady value.
    """
    curve = np.ascontiguousarray(curve)
    tau, start = grid.plant.tau_s, float(curve[0, 0])
    factors = [LAG[name](p, grid) for name, p in planted.items() if name in LAG]
    kappa = planted.get("nonlinear_relaxation", {}).get("kappa", 0.0)
    if "second_order_lag" in planted:
        return _second_order(grid, curve, planted["second_order_lag"]["a2_s2"])
    if factors or kappa:
        rate_hz = np.ones_like(grid.phi) / tau
        for factor in factors:
            rate_hz = rate_hz / factor
        psi = cast(FloatArray, varying_lag(grid.step_s, curve, rate_hz, kappa, start))
    else:
        psi = cast(FloatArray, constant_lag(grid.step_s, curve, tau, start))
    if "second_slow_mode" in planted:
        share, slow_s = (planted["second_slow_mode"][k] for k in ("share", "slow_tau_s"))
        psi = (1.0 - share) * psi + share * constant_lag(grid.step_s, curve, slow_s, start)
    return psi


def _second_order(grid: Points, curve: FloatArray, a2_s2: float) -> FloatArray:
    """Integrate a₂ ψ'' + τ ψ' + ψ = u as the sum of its two modes, which need not be real."""
    tau = grid.plant.tau_s
    start = complex(curve[0, 0])
    spread = np.sqrt(complex(tau**2 - 4.0 * a2_s2))
    slow, fast = 0.5 * (tau + spread), 0.5 * (tau - spread)
    if abs(fast) < np.finfo(np.float64).eps * tau:
        return cast(FloatArray, constant_lag(grid.step_s, curve, tau, start.real))
    first = constant_lag(grid.step_s, curve, slow, start)
    second = constant_lag(grid.step_s, curve, fast, start)
    return np.asarray(((slow * first - fast * second) / spread).real)


def check_together(names: tuple[str, ...]) -> None:
    """Refuse effects that cannot act at once.

    Parameters
    ----------
    names : tuple of str
        Effects of one test.

    Raises
    ------
    InputError
        For an effect named twice, or a second-order lag beside a lag whose τ varies.
    """
    if len(set(names)) < len(names):
        raise InputError("effect", expected="different effects", found=" and ".join(names))
    others = [n for n in names if n in LAG or n in ("nonlinear_relaxation", "second_slow_mode")]
    if "second_order_lag" in names and others:
        raise InputError(
            "effect",
            expected="second_order_lag beside an effect at another port",
            found=f"{others[0]} with it",
        )
