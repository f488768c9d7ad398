from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sindy_surge import InputError
from sindy_surge.free_run import (
    Segments,
    hold_coefficients,
    hold_sensitivities,
    lag_taps,
    run_lag,
    simulate,
    tap_sensitivities,
)


def _run(forcing: np.ndarray, tau_s: float, period_s: float, hold: str, start: float) -> np.ndarray:
    whole = Segments.from_labels(None, forcing.size)
    return simulate(forcing, whole, hold_coefficients(tau_s, period_s, hold), np.array([start]))


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_recursion_solves_the_differential_equation(hold: str) -> None:
    rng = np.random.default_rng(3)
    period_s, tau_s = 1e-3, 0.004
    forcing = rng.standard_normal(30)
    time = np.arange(30) * period_s

    def held(t: float) -> float:
        if hold == "first":
            return float(np.interp(t, time, forcing))
        return float(forcing[min(int(t / period_s + 1e-9), 29)])

    states = [0.7]
    for k in range(29):
        piece = solve_ivp(
            lambda t, x: (held(t) - x) / tau_s,
            (time[k], time[k + 1] - 1e-12),
            [states[-1]],
            rtol=1e-10,
            atol=1e-12,
        )
        states.append(piece.y[0, -1])
    np.testing.assert_allclose(_run(forcing, tau_s, period_s, hold, 0.7), states, atol=1e-6)


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("tau_s", [1e-6, 3e-4, 0.018, 0.9999, 1.0001, 1e4])
def test_constant_input_is_a_fixed_point(hold: str, tau_s: float) -> None:
    states = _run(np.full(50, 0.42), tau_s, 1e-3, hold, 0.42)
    np.testing.assert_allclose(states, 0.42, rtol=1e-12)


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("tau_s", [3e-4, 0.018, 0.999, 1.001, 50.0])
def test_sensitivities_are_the_derivatives(hold: str, tau_s: float) -> None:
    step = 1e-5 * tau_s
    above = np.array(hold_coefficients(tau_s + step, 1e-3, hold))
    below = np.array(hold_coefficients(tau_s - step, 1e-3, hold))
    expected = (above - below) / (2 * step)
    got = np.array(hold_sensitivities(tau_s, 1e-3, hold))
    np.testing.assert_allclose(got, expected, rtol=2e-5, atol=1e-9 / tau_s)


def test_short_lag_follows_its_input() -> None:
    forcing = np.random.default_rng(0).standard_normal(40)
    first = _run(forcing, 1e-9, 1e-3, "first", 9.0)
    zero = _run(forcing, 1e-9, 1e-3, "zero", 9.0)
    np.testing.assert_allclose(first[1:], forcing[1:], atol=1e-5)
    np.testing.assert_allclose(zero[1:], forcing[:-1], atol=1e-12)


def test_hold_coefficients_are_continuous_where_the_series_takes_over() -> None:
    below, above = (np.array(hold_coefficients(t, 1e-3, "first")) for t in (0.99999, 1.00001))
    assert np.max(np.abs(above - below)) < 2e-8


def test_segments_run_alone() -> None:
    rng = np.random.default_rng(1)
    forcing = rng.standard_normal(60)
    runs = Segments.from_labels(np.repeat([4, 2, 4], [10, 1, 49]), 60)
    lag = hold_coefficients(0.01, 1e-3, "first")
    start = np.array([1.0, 2.0, 3.0])
    joint = simulate(forcing, runs, lag, start)
    for number, rows in enumerate(runs.slices()):
        piece = forcing[rows]
        alone = simulate(
            piece, Segments.from_labels(None, piece.size), lag, start[number : number + 1]
        )
        np.testing.assert_array_equal(joint[rows], alone)
    assert runs.lengths.tolist() == [10, 1, 49]
    assert set(range(60)) - set(runs.later.tolist()) == {0, 10, 11}


@pytest.mark.parametrize(
    "labels", [np.zeros(4), np.zeros((5, 1)), np.full(5, 0.5), np.full(5, np.nan), ["a"] * 5]
)
def test_bad_labels_are_refused(labels: object) -> None:
    with pytest.raises(InputError, match="segments"):
        Segments.from_labels(labels, 5)  # type: ignore[arg-type]


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("samples", [-2.5, -1.0, -0.3, 0.0, 0.4, 1.0, 2.75])
def test_dead_time_equals_a_shifted_input(hold: str, samples: float) -> None:
    tau, period = 0.018, 1e-3
    rng = np.random.default_rng(2)
    forcing = rng.standard_normal(60)
    fine = 400
    # The held input on a fine grid, shifted there, run with tiny steps.
    at = np.arange(59 * fine + 1) / fine
    held = np.interp(at, np.arange(60), forcing) if hold == "first" else forcing[at.astype(int)]
    move = round(samples * fine)
    shifted = np.roll(held, move)
    decay = np.exp(-period / fine / tau)
    state, path = 0.0, [0.0]
    start = 10 * fine
    for k in range(start, 50 * fine):
        mean = 0.5 * (shifted[k] + shifted[k + 1]) if hold == "first" else shifted[k]
        state = decay * state + (1 - decay) * mean
        path.append(state)
    exact = np.array(path[::fine])
    taps = lag_taps(tau, period, hold, samples * period)
    rows = np.arange(10, 51)
    drive = taps.drive(forcing, rows)
    mine = run_lag(drive, Segments(np.array([0]), np.array([41])), taps.pole)
    np.testing.assert_allclose(mine, exact, atol=2e-5 if hold == "first" else 1e-9)
    assert taps.taps.sum() == pytest.approx(1 - taps.pole)


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("samples", [-1.3, 0.0, 0.2, 0.9])
def test_tap_sensitivities_are_the_derivatives(hold: str, samples: float) -> None:
    tau, period = 0.018, 1e-3
    shift = int(np.floor(samples))
    by_tau, by_dead = tap_sensitivities(tau, period, hold, samples * period, shift)

    def at(t: float, d: float) -> np.ndarray:
        return lag_taps(t, period, hold, d, shift).taps

    step = 1e-6
    dead = samples * period + 0.03 * period  # inside the sample on both sides
    by_tau_2, by_dead_2 = tap_sensitivities(tau, period, hold, dead, shift)
    np.testing.assert_allclose(
        by_tau_2.taps, (at(tau + step, dead) - at(tau - step, dead)) / (2 * step), rtol=1e-5
    )
    h = 1e-3 * period
    np.testing.assert_allclose(
        by_dead_2.taps, (at(tau, dead + h) - at(tau, dead - h)) / (2 * h), rtol=1e-4, atol=1e-6
    )
    # Continuous up to the edge of the sample.
    np.testing.assert_allclose(by_tau.taps, by_tau_2.taps, rtol=0.5, atol=0.2)
    assert abs(by_dead.taps.sum()) < 1e-6 * np.abs(by_dead.taps).max()
