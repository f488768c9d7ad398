from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pysindy.feature_library import PolynomialLibrary
from scipy.signal import lfilter

from sindy_surge import FitState, InputError, SparseLagRegressor

from .conftest import CURVES, PERIOD_S, TAU_S, TERMS, lag


def _labels(phi: np.ndarray, threshold: float = 0.27, shortest: int = 30) -> np.ndarray:
    """Number the in-stall intervals 1, 2, …, 0 elsewhere."""
    inside = np.concatenate(([0], (phi < threshold).astype(int), [0]))
    edges = np.flatnonzero(np.diff(inside))
    labels = np.zeros(phi.size, dtype=int)
    number = 0
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start >= shortest:
            number += 1
            labels[start:stop] = number
    return labels


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("curve", list(CURVES))
def test_exact_signals_give_the_exact_truth(
    surge: Callable[..., Any], hold: str, curve: str
) -> None:
    phi = surge("quadratic", 0.0, 7).clean_phi
    psi_p = lag(CURVES[curve](phi), PERIOD_S, hold)
    model = SparseLagRegressor(PERIOD_S, hold, n_bootstrap=0).fit(phi[:, None], psi_p)
    assert dict.fromkeys(model.terms_) == dict.fromkeys(TERMS[curve])
    np.testing.assert_allclose(model.coef_, list(TERMS[curve].values()), rtol=1e-7)
    assert model.time_constant_s_ == pytest.approx(TAU_S, rel=1e-7)
    assert model.fit_state_ == "ok"


@pytest.fixture(scope="module")
def many(surge: Callable[..., Any]) -> list[tuple[str, SparseLagRegressor]]:
    fits = []
    for curve in ("quadratic", "hinge", "reverse"):
        for seed in range(60, 64):
            record = surge(curve, 0.02, seed)
            model = SparseLagRegressor(n_bootstrap=0).fit(record.phi[:, None], record.psi_p)
            fits.append((curve, model))
    return fits


def test_structure_is_found_at_two_per_cent(many: list[tuple[str, SparseLagRegressor]]) -> None:
    assert all(set(model.terms_) == set(TERMS[curve]) for curve, model in many)


def test_tau_is_unbiased_and_its_error_honest(many: list[tuple[str, SparseLagRegressor]]) -> None:
    tau = np.array([model.time_constant_s_ for _, model in many])
    stderr = np.array([model.time_constant_stderr_s_ for _, model in many])
    z = (tau - TAU_S) / stderr
    # The three truths of a seed share its noise: four independent draws, not twelve.
    assert abs(tau.mean() / TAU_S - 1) < 0.005
    assert abs(z.mean()) < 4 / np.sqrt(4)
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.9


def test_coefficients_and_curve_lie_within_their_errors(
    many: list[tuple[str, SparseLagRegressor]],
) -> None:
    scores, curve_scores = [], []
    phi = np.linspace(-0.03, 0.5, 25)
    for curve, model in many:
        true = np.array([TERMS[curve][name] for name in model.terms_])
        scores += list((model.coef_ - true) / np.sqrt(np.diag(model.covariance_)))
        value, stderr = model.characteristic(phi)
        curve_scores += list((value - CURVES[curve](phi)) / stderr)
    for found in (np.array(scores), np.array(curve_scores)):
        assert np.max(np.abs(found)) < 5
        assert 0.4 < np.sqrt(np.mean(found**2)) < 1.7


def test_no_equation_straddles_two_segments(surge: Callable[..., Any]) -> None:
    record = surge("quadratic", 0.02, 41)
    labels = _labels(record.clean_phi)
    rows = np.flatnonzero(labels)
    phi, psi_p, labels = record.phi[rows], record.psi_p[rows], labels[rows]
    model = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p, segments=labels)

    order = np.random.default_rng(0).permutation(np.unique(labels))
    shuffled = np.concatenate([np.flatnonzero(labels == label) for label in order])
    mixed = SparseLagRegressor(n_bootstrap=0).fit(
        phi[shuffled, None], psi_p[shuffled], segments=labels[shuffled]
    )
    assert mixed.terms_ == model.terms_
    np.testing.assert_allclose(mixed.coef_, model.coef_, rtol=1e-5)
    assert mixed.time_constant_s_ == pytest.approx(model.time_constant_s_, rel=1e-5)

    linked = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)
    error = abs(linked.time_constant_s_ - TAU_S)
    assert error > 5 * abs(model.time_constant_s_ - TAU_S)


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_vanishing_lag_is_called_so(surge: Callable[..., Any], hold: str) -> None:
    phi = surge("quadratic", 0.0, 7).clean_phi
    forcing = CURVES["quadratic"](phi)
    rng = np.random.default_rng(1)
    psi_p = forcing if hold == "first" else np.concatenate((forcing[:1], forcing[:-1]))
    psi_p = psi_p + 0.01 * psi_p.std() * rng.standard_normal(phi.size)
    model = SparseLagRegressor(PERIOD_S, hold, n_bootstrap=0).fit(phi[:, None], psi_p)
    assert model.fit_state_ is FitState.LAG_BELOW_RESOLUTION
    assert model.time_constant_s_ < PERIOD_S / 3
    assert set(model.terms_) == set(TERMS["quadratic"])


def test_coloured_noise_is_whitened(surge: Callable[..., Any]) -> None:
    z = []
    for seed in range(2):
        clean = surge("quadratic", 0.0, 20 + seed)
        white = np.random.default_rng(seed).standard_normal((2, clean.phi.size))
        noise = lfilter([np.sqrt(1 - 0.81)], [1, -0.9], white, axis=1)
        phi = clean.phi + 0.02 * clean.phi.std() * noise[0]
        psi_p = clean.psi_p + 0.02 * clean.psi_p.std() * noise[1]
        model = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)
        assert set(model.terms_) == set(TERMS["quadratic"])
        z.append((model.time_constant_s_ - TAU_S) / model.time_constant_stderr_s_)
    assert np.max(np.abs(z)) < 4


