"""A held time constant, and a dead time."""

from __future__ import annotations

import numpy as np
import pytest
from lag_data import BETA, PERIOD_S, TAU_S, coloured, flow, lagged

from classic_ml import LagRegressor
from surge_core.errors import InputError

NOISES = ("arx", "armax", "output-error")
HOLDS = ("zero", "first")
OVERSAMPLING = 20


def late(phi: np.ndarray, hold: str, dead_time_s: float) -> np.ndarray:
    """The delayed lag by a plain loop on a grid twenty times finer."""
    fine_s = PERIOD_S / OVERSAMPLING
    k = np.arange(phi.size * OVERSAMPLING)
    f = BETA[0] + BETA[1] * phi + BETA[2] * phi**2
    at = np.maximum(k * fine_s - dead_time_s, 0.0) / PERIOD_S
    if hold == "zero":
        fine = f[np.floor(at + 1e-9).astype(int)]
        now, before = 0.0, -np.expm1(-fine_s / TAU_S)
    else:
        fine = np.interp(at, np.arange(phi.size), f)
        ramp = -np.expm1(-fine_s / TAU_S) * TAU_S / fine_s
        now, before = 1.0 - ramp, ramp - np.exp(-fine_s / TAU_S)
    x = np.empty(fine.size)
    x[0] = fine[0]
    a = np.exp(-fine_s / TAU_S)
    for i in range(1, fine.size):
        x[i] = a * x[i - 1] + now * fine[i] + before * fine[i - 1]
    return x[::OVERSAMPLING]


@pytest.mark.parametrize("noise", NOISES)
def test_a_held_time_constant_is_the_fit_when_it_is_the_fitted_one(noise: str) -> None:
    rng = np.random.default_rng(0)
    phi = flow(2000, rng)
    y = lagged(phi, "zero") + coloured(2000, -0.5, 0.002, rng)
    free = LagRegressor(PERIOD_S, noise=noise).fit(phi[:, None], y)
    held = LagRegressor(PERIOD_S, noise=noise, time_constant_s=free.time_constant_s_)
    held.fit(phi[:, None], y)
    assert held.time_constant_s_ == free.time_constant_s_
    assert held.time_constant_stderr_s_ == 0.0
    np.testing.assert_allclose(held.coef_, free.coef_, rtol=1e-6)
    np.testing.assert_allclose(held.moving_average_, free.moving_average_, atol=1e-6)
    assert np.all(np.diag(held.covariance_) <= 1.5 * np.diag(free.covariance_))
    assert np.all(held.parameter_covariance_[0] == 0.0)


def test_the_cost_of_held_time_constants_has_its_least_at_the_fit() -> None:
    rng = np.random.default_rng(1)
    phi = flow(2000, rng)
    y = lagged(phi, "first") + 0.002 * rng.standard_normal(2000)
    options = {"noise": "armax", "hold": "first", "drift": "spline"}
    free = LagRegressor(PERIOD_S, **options).fit(phi[:, None], y)
    for factor in (0.97, 1.03):
        trial = factor * free.time_constant_s_
        held = LagRegressor(PERIOD_S, time_constant_s=trial, **options).fit(phi[:, None], y)
        assert held.residual_std_ > free.residual_std_


@pytest.mark.parametrize("dead_s", [0.0004, 0.003, 0.00725])
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("noise", NOISES)
def test_a_given_dead_time_undoes_the_delay_exactly(noise: str, hold: str, dead_s: float) -> None:
    phi = flow(1200, np.random.default_rng(2))
    y = late(phi, hold, dead_s)
    m = LagRegressor(PERIOD_S, noise=noise, hold=hold, dead_time_s=dead_s).fit(phi[:, None], y)
    assert m.time_constant_s_ == pytest.approx(TAU_S, rel=1e-6)
    np.testing.assert_allclose(m.coef_, BETA, rtol=1e-5)
    assert (m.dead_time_s_, m.dead_time_stderr_s_) == (pytest.approx(dead_s), 0.0)
    np.testing.assert_allclose(m.predict(phi[:, None]), y, atol=1e-8)
    fitted = LagRegressor(PERIOD_S, noise=noise, hold=hold, dead_time_s="fit")
    fitted.fit(phi[:, None], y)
    assert fitted.dead_time_s_ == pytest.approx(dead_s, abs=2e-7)
    assert fitted.time_constant_s_ == pytest.approx(TAU_S, rel=1e-5)


