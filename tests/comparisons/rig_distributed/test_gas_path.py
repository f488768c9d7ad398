from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from comparisons.rig_distributed.euler import OUTPUTS, integrate
from comparisons.rig_distributed.machine import Machine
from comparisons.rig_distributed.plant import (
    PLANT_HZ,
    GasPath,
    PlantRun,
    constants,
    lay_out,
    run_plant,
)

GAMMA, R, CP = 1.4, 287.05, 1004.675
STILL_PA, STILL_K = 100_000.0, 300.0
SOUND_M_S = np.sqrt(GAMMA * R * STILL_K)


def closed_duct(n_cells: int, cycles: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Let the first mode of a closed duct of 4 m swing; the output, the end and the period."""
    length = 4.0
    cell_m = length / n_cells
    path = GasPath(cell_m, 2, 2, np.full(n_cells + 1, 0.3), np.zeros(n_cells))
    machine = Machine(tau_s=1e9, reverse_loss=0.0, transfer_units=0.0)
    c = constants(machine, path, 0.0, STILL_K)._replace(closed=1.0)
    x = (np.arange(n_cells) + 0.5) * cell_m
    pa = STILL_PA * (1.0 + 1e-4 * np.cos(np.pi * x / length))
    rho = STILL_PA / (R * STILL_K) * (pa / STILL_PA) ** (1.0 / GAMMA)
    cells = np.stack([rho, np.zeros(n_cells), pa / (GAMMA - 1.0)])
    period = 2.0 * length / SOUND_M_S
    n_steps = round(cycles * 20 * n_cells)
    rows = integrate(c, path.table, cells, np.zeros(4), n_steps, cycles * period / n_steps, 1)
    return rows, cells, cycles * period / n_steps


def test_a_closed_duct_rings_at_its_standing_wave() -> None:
    rows, _, step_s = closed_duct(80, cycles=3.0)
    p = rows[:, OUTPUTS.index("P25")] - STILL_PA
    falls = np.flatnonzero((p[:-1] > 0.0) & (p[1:] <= 0.0))
    falls = falls + p[falls] / (p[falls] - p[falls + 1])
    found_hz = 1.0 / (np.mean(np.diff(falls)) * step_s)
    assert found_hz == pytest.approx(SOUND_M_S / 8.0, rel=2e-3)


def test_the_error_of_the_wave_falls_with_the_square_of_the_cell() -> None:
    errors = []
    for n_cells in (40, 80):
        _, cells, _ = closed_duct(n_cells, cycles=1.0)
        x = (np.arange(n_cells) + 0.5) / n_cells
        pa = (GAMMA - 1.0) * (cells[2] - 0.5 * cells[1] ** 2 / cells[0])
        errors.append(np.mean(np.abs(pa / STILL_PA - 1.0 - 1e-4 * np.cos(np.pi * x))))
    assert np.log2(errors[0] / errors[1]) > 1.5


def test_a_closed_duct_keeps_its_mass_and_energy() -> None:
    rows, _, _ = closed_duct(40, cycles=2.0)
    for name in ("mass", "energy"):
        values = rows[:, OUTPUTS.index(name)]
        assert np.ptp(values) < 1e-11 * values[0]


@pytest.fixture(scope="module")
def surge() -> PlantRun:
    return run_plant(Machine(), n_rows=12_001)


def test_gas_and_energy_of_a_surging_machine_are_those_that_crossed_its_ends(
    surge: PlantRun,
) -> None:
    for held, crossed in (("mass", surge["W_in"] - surge["W_out"]), ("energy", surge["power"])):
        change = surge[held] - surge[held][0]
        came = np.concatenate([[0.0], np.cumsum(0.5 * (crossed[1:] + crossed[:-1])) / PLANT_HZ])
        assert np.max(np.abs(change - came)) < 1e-3 * np.ptp(change)


def test_before_the_surge_the_blading_multiplies_the_total_pressure(surge: PlantRun) -> None:
    u2 = Machine().rotor_velocity_m_s ** 2
    row = slice(1000, 1400)
    p25, t25, p31, t31 = (np.mean(surge[name][row]) for name in ("P25", "T25", "P31", "T31"))
    psi_p, psi = np.mean(surge["psi_p"][row]), np.mean(surge["psi"][row])
    assert p31 / p25 == pytest.approx((1.0 + psi_p * u2 / (2.0 * CP * t25)) ** 3.5, rel=0.005)
    assert t31 - t25 == pytest.approx(psi * u2 / (2.0 * CP), rel=0.005)


def test_momentum_between_the_planes_gives_the_pressure_coefficient(surge: PlantRun) -> None:
    machine = Machine()
    inertia, _ = lay_out(machine).between_planes
    rate = np.gradient(surge["W25"], 1.0 / PLANT_HZ)
    ratio = (surge["P31"] + inertia * rate) / surge["P25"]
    head = machine.rotor_velocity_m_s**2 / (2.0 * CP * surge["T25"])
    found = (ratio ** (1.0 / 3.5) - 1.0) / head
    forward = (surge["phi"] > 0.03) & (surge["phi"] < machine.peak_phi)
    assert np.std((found - surge["psi_p"])[forward]) < 0.10 * np.std(surge["psi_p"][forward])


def test_a_finer_grid_surges_alike(surge: PlantRun) -> None:
    finer = run_plant(Machine(), n_rows=6_001, cell_m=0.05)
    first = [np.argmax(run["phi"] < 0.0) / PLANT_HZ for run in (surge, finer)]
    assert first[0] == pytest.approx(first[1], abs=0.004)
    assert surge["P31"][:6000].min() == pytest.approx(finer["P31"][:6000].min(), rel=0.02)


def test_compact_ducts_surge_as_greitzers_lumped_model() -> None:
    # Low speed without heating, hardly any duct, a plenum that is short for the wave and large for
    # the flow.
    machine = replace(
        Machine(),
        rotor_velocity_m_s=90.0,
        tau_s=0.010,
        inlet_m=0.2,
        compressor_m=2.0,
        cone_m=0.6,
        plenum_m=1.5,
        exit_area_m2=0.24,
        plenum_area_m2=8.0,
        friction=0.0,
        inlet_loss=0.5,
        reverse_loss=0.0,
        supply_pa=101_325.0,
        work_zero=0.0,
        work_slope=0.0,
    )
    run = run_plant(machine, n_rows=30_001)
    path = lay_out(machine)
    inertia = np.sum(path.cell_m**2 / path.volumes_m3)
    volume = np.sum(path.volumes_m3[path.n_inlet + path.n_compressor :])
    growth = machine.growth_per_s
    supply_pa, t0 = machine.supply_pa, machine.supply_k
    rho0 = supply_pa / (R * t0)
    head = machine.rotor_velocity_m_s**2 / (2.0 * CP * t0)
    opening = np.median(run["throttle"][15_000:])
    passed = run["W_out"][1000] / np.sqrt(run["P31"][1000] - supply_pa) * opening

    def rates(_: float, s: np.ndarray) -> list[float]:
        flow, plenum_pa, psi_p, cell = s
        phi = flow / (rho0 * machine.inlet_area_m2 * machine.rotor_velocity_m_s)
        y, j = (phi - machine.valley) / machine.span - 1.0, (cell / machine.span) ** 2
        steady = 1.0 + 1.5 * y * (1.0 - 0.5 * machine.cell_share * j) - 0.5 * y**3
        steady = machine.level + machine.rise * steady
        inlet_pa = supply_pa - 0.25 * flow * abs(flow) / (rho0 * machine.inlet_area_m2**2)
        out = passed * np.sqrt(max(plenum_pa - supply_pa, 0.0))
        return [
            (inlet_pa * (1.0 + psi_p * head) ** 3.5 - plenum_pa) / inertia,
            GAMMA * R * t0 / volume * (flow - out),
            (steady - psi_p) / machine.tau_s,
            0.5 * growth * (cell * (1.0 - min(y * y, 6.0) - 0.25 * j) + 0.02 * machine.span),
        ]

    start = [run["W25"][15_000], run["P31"][15_000], run["psi_p"][15_000], 0.1]
    lumped = solve_ivp(rates, (0.0, 3.0), start, max_step=1e-3, rtol=1e-7)

    def period(time_s: np.ndarray, flow: np.ndarray) -> float:
        level = np.mean(flow)
        ups = time_s[1:][(flow[:-1] < level) & (flow[1:] >= level)]
        return float(np.median(np.diff(ups)))

    late = slice(15_000, None)
    own = period(np.arange(30_001)[late] / PLANT_HZ, run["W25"][late])
    assert own == pytest.approx(period(lumped.t, lumped.y[0]), rel=0.03)
    assert np.ptp(run["phi"][late]) > machine.peak_phi
