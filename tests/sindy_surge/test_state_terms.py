"""Truths whose right side holds ψ'."""

from __future__ import annotations

import numpy as np
import pytest

from sindy_surge import SparseLagRegressor
from sindy_surge.candidate_terms import ProductStateTerms, physical_form

from .conftest import PERIOD_S, TAU_S, relaxation_wave

N = 4000
TRUTHS = {
    "psi_p phi": (
        lambda p, v: 0.35 + 1.4 * p - 1.9 * p**2 - v * p,
        {"1": 0.35, "phi": 1.4, "phi^2": -1.9, "psi_p phi": -1.0},
    ),
    "psi_p phi, phi rises": (
        lambda p, v: 0.6 + 0.3 * p - p**2 - v * p,
        {"1": 0.6, "phi": 0.3, "phi^2": -1.0, "psi_p phi": -1.0},
    ),
    "psi_p^2": (
        lambda p, v: 0.65 + 1.2 * p - 1.9 * p**2 - 1.5 * v**2,
        {"1": 0.65, "phi": 1.2, "phi^2": -1.9, "psi_p^2": -1.5},
    ),
}


def _record(name: str, noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Integrated by Runge-Kutta's classical method at an eighth of the sample period."""
    right, _ = TRUTHS[name]
    rng = np.random.default_rng(seed)
    step = PERIOD_S / 8
    fine = relaxation_wave(8 * N, step, rng)
    psi_p = np.empty(fine.size)
    psi_p[0] = 0.4

    def rate(p: float, v: float) -> float:
        return float((right(p, v) - v) / TAU_S)

    for k in range(fine.size - 1):
        a, b, v = fine[k], fine[k + 1], psi_p[k]
        m = 0.5 * (a + b)
        k1 = rate(a, v)
        k2 = rate(m, v + 0.5 * step * k1)
        k3 = rate(m, v + 0.5 * step * k2)
        k4 = rate(b, v + step * k3)
        psi_p[k + 1] = v + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    phi, psi_p = fine[::8], psi_p[::8]
    white = rng.standard_normal((2, N))
    return phi + noise * phi.std() * white[0], psi_p + noise * psi_p.std() * white[1]


@pytest.mark.parametrize(("name", "noise"), [("psi_p phi", 0.02), ("psi_p^2", 0.005)])
def test_structures_with_psi_p_are_recovered(name: str, noise: float) -> None:
    truth = TRUTHS[name][1]
    scores = []
    for seed in range(2):
        phi, psi_p = _record(name, noise, seed)
        model = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)
        assert set(model.terms_) == set(truth)
        errors = np.sqrt(np.diag(model.covariance_))
        scores += list((model.coef_ - [truth[term] for term in model.terms_]) / errors)
        scores.append((model.time_constant_s_ - TAU_S) / model.time_constant_stderr_s_)
        # Away from the start the free run follows the record to within its noise.
        rest = (model.predict(phi[:, None]) - psi_p)[300:]
        assert np.std(rest) < 2 * noise * np.std(psi_p)
        assert any("about the mean" in caution for caution in model.cautions_)
    assert np.max(np.abs(scores)) < 5
    assert 0.3 < np.sqrt(np.mean(np.square(scores))) < 1.7


def test_signs_hold_for_what_is_printed_also_beside_terms_with_psi_p() -> None:
    phi, psi_p = _record("psi_p phi, phi rises", 0.005, 3)
    model = SparseLagRegressor(constraints={"phi": "positive"}, n_bootstrap=0)
    model.fit(phi[:, None], psi_p)
    assert set(model.terms_) == {"1", "phi", "phi^2", "psi_p phi"}
    assert model.coef_[model.terms_.index("phi")] == pytest.approx(0.3, abs=0.1)


def test_curve_at_rest_solves_the_equation() -> None:
    phi, psi_p = _record("psi_p phi", 0.005, 1)
    model = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)
    at = np.linspace(0.0, 0.5, 11)
    curve, stderr = model.characteristic(at)
    # ψ' (1 + φ) = 0.35 + 1.4 φ - 1.9 φ²
    true = (0.35 + 1.4 * at - 1.9 * at**2) / (1 + at)
    assert np.max(np.abs(curve - true) / stderr) < 5
    rate = model.as_function()
    np.testing.assert_allclose(rate(curve, at), 0.0, atol=1e-6)


def test_physical_form_is_the_same_model() -> None:
    rng = np.random.default_rng(0)
    X, psi_p = rng.uniform(0, 0.5, (40, 1)), rng.uniform(0.3, 0.5, 40)
    known = ["1", "phi", "phi^2"]
    states = ProductStateTerms.of(psi_p, ["phi"], "psi_p", known)
    assert states.centre > 0
    z = (psi_p - states.centre) / states.scale
    assert -1 <= z.min() < -0.9 < 0.9 < z.max() <= 1
    names = ["1", "phi", *states.names]
    beta = rng.normal(size=len(names)) * 0.1
    form = physical_form(names, beta, TAU_S, np.eye(len(names) + 1) * 1e-6, states, ["phi"])
    centred = np.column_stack((np.ones(40), X, states(X, psi_p))) @ beta
    plain = dict(zip(states.names, states.physical()(X, psi_p).T, strict=True))
    values = {"1": np.ones(40), "phi": X[:, 0], "phi^2": X[:, 0] ** 2, **plain}
    physical = sum(values[n] * c for n, c in zip(form.names, form.coefficients, strict=True))
    # dψ'/dt = (Σ - ψ')/τ is the same function of (φ, ψ').
    np.testing.assert_allclose(
        (physical - psi_p) / form.time_constant_s, (centred - psi_p) / TAU_S, rtol=1e-9
    )


def test_errors_of_the_physical_form_follow_by_differences() -> None:
    rng = np.random.default_rng(1)
    psi_p = rng.uniform(0.3, 0.5, 40)
    states = ProductStateTerms.of(psi_p, ["phi"], "psi_p", ["1", "phi", "phi^2"])
    names = ["1", "phi", "phi^2", "psi_p^2", "psi_p phi"]
    beta = np.array([0.4, 1.0, -1.5, 0.05, -0.02])
    half = rng.normal(size=(6, 6)) * 1e-4
    covariance = half @ half.T

    def form(move: np.ndarray) -> np.ndarray:
        found = physical_form(
            names, beta + move[:-1], TAU_S + move[-1], covariance, states, ["phi"]
        )
        return np.append(found.coefficients, found.time_constant_s)

    step = 1e-6
    jacobian = np.column_stack(
        [(form(step * unit) - form(-step * unit)) / (2 * step) for unit in np.eye(6)]
    )
    found = physical_form(names, beta, TAU_S, covariance, states, ["phi"])
    np.testing.assert_allclose(
        found.covariance, jacobian @ covariance @ jacobian.T, rtol=1e-5, atol=1e-14
    )
