from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pysindy.feature_library import PolynomialLibrary
from scipy.signal import butter, sosfiltfilt

from sindy_surge import FitState, SparseLagRegressor
from sindy_surge.candidate_terms import CandidateTerms, polynomial_degree
from sindy_surge.held_out import MIN_HALF_WIDTH, WeakEquations, half_width_samples
from sindy_surge.lag_problem import LagProblem
from sindy_surge.noise import NoiseLevels
from sindy_surge.segments import Segments

from .conftest import PERIOD_S, TAU_S, lag, relaxation_wave

Curve = Callable[[Any], Any]


def _quadratic(phi: Any) -> Any:
    return 1.2 + 2.9 * phi + 20 * phi**2


def _kink(phi: Any) -> Any:
    return 1.2 + 2.9 * phi + 40 * np.maximum(phi - 0.25, 0)


def _record(
    seed: int, loss: float, curve: Curve = _quadratic, n: int = 2200
) -> tuple[np.ndarray, np.ndarray]:
    """A loss in reversed flow that is not lagged, 1 % noise, and the low-pass of a reduction."""
    rng = np.random.default_rng(seed)
    fine = relaxation_wave(8 * n, PERIOD_S / 8, rng)
    phi = fine[::8]
    psi_p = lag(curve(fine), PERIOD_S / 8, start=2.0)[::8] + loss * phi**2 * (phi < 0)
    low_pass = butter(3, 48.0, fs=1 / PERIOD_S, output="sos")
    noisy = (s + 0.01 * s.std() * rng.standard_normal(n) for s in (phi, psi_p))
    smooth, output = (sosfiltfilt(low_pass, s) for s in noisy)
    return smooth, output


def _in_stall(phi: np.ndarray) -> np.ndarray:
    inside = phi < 0.27
    return np.where(inside, np.cumsum(np.diff(inside, prepend=False)), 0)


@pytest.fixture(scope="module")
def hidden() -> list[tuple[np.ndarray, np.ndarray, SparseLagRegressor]]:
    fits = []
    for seed in range(4):
        phi, psi_p = _record(seed, 300.0)
        fits.append((phi, psi_p, SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)))
    return fits


def test_hidden_effect_is_called_so_and_the_curve_lies_within_its_band(
    hidden: list[tuple[np.ndarray, np.ndarray, SparseLagRegressor]],
) -> None:
    for phi, _, model in hidden:
        assert model.fit_state_ is FitState.MODEL_ERROR_DOMINATES
        assert 2 <= len(model.terms_) <= 4
        at = np.linspace(0, np.quantile(phi, 0.95), 20)
        value, stderr = model.characteristic(at)
        z = (value - _quadratic(at)) / stderr
        assert np.sqrt(np.mean(z**2)) < 1.5
        # A band wider than a tenth of the curve's own range would cover anything.
        assert np.median(stderr) < 0.1 * np.ptp(_quadratic(at))
        assert abs(model.time_constant_s_ - TAU_S) < 3 * model.time_constant_stderr_s_


def test_hidden_effect_in_short_segments() -> None:
    for seed in range(2):
        phi, psi_p = _record(seed, 300.0)
        labels = _in_stall(phi)
        rows = labels > 0
        model = SparseLagRegressor(n_bootstrap=0).fit(
            phi[rows, None], psi_p[rows], segments=labels[rows]
        )
        assert model.fit_state_ is FitState.MODEL_ERROR_DOMINATES
        assert len(model.terms_) <= 4
        at = np.linspace(0, 0.2, 20)
        value, stderr = model.characteristic(at)
        assert np.sqrt(np.mean(((value - _quadratic(at)) / stderr) ** 2)) < 1.8


def test_a_kink_that_explains_nearly_all_is_taken() -> None:
    phi, psi_p = _record(0, 100.0, _kink)
    model = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)
    assert model.fit_state_ is FitState.MODEL_ERROR_DOMINATES
    assert any("relu" in term for term in model.terms_)
    assert len(model.terms_) <= 4
    at = np.linspace(0, 0.45, 20)
    assert np.max(np.abs(model.characteristic(at)[0] - _kink(at))) < 0.5


