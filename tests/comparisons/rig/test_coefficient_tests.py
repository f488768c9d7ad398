"""Simulated tests are as visible, as noisy and as reproducible as they were asked to be."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from comparisons.rig.coefficient_effects import EFFECTS, OUTSIDE, PAIRS
from comparisons.rig.coefficient_tests import CoefficientTest, Noise, simulate_test
from surge_core.errors import InputError

FloatArray = NDArray[np.float64]


def excess_of(test: CoefficientTest, degree: int) -> float:
    """Refit τ and a polynomial to the first 60 % of the first two records, by other means."""
    factor, parts = 4, []
    for record, clean in list(zip(test.records, test.clean, strict=True))[:2]:
        n = int(0.6 * clean.size)
        fine = np.linspace(record.time_s[0], record.time_s[n - 1], (n - 1) * factor + 1)
        parts.append((fine, CubicSpline(record.time_s, record.phi)(fine), clean[:n]))

    def left(log_tau: float) -> FloatArray:
        tau, columns = float(np.exp(log_tau)), []
        for fine, phi, clean in parts:
            h = fine[1] - fine[0]
            a = np.exp(-h / tau)
            # Weights of the straight line between two samples (first-order hold).
            b0 = 1.0 - tau / h * (1.0 - a)
            b1 = tau / h * (1.0 - a) - a
            powers = [lfilter([b0, b1], [1.0, -a], phi**k)[::factor] for k in range(1, degree + 1)]
            start = np.exp(-(fine[::factor] - fine[0]) / tau)
            columns.append((np.ones_like(clean), powers, start))
        ones = [np.concatenate([c[0] for c in columns])]
        shared = [np.concatenate([c[1][k] for c in columns]) for k in range(degree)]
        starts = [
            np.concatenate([c[2] * (i == j) for j, c in enumerate(columns)])
            for i in range(len(columns))
        ]
        basis = np.column_stack(ones + shared + starts)
        psi = np.concatenate([p[2] for p in parts])
        return np.asarray(psi - basis @ np.linalg.lstsq(basis, psi)[0])

    best = minimize_scalar(
        lambda x: float(np.sum(left(x) ** 2)),
        bounds=np.log(test.tau_s) + np.array([-1.2, 1.2]),
        method="bounded",
    )
    return float(np.sqrt(np.mean(left(best.x) ** 2)))


@pytest.mark.parametrize("name", EFFECTS[::3] + OUTSIDE[::3])
def test_effect_is_as_visible_as_asked(name: str) -> None:
    test = simulate_test(name, strength=1.5, seed=11, n_records=2, n_samples=1500)
    assert test.strengths == {name: pytest.approx(1.5, rel=2e-3)}
    assert excess_of(test, 3) == pytest.approx(1.5 * test.sigma, rel=0.06)


def test_nothing_is_left_of_a_test_without_effect() -> None:
    for degree in (2, 3):
        test = simulate_test(None, seed=11, degree=degree)
        assert len(test.beta) == degree + 1
        assert excess_of(test, degree) < 0.01 * test.sigma
    assert excess_of(test, 2) > test.sigma


def test_records_are_those_of_a_surge_test() -> None:
    for seed in range(3):
        test = simulate_test(None, seed=seed)
        assert 0.06 < test.tau_s < 0.20
        assert [r.time_s[0] for r in test.records] == pytest.approx([0.0, 30.0, 60.0])
        scale = np.std(np.concatenate(test.clean))
        assert test.sigma == pytest.approx(0.01 * scale, rel=1e-3)
        frequencies = []
        for record in test.records:
            above = record.phi > np.median(record.phi)
            frequencies.append(np.sum(np.diff(above.astype(int)) == 1) / 20.0)
            assert record.in_stall is not None
            assert 0.1 < record.in_stall.mean() < 0.9
            assert 0.01 < np.ptp(record.T25_K) / record.T25_K.mean() < 0.1
            assert 0.005 < np.ptp(record.Nc_frac) / record.Nc_frac.mean() < 0.05
        assert 0.7 < min(frequencies) < max(frequencies) - 0.1 < 1.6
        assert np.min(test.records[0].phi) < 0.0 or np.min(test.records[1].phi) < 0.0


def errors_of(noise: Noise) -> FloatArray:
    found = []
    for seed in range(4):
        test = simulate_test(None, seed=seed, noise=noise, n_records=1, n_samples=4000)
        found.append((test.records[0].psi_p - test.clean[0]) / test.sigma)
    return np.array(found)


def test_noise_has_the_size_and_kind_that_was_asked_for() -> None:
    # 16 000 draws: the standard error of the variance of white noise is 0.011.
    white, ar1, t3, wild = (errors_of(n) for n in ("white", "ar1", "t3", "outliers"))
    assert np.var(white) == pytest.approx(1.0, abs=0.04)
    assert np.var(ar1) == pytest.approx(1.0, abs=0.08)
    assert np.mean(ar1[:, 1:] * ar1[:, :-1]) / np.var(ar1) == pytest.approx(0.7, abs=0.02)
    assert np.mean(white[:, 1:] * white[:, :-1]) == pytest.approx(0.0, abs=0.03)
    # The quartiles of Student's t with three degrees are ±0.765 of its scale 1/√3.
    assert np.quantile(t3, 0.75) == pytest.approx(0.765 / np.sqrt(3.0), abs=0.02)
    assert np.max(np.abs(t3)) > 8.0
    # Of the outliers 69 % lie beyond four sigma, of the rest none to speak of.
    assert np.mean(np.abs(wild) > 4.0) == pytest.approx(0.0069, abs=0.0027)


@pytest.mark.parametrize(("noise", "share"), [("phi1", 0.01), ("phi3", 0.03)])
def test_noise_on_the_flow_is_on_the_flow_alone(noise: Noise, share: float) -> None:
    noisy, white = simulate_test(None, seed=2, noise=noise), simulate_test(None, seed=2)
    for i in range(3):
        off = noisy.records[i].phi - white.records[i].phi
        assert np.std(off) / np.std(white.records[i].phi) == pytest.approx(share, rel=0.06)
        np.testing.assert_array_equal(noisy.clean[i], white.clean[i])


@pytest.mark.parametrize("pair", PAIRS)
def test_each_of_a_pair_is_what_it_is_alone(pair: tuple[str, str]) -> None:
    both = simulate_test(pair, strength=2.0, seed=6, n_records=2)
    for name in pair:
        alone = simulate_test(name, strength=2.0, seed=6, n_records=2)
        assert both.effects[name] == alone.effects[name]
    assert excess_of(both, 3) > 1.5 * both.sigma


def test_records_in_segments() -> None:
    gapped = simulate_test("bias_drift", seed=3, gaps=True)
    whole = simulate_test("bias_drift", seed=3)
    assert gapped.effects == whole.effects
    assert all(record.segment is None for record in whole.records)
    for record, clean, other in zip(gapped.records, gapped.clean, whole.clean, strict=True):
        segment = record.segment
        assert segment is not None
        assert sorted(set(segment.tolist())) == [0, 1, 2, 3, 4]
        assert np.all(np.diff(segment[segment > 0]) >= 0)
        for number in (1, 2, 3, 4):
            rows = np.flatnonzero(segment == number)
            assert np.all(np.diff(rows) == 1)
            assert rows.size * 0.01 >= 10.0 * gapped.tau_s
        np.testing.assert_array_equal(clean[segment == 1], other[segment == 1])
        off = np.abs(clean - other)
        # In a gap the machine is elsewhere, and what follows remembers it for a few τ.
        assert off[segment == 0].max() > 20.0 * gapped.sigma
        after = np.flatnonzero(segment == 2)
        assert off[after[0]] > 5.0 * gapped.sigma
        assert off[after[int(9.0 * gapped.tau_s / 0.01)]] < 0.2 * gapped.sigma


@pytest.mark.parametrize(
    ("asked", "where"), [({"effect": "x_quad"}, "x_quad"), ({"n_samples": 99}, "n_samples")]
)
def test_what_cannot_be_simulated_is_refused(asked: dict[str, object], where: str) -> None:
    with pytest.raises(InputError, match=where):
        simulate_test(**asked)  # type: ignore[arg-type]