@pytest.mark.parametrize(("noise", "c"), [("armax", -0.6), ("output-error", -0.6), ("arx", 0.0)])
def test_a_fitted_dead_time_is_unbiased_and_knows_its_error(noise: str, c: float) -> None:
    z, dead_s = [], 0.0034
    for seed in range(25):
        rng = np.random.default_rng(seed)
        phi = flow(3000, rng)
        y = late(phi, "first", dead_s) + coloured(3000, c, 0.002, rng)
        m = LagRegressor(PERIOD_S, noise=noise, hold="first", dead_time_s="fit")
        m.fit(phi[:, None], y)
        truth = [TAU_S, dead_s, *BETA]
        found = [m.time_constant_s_, m.dead_time_s_, *m.coef_]
        z.append((np.array(found) - truth) / np.sqrt(np.diag(m.joint_covariance_)))
        assert m.dead_time_stderr_s_ == pytest.approx(np.sqrt(m.joint_covariance_[1, 1]))
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    # A root mean square of 25 z-scores scatters by 1/sqrt(50) = 14 % about one.
    assert np.all(np.abs(np.mean(z, axis=0)) < 4.0 / np.sqrt(25))
    assert np.all((rms > 0.55) & (rms < 1.6))


def test_no_dead_time_is_found_where_there_is_none() -> None:
    rng = np.random.default_rng(3)
    phi = flow(3000, rng)
    y = lagged(phi, "first") + 0.002 * rng.standard_normal(3000)
    m = LagRegressor(PERIOD_S, noise="output-error", hold="first", dead_time_s="fit")
    m.fit(phi[:, None], y)
    assert 0.0 <= m.dead_time_s_ < 3 * m.dead_time_stderr_s_
    assert abs(m.time_constant_s_ - TAU_S) < 4 * m.time_constant_stderr_s_


def test_slow_flow_cannot_tell_a_dead_time_from_a_lag_and_says_so() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(4000) * PERIOD_S
    phi = 0.3 + 0.15 * np.sin(2 * np.pi * 0.5 * t)
    y = lagged(phi, "first") + 0.003 * rng.standard_normal(t.size)
    both = LagRegressor(PERIOD_S, noise="output-error", hold="first", dead_time_s="fit")
    both.fit(phi[:, None], y)
    alone = LagRegressor(PERIOD_S, noise="output-error", hold="first").fit(phi[:, None], y)
    assert both.time_constant_stderr_s_ > 3 * alone.time_constant_stderr_s_
    # Their sum is what slow flow shows.
    total = both.time_constant_s_ + both.dead_time_s_
    assert total == pytest.approx(alone.time_constant_s_, rel=0.1)
    assert both.joint_covariance_[0, 1] < 0.0


def test_rows_that_answer_to_inputs_from_before_their_segment_are_not_scored() -> None:
    phi = flow(3000, np.random.default_rng(5))
    y = late(phi, "first", 0.006)
    keep = (np.arange(3000) % 500) >= 150
    labels = np.arange(3000) // 500
    for noise in NOISES:
        m = LagRegressor(PERIOD_S, noise=noise, hold="first", dead_time_s=0.006)
        m.fit(phi[keep, None], y[keep], segments=labels[keep])
        assert m.time_constant_s_ == pytest.approx(TAU_S, rel=1e-5)


@pytest.mark.parametrize(
    ("parameters", "name"),
    [
        ({"time_constant_s": 0.0}, "time_constant_s"),
        ({"time_constant_s": "18 ms"}, "time_constant_s"),
        ({"dead_time_s": -0.001}, "dead_time_s"),
        ({"dead_time_s": float("nan")}, "dead_time_s"),
        ({"dead_time_s": "find"}, "dead_time_s"),
        ({"dead_time_s": None}, "dead_time_s"),
        ({"dead_time_s": True}, "dead_time_s"),
        ({"dead_time_s": 0.15}, "dead_time_s"),
    ],
)
def test_nonsense_is_refused_by_name(parameters: dict[str, object], name: str) -> None:
    phi = flow(200, np.random.default_rng(9))
    with pytest.raises(InputError, match=rf"^{name}: expected .*, found "):
        LagRegressor(PERIOD_S, **parameters).fit(phi[:, None], lagged(phi, "zero"))