def test_segments_too_short_for_a_test_function_are_no_success() -> None:
    phi, psi_p = _record(0, 600.0)
    model = SparseLagRegressor(n_bootstrap=0).fit(
        phi[:, None], psi_p, segments=np.arange(2200) // 8
    )
    assert model.fit_state_ in (FitState.NO_CONSISTENT_STRUCTURE, FitState.LAG_UNDETERMINED)


def test_weak_equations_recover_an_exact_lag(surge: Callable[..., Any]) -> None:
    record = surge("cubic", 0.0, 2)
    inputs = record.phi[:, None]
    terms = CandidateTerms(PolynomialLibrary(4), inputs, ["phi"])
    whole = Segments.from_labels(None, record.phi.size)
    silent = NoiseLevels(1.0, np.zeros(1), np.empty(0))
    problem = LagProblem(
        inputs, record.psi_p, whole, PERIOD_S, "first", terms, np.arange(5), silent
    )
    weak = WeakEquations.of(problem)
    assert weak is not None
    assert weak.centres.size == weak.signal.size
    expected = [0.30, 0.5, 3.0, -7.0, TAU_S]
    found, design, residual = weak.fit((0, 1, 2, 3))
    np.testing.assert_allclose(found, expected, rtol=2e-3)
    np.testing.assert_allclose(weak.fit_forward((0, 1, 2, 3)), expected, rtol=2e-3)
    np.testing.assert_allclose(design @ found + residual, weak.signal)
    for support in ((0,), (1, 3), (0, 1, 2)):
        rest = weak.fit(support)[2]
        assert weak.linear().chi2(support) == pytest.approx(rest @ rest, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "degree"),
    [
        ("1", 0),
        ("phi", 1),
        ("phi^4", 4),
        ("phi x1^2", 3),
        ("relu(phi-0.05)", None),
        ("phi^2[phi<0]", None),
        ("sin(1 phi)", None),
        ("s0", None),
    ],
)
def test_degree_of_a_term(name: str, degree: int | None) -> None:
    assert polynomial_degree(name, ["phi", "x1"]) == degree


def _powers(phi: np.ndarray) -> np.ndarray:
    return np.column_stack((np.ones_like(phi), phi, phi**2))


def test_weak_derivative_of_a_line_and_a_parabola_is_exact() -> None:
    time = np.arange(400) * 1e-3
    whole = Segments.from_labels(None, 400)
    for signal, slope in ((3 * time, np.full(400, 3.0)), (time**2, 2 * time)):
        weak = WeakEquations.integrate(signal, slope[:, None], whole, 20, 1e-3)
        change, value, columns = weak.derivative, weak.signal, weak.columns
        np.testing.assert_allclose(change, columns[:, 0], rtol=1e-3)
        assert change.size == value.size == (400 - 40 - 1) // 5 + 1


def test_no_test_function_reaches_across_segments(surge: Callable[..., Any]) -> None:
    record = surge("quadratic", 0.0, 2, 1200)
    runs = Segments.from_labels(np.repeat([1, 2, 3], [500, 300, 400]), 1200)
    jump = np.repeat([0.0, 5.0, -3.0], [500, 300, 400])
    terms = _powers(record.phi)
    change = WeakEquations.integrate(record.psi_p, terms, runs, 30, 1e-3).derivative
    moved = WeakEquations.integrate(record.psi_p + jump, terms, runs, 30, 1e-3).derivative
    np.testing.assert_allclose(moved, change, atol=1e-9)


def test_half_width_shrinks_with_the_segments() -> None:
    def width(lengths: list[int]) -> int | None:
        runs = Segments.from_labels(np.repeat(range(len(lengths)), lengths), sum(lengths))
        return half_width_samples(runs, 0.018, 1e-3)

    assert width([5000]) == 36
    assert width([100] * 5) == 24
    assert width([2 * MIN_HALF_WIDTH + 1] * 5) == MIN_HALF_WIDTH
    assert width([2 * MIN_HALF_WIDTH] * 5) is None
