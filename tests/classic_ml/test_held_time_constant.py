"""A held time constant."""

from __future__ import annotations

import numpy as np
import pytest
from lag_data import PERIOD_S, coloured, flow, lagged

from classic_ml import LagRegressor
from surge_core.errors import InputError

NOISES = ("arx", "armax", "output-error")


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


@pytest.mark.parametrize(
    ("parameters", "name"),
    [
        ({"time_constant_s": 0.0}, "time_constant_s"),
        ({"time_constant_s": "18 ms"}, "time_constant_s"),
    ],
)
def test_nonsense_is_refused_by_name(parameters: dict[str, object], name: str) -> None:
    phi = flow(200, np.random.default_rng(9))
    with pytest.raises(InputError, match=rf"^{name}: expected .*, found "):
        LagRegressor(PERIOD_S, **parameters).fit(phi[:, None], lagged(phi, "zero"))
