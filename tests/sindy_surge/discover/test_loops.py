"""Loops drawn at random and measured with noise: branches, levels, lag, curves, duct and plenum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from surge_machines import STEP_S, SurgeMachine, draw, measured

from sindy_surge import InputError, SurgeLoop, discover_loop
from sindy_surge.discover.loop_signals import measure_cycles
from sindy_surge.discover.loops import _judged
from surge_core.fit_state import FitState


def curve_error(loop, machine, states, modes):
    worst = 0.0
    for i, branch in enumerate(loop.lag.branches):
        phi = states[:, 0] if loop.n_branches == 1 else states[modes == (i == 0), 0]
        grid = np.linspace(*np.quantile(phi, (0.005, 0.995)), 50)
        truth = np.array([machine.curves[i](x) for x in grid])
        worst = max(worst, float(np.max(np.abs(branch(grid) - truth))))
    return worst


@pytest.mark.parametrize(("seed", "every"), [(0, 1), (11, 4)])
def test_two_branches_with_their_levels(seed: int, every: int) -> None:
    machine, states, modes = draw(seed, "two")
    record = measured(states, 0.02, seed)[::every]
    loop = discover_loop(*record.T, every * STEP_S)
    assert loop.n_branches == 2
    np.testing.assert_allclose(loop.lag.levels, machine.levels, atol=0.005)
    assert loop.time_constant_s == pytest.approx(machine.tau_s, rel=0.01)
    assert curve_error(loop, machine, states, modes) < 0.03
    assert loop.state is FitState.OK
    # It surges by itself as the machine does.
    clean = measure_cycles(states, STEP_S)
    assert loop.period_s == pytest.approx(clean.period_s, rel=0.02)
    span = np.ptp(states, axis=0)
    assert np.all(np.abs(np.subtract(loop.simulated_cycles.lowest, clean.lowest)) < 0.05 * span)
    assert np.all(np.abs(np.subtract(loop.simulated_cycles.highest, clean.highest)) < 0.05 * span)


@pytest.mark.parametrize(("kind", "seed"), [("one", 2), ("kinked", 8)])
def test_one_branch_stays_one_with_a_kink_too(kind: str, seed: int) -> None:
    machine, states, modes = draw(seed, kind)
    loop = discover_loop(*measured(states, 0.02, seed).T, STEP_S)
    assert loop.n_branches == 1
    assert loop.lag.branches[0].powers == ((0, 2, 3) if kind == "one" else (-2, -1, 0, 2))
    assert curve_error(loop, machine, states, modes) < 0.03


def test_a_kink_lies_where_it_is_likeliest() -> None:
    def curve(phi: float) -> float:
        return 0.28 + 4.5 * phi**2 + (phi > 0.18) * (phi - 0.18) * (0.78 - 8.1 * (phi - 0.18))

    states, _ = SurgeMachine(90, 9, 0.42, 0.02, (0.2, 0.2), (curve, curve)).run(4000)
    (branch,) = discover_loop(*measured(states, 0.02, 1).T, STEP_S).lag.branches
    assert branch.powers == (-2, -1, 0, 2)
    assert abs(branch.knot - 0.18) < 4 * branch.knot_stderr < 0.02


def test_errors_hold_on_five_cycles() -> None:
    machine, states, _ = draw(9, "two")
    lag = discover_loop(*measured(states[:2000], 0.03, 9).T, STEP_S).lag
    off = np.subtract([lag.time_constant_s, *lag.levels], [machine.tau_s, *machine.levels])
    assert np.all(np.abs(off) < 4 * np.array([lag.time_constant_stderr_s, *lag.levels_stderr]))


@pytest.fixture(scope="module")
def loop() -> SurgeLoop:
    states, _ = replace(draw(0, "two")[0], loss=lambda phi: 5 * phi * abs(phi)).run(4000)
    return discover_loop(*measured(states, 0.01, 5).T, STEP_S)


def test_duct_plenum_and_errors(loop: SurgeLoop) -> None:
    machine = draw(0, "two")[0]
    assert (loop.state, loop.duct.terms) == (FitState.OK, ("psi_p", "plenum", "phi abs(phi)"))
    assert loop.plenum.terms == ("phi", "sqrt(plenum)")
    truth = np.array([machine.plenum, -machine.plenum * machine.throttle])
    assert np.all(np.abs(loop.plenum.coefficients - truth) < 5 * loop.plenum.stderr)
    truth = np.array([machine.duct, -machine.duct, -5])
    assert np.all(np.abs(loop.duct.coefficients - truth) < 4 * loop.duct.stderr)


def test_a_period_off_by_more_than_its_errors_is_said(loop: SurgeLoop) -> None:
    slower = replace(loop.plenum, coefficients=0.97 * loop.plenum.coefficients)
    assert _judged(replace(loop, plenum=slower)).state is FitState.PERIOD_OFF


def test_records_side_by_side_with_a_loss_that_the_library_lacks() -> None:
    machine = replace(draw(0, "two")[0], loss=lambda phi: 9 * phi**3)
    record = measured(machine.run(4000)[0], 0.01, 5)
    halves = [list(np.array_split(channel, 2)) for channel in record.T]
    loop = discover_loop(*halves, STEP_S)
    assert (loop.state, loop.n_branches) == (FitState.LIBRARY_TOO_SMALL, 2)
    assert loop.duct.beyond == ("phi^3",)
    assert loop.time_constant_s == pytest.approx(machine.tau_s, rel=0.01)


def test_a_throttle_opened_beyond_the_surge_line_is_steady(loop: SurgeLoop) -> None:
    limit, at = loop.surge_line()
    assert limit > 1  # the record surges
    beyond, growth = loop.operating_point(1.05 * limit)
    assert growth < 0
    assert beyond[0] > at[0] > draw(0, "two")[0].levels[1] - 0.01
    times, nudged = np.arange(0, 4, STEP_S), beyond + np.array([0.002, 0, 0])
    opened = loop.simulate(nudged, times, throttle=1.05 * limit)
    assert np.ptp(opened[-500:, 0]) < 0.01
    closed = loop.simulate(nudged, times, throttle=0.9 * limit)
    assert np.ptp(closed[-1000:, 0]) > 0.2


@pytest.mark.parametrize(
    ("phi", "words"),
    [(np.full(500, 0.3), "changes with the cycles"), (np.linspace(0, 1, 500), "surge cycles")],
)
def test_records_that_cannot_be_used(phi: np.ndarray, words: str) -> None:
    psi_p = np.linspace(0, 1, 500) + 0.01 * np.random.default_rng(0).normal(size=500)
    with pytest.raises(InputError, match=words):
        discover_loop(phi, psi_p, psi_p, STEP_S)