def test_two_inputs() -> None:
    rng = np.random.default_rng(8)
    inputs = rng.uniform(-1, 1, (3000, 2))
    forcing = 0.3 + inputs[:, 0] - 0.8 * inputs[:, 0] * inputs[:, 1]
    clean = lag(forcing, PERIOD_S, "zero")
    psi_p = clean + 0.02 * clean.std() * rng.standard_normal(3000)
    model = SparseLagRegressor(hold="zero", n_bootstrap=0).fit(inputs, psi_p)
    assert set(model.terms_) == {"1", "x0", "x0 x1"}
    assert abs(model.time_constant_s_ - TAU_S) < 4 * model.time_constant_stderr_s_


def test_too_little_data_gives_a_static_fit_with_advice() -> None:
    phi = np.array([[0.1], [0.2], [0.4]])
    model = SparseLagRegressor(n_bootstrap=0).fit(phi, [1.0, 2.0, 4.0])
    assert model.fit_state_ is FitState.TOO_FEW_ROWS
    assert np.isnan(model.time_constant_s_)
    np.testing.assert_allclose(model.predict(phi), [1.0, 2.0, 4.0])
    ramp = np.linspace(0, 1, 50)
    lonely = SparseLagRegressor(n_bootstrap=0).fit(ramp[:, None], ramp, segments=np.arange(50))
    assert lonely.fit_state_ is FitState.TOO_FEW_ROWS


@pytest.mark.parametrize(
    ("where", "value"),
    [("sample_period_s", 0.0), ("sample_period_s", "1 ms"), ("hold", "second"),
     ("optimizer", "lasso"), ("library", 3), ("max_terms", 0), ("n_bootstrap", -1)],
)  # fmt: skip
def test_bad_parameters_are_named(where: str, value: object) -> None:
    rng = np.random.default_rng(0)
    phi = rng.uniform(-1, 1, (200, 1))
    psi_p = lag(phi[:, 0], PERIOD_S) + 0.01 * rng.standard_normal(200)
    with pytest.raises(InputError) as caught:
        SparseLagRegressor(**{where: value}).fit(phi, psi_p)
    assert caught.value.where == where


def test_bad_data_are_refused() -> None:
    phi = np.linspace(0, 1, 100)[:, None]
    psi_p = np.linspace(0, 1, 100)
    broken = psi_p.copy()
    broken[3] = np.nan
    for X, y in ((phi, broken), (np.where(phi > 0.5, np.inf, phi), psi_p), (phi[:50], psi_p)):
        with pytest.raises(ValueError, match=r"NaN|infinity|inconsistent"):
            SparseLagRegressor(n_bootstrap=0).fit(X, y)
    with pytest.raises(InputError, match="segments"):
        SparseLagRegressor(n_bootstrap=0).fit(phi, psi_p, segments=np.zeros(99, dtype=int))
    model = SparseLagRegressor(library=PolynomialLibrary(1), n_bootstrap=0).fit(phi, psi_p)
    with pytest.raises(InputError, match="phi"):
        model.characteristic(np.zeros((4, 2)))
    assert model.characteristic([])[0].size == 0


def test_bad_fits_carry_their_advice_among_the_cautions() -> None:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(200)
    pinned = SparseLagRegressor(n_bootstrap=0).fit(np.full((200, 1), 0.2), 3 + noise)
    assert pinned.fit_state_ is FitState.CONSTANT_SIGNAL
    assert pinned.cautions_ == (FitState.CONSTANT_SIGNAL.advice,)
    assert pinned.terms_ == ("1",)
    assert pinned.dead_time_s_ == 0.0
    assert pinned.inclusion_probability_ == {}


def test_a_lag_that_the_record_does_not_hold_is_no_number() -> None:
    # Without a constant, coefficients ran away to 1e14 and the free run was no number.
    few = {"library": PolynomialLibrary(2, include_bias=False)}
    for tau_s, noise, options in ((10.0, 5e-4, {}), (TAU_S, 5e-3, few)):
        rng, t = np.random.default_rng(5), np.arange(2000) * PERIOD_S
        hz, (a, b, c) = rng.uniform(3, 9), rng.uniform(0, 6.28, 3)
        fast = 0.14 * np.sin(2 * np.pi * hz * t + a + 1.5 * np.sin(1.2 * np.pi * t + b))
        phi = 0.15 + fast + 0.02 * np.sin(4.6 * np.pi * hz * t + c)
        f, pole = 1.15 + 3.0 * phi - 14.0 * phi**2, np.exp(-PERIOD_S / tau_s)
        y = lfilter([0.0, 1.0 - pole], [1.0, -pole], f, zi=[f[0]])[0]
        y += noise * rng.standard_normal(2000)
        model = SparseLagRegressor(PERIOD_S, "zero", n_bootstrap=0, **options).fit(phi[:, None], y)
        assert model.fit_state_ is FitState.LAG_UNDETERMINED
        assert np.isnan(model.time_constant_s_)
        assert np.isfinite(model.score(phi[:, None], y))


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
        colour = lfilter([0.309], [1, -0.951], white)
        psi_p = record.psi_p + 0.05 * record.psi_p.std() * colour
        model = SparseLagRegressor(n_bootstrap=0).fit(record.phi[:, None], psi_p)
        near = abs(model.time_constant_s_ - 0.018) < 6 * model.time_constant_stderr_s_
        assert near or model.fit_state_ is not FitState.OK
