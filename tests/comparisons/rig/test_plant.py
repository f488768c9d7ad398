from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from comparisons.rig import CASES
from comparisons.rig.gas import CP_J_KG_K, GAMMA, GAS_CONSTANT_J_KG_K
from comparisons.rig.plant import PlantRun, run_plant
from surge_core.errors import InputError

H = 1e-4


@cache
def plant_run(case: str) -> PlantRun:
    """Four seconds of a case's plant at 10 kHz."""
    return run_plant(CASES[case], n_rows=40_001)


@pytest.mark.parametrize("name", CASES)
def test_a_throttle_that_stays_keeps_the_plant_at_rest(name: str) -> None:
    run = run_plant(replace(CASES[name], close_rate_per_s=0.0), n_rows=10_001)
    for signal in ("W25", "W31", "P25", "P31", "T25", "T31", "psi_p_lagged", "psi", "P_in"):
        values = run[signal]
        assert np.max(np.abs(values / values[0] - 1.0)) < 1e-8, signal
    assert np.all(run["in_stall"] == 0.0)


def test_halving_the_step_changes_little_until_cycles_separate() -> None:
    coarse, fine, finest = (run_plant(CASES["985"], n_rows=12_001, substeps=n) for n in (2, 4, 16))
    for run in (coarse, fine):
        assert np.max(np.abs(run["P31"] / finest["P31"] - 1.0)) < 1e-3
    # What is left comes from the moment at which the stall latch switches; before it the error is
    # the integrator's own and falls with the step.
    smooth = slice(0, 2_700)
    error = [np.max(np.abs((r["P31"] / finest["P31"])[smooth] - 1.0)) for r in (coarse, fine)]
    assert error[1] < 0.7 * error[0] < 1e-5


def test_both_coefficients_obey_the_lag_equation() -> None:
    run, tau = plant_run("985"), CASES["985"].tau_s
    for state, target in (("psi_p_lagged", "psi_p_qs"), ("psi", "psi_qs")):
        rate = (run[state][2:] - run[state][:-2]) / (2.0 * H)
        left = tau * rate + run[state][1:-1]
        assert np.sqrt(np.mean((left - run[target][1:-1]) ** 2)) < 2e-3


def test_momentum_equation_returns_psi_p() -> None:
    run, case = plant_run("985"), CASES["985"]
    u = case.rotor_velocity_m_s
    delivered = run["P31"] + case.inertia_per_m * run["dW25"]
    ratio = (delivered / run["P25"]) ** (1.0 / 3.5)
    psi_p = 2.0 * CP_J_KG_K * run["T25"] / u**2 * (ratio - 1.0)
    assert np.max(np.abs(psi_p - run["psi_p_total"])) < 1e-9


@pytest.mark.parametrize("name", ["985", "90"])
def test_energy_balance_returns_psi(name: str) -> None:
    run, case = plant_run(name), CASES[name]
    # Form E1: W31 T31 + V_c/(gamma R) dPm/dt = W25 T2, where the flow is no longer near zero.
    blading = run["P31"] + case.inertia_per_m * run["dW25"]
    mean = run["P25"] + case.internal_weight * (blading - run["P25"])
    stored = case.internal_volume_m3 / (GAMMA * GAS_CONSTANT_J_KG_K) * np.gradient(mean, H)
    rows = (run["phi"] > 0.05) & (np.arange(mean.size) > 6_000)
    t2 = (run["W31"] * run["T31"] + stored)[rows] / run["W25"][rows]
    psi = 2.0 * CP_J_KG_K * (t2 - run["T25"][rows]) / case.rotor_velocity_m_s**2
    error = psi - run["psi"][rows]
    assert np.sqrt(np.mean(error**2)) < 0.01
    assert np.max(np.abs(error)) < 0.1


def test_mass_is_conserved_in_the_discharge_volume() -> None:
    run, case = plant_run("985"), CASES["985"]
    mass = run["P31"] * case.discharge_volume_m3 / (GAS_CONSTANT_J_KG_K * run["T_plenum"])
    net = run["W31"] - run["W_throttle"]
    gained = np.concatenate([[0.0], np.cumsum(0.5 * (net[1:] + net[:-1]) * H)])
    assert np.max(np.abs(mass - mass[0] - gained)) < 2e-3 * mass[0]


def test_altered_case_without_an_equilibrium_is_refused() -> None:
    with pytest.raises(InputError, match="pressure rise"):
        run_plant(replace(CASES["985"], near_stall_phi_ratio=1.5), n_rows=10)
    with pytest.raises(InputError, match="subsonic"):
        run_plant(replace(CASES["985"], near_stall_phi_ratio=3.0), n_rows=10)
