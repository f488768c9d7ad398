"""The ripple's frequency is found, and the fit with it reads τ right."""

from __future__ import annotations

import numpy as np
import pytest

from classic_ml import LagRegressor
from classic_ml.ripple import ripple_frequency_hz
from surge_core.errors import InputError
from surge_core.lag import FirstOrderLag

PERIOD_S = 1e-3
TAU_S = 0.018


def rippled(
    seed: int, amplitude: float, cell_hz: float, *, noise: float = 0.004
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    lag = FirstOrderLag(TAU_S, PERIOD_S, "first")
    phis, psis, labels = [], [], []
    for label in range(10):
        time_s = np.arange(400) * PERIOD_S
        phi = 0.3 + 0.1 * np.sin(2 * np.pi * (6.0 + 0.3 * label) * time_s + rng.uniform(0, 6))
        quasi_steady = 0.3 + 1.2 * phi - 1.5 * phi**2
        psi = lag.respond(quasi_steady, quasi_steady[0])
        psi = psi + amplitude * np.sin(2 * np.pi * cell_hz * time_s + rng.uniform(0, 6))
        phis.append(phi)
        psis.append(psi + noise * rng.standard_normal(400))
        labels.append(np.full(400, label))
    return np.concatenate(phis)[:, None], np.concatenate(psis), np.concatenate(labels)


@pytest.mark.parametrize("cell_hz", [62.3, 82.5, 131.0])
def test_the_frequency_is_found_over_seeds(cell_hz: float) -> None:
    for seed in range(8):
        _, y, segments = rippled(seed, 0.01, cell_hz)
        found = ripple_frequency_hz(y, segments, sample_period_s=PERIOD_S)
        assert found == pytest.approx(cell_hz, abs=0.2)


def test_without_a_line_none_is_named() -> None:
    found = []
    for seed in range(40):
        _, y, segments = rippled(seed, 0.0, 82.5)
        found.append(ripple_frequency_hz(y, segments, sample_period_s=PERIOD_S))
    assert found.count(None) >= 38


def test_the_fit_with_it_is_free_of_the_ripple() -> None:
    taus, plain = [], []
    for seed in range(6):
        X, y, segments = rippled(seed, 0.03, 82.5)
        found = ripple_frequency_hz(y, segments, sample_period_s=PERIOD_S)
        for ripple_hz, into in ((found, taus), (None, plain)):
            m = LagRegressor(PERIOD_S, noise="armax", hold="first", ripple_hz=ripple_hz)
            into.append(m.fit(X, y, segments=segments).time_constant_s_)
    assert abs(np.mean(taus) - TAU_S) < 0.001
    assert abs(np.mean(plain) - TAU_S) > 2.0 * abs(np.mean(taus) - TAU_S)


def test_too_short_or_too_slow_is_refused() -> None:
    with pytest.raises(InputError, match="segments"):
        ripple_frequency_hz(np.zeros(50), sample_period_s=PERIOD_S)
    with pytest.raises(InputError, match="rows a second"):
        ripple_frequency_hz(np.zeros(500), sample_period_s=0.02)
