"""Refusals of bad input, and cautions about results."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sindy_surge import FitState, SparseLagRegressor


def test_bad_fits_carry_their_advice_among_the_cautions() -> None:
    rng = np.random.default_rng(0)
    pinned = SparseLagRegressor(n_bootstrap=0).fit(
        np.full((200, 1), 0.2), 3 + rng.standard_normal(200)
    )
    assert pinned.fit_state_ is FitState.CONSTANT_SIGNAL
    assert pinned.cautions_ == (FitState.CONSTANT_SIGNAL.advice,)
    assert pinned.terms_ == ("1",)
    assert pinned.dead_time_s_ == 0.0
    assert pinned.inclusion_probability_ == {}


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_units_of_the_flow_do_not_matter(surge: Callable[..., Any], noise: float) -> None:
    record = surge("reverse", noise, 5)
    one = SparseLagRegressor(n_bootstrap=0).fit(record.phi[:, None], record.psi_p)
    # A thousandfold unit for φ, another scale and origin for ψ'.
    other = SparseLagRegressor(n_bootstrap=0).fit(1000 * record.phi[:, None], 50 * record.psi_p + 7)
    assert other.terms_ == one.terms_
    assert other.time_constant_s_ == pytest.approx(one.time_constant_s_, rel=1e-4)
    factor = {"1": 1.0, "phi": 1e3, "phi^2": 1e6, "phi^2[phi<0]": 1e6}
    found = other.coef_ * [factor[term] for term in other.terms_] / 50
    found[other.terms_.index("1")] -= 7 / 50
    np.testing.assert_allclose(found, one.coef_, rtol=2e-3)


def test_few_equations_are_no_success() -> None:
    rng = np.random.default_rng(0)
    phi = 0.25 + 0.2 * np.sin(np.arange(60) / 9)
    psi_p = 0.3 + phi + 0.01 * rng.standard_normal(60)
    model = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)
    assert model.fit_state_ is not FitState.OK


def test_strong_colour_does_not_pass_for_terms_with_psi_p(surge: Callable[..., Any]) -> None:
    for seed in (9, 11):
        record = surge("cubic", 0.01, seed, 2000)
        white = np.random.default_rng(seed).standard_normal(2000)
        colour = np.empty(2000)
        colour[0] = white[0]
        for k in range(1, 2000):
            colour[k] = 0.951 * colour[k - 1] + 0.309 * white[k]
        psi_p = record.psi_p + 0.05 * record.psi_p.std() * colour
        model = SparseLagRegressor(n_bootstrap=0).fit(record.phi[:, None], psi_p)
        near = abs(model.time_constant_s_ - 0.018) < 6 * model.time_constant_stderr_s_
        assert near or model.fit_state_ is not FitState.OK
