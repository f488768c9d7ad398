"""The corner of a low-pass, seen in the spectrum of what it left."""

from __future__ import annotations

import numpy as np
import pytest
from lag_data import PERIOD_S, flow, lagged
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt

from classic_ml.filters import emptied_above_hz


def low_pass(values: np.ndarray, order: int, cutoff_hz: float, phase: str) -> np.ndarray:
    sections = butter(order, cutoff_hz, fs=1.0 / PERIOD_S, output="sos")
    if phase == "zero":
        return sosfiltfilt(sections, values, axis=0)
    start = sosfilt_zi(sections)[:, :, None] * np.atleast_2d(values[0])[None]
    rows = values if values.ndim == 2 else values[:, None]
    return sosfilt(sections, rows, axis=0, zi=start)[0].reshape(values.shape)


def drifting(seed: int, n: int = 10_000) -> tuple[np.ndarray, np.ndarray]:
    """Terms and ψ' of 10 s with a throttle sweep, a drift, the stall cells' ripple and noise."""
    rng = np.random.default_rng(seed)
    t = PERIOD_S * np.arange(n)
    fast = sosfilt(butter(2, 6.0, fs=1.0 / PERIOD_S, output="sos"), rng.standard_normal(n))
    phi = 0.3 + 0.15 * np.sin(2 * np.pi * 0.15 * t + rng.uniform(0, 6)) + 0.05 * fast / fast.std()
    drift = 0.06 * (0.5 * t / t[-1] + 0.5 * np.exp(-t))
    ripple = 0.03 * np.sin(2 * np.pi * 82.0 * t + rng.uniform(0, 6))
    psi_p = lagged(phi, "first") + drift + ripple + 0.004 * rng.standard_normal(n)
    return np.column_stack([np.ones(n), phi, phi**2]), psi_p


@pytest.mark.parametrize(
    ("order", "cutoff_hz", "phase"),
    [(5, 48.0, "causal"), (3, 48.0, "causal"), (3, 48.0, "zero"), (5, 100.0, "causal")],
)
def test_the_corner_of_a_low_pass_is_found(order: int, cutoff_hz: float, phase: str) -> None:
    for seed in range(3):
        signal = low_pass(drifting(seed)[1], order, cutoff_hz, phase)
        corner = emptied_above_hz(signal, sample_period_s=PERIOD_S)
        assert corner == pytest.approx(cutoff_hz, rel=0.3)
        # Rounding to five decimals is a floor far below.
        rounded = emptied_above_hz(np.round(signal, 5), sample_period_s=PERIOD_S)
        assert rounded == pytest.approx(corner, rel=0.05)


def test_unfiltered_records_and_white_noise_are_left_as_they_are() -> None:
    corners = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        phi = flow(2000, rng)
        noisy = lagged(phi, "first") + 0.003 * rng.standard_normal(2000)
        segments = np.arange(2000) * 10 // 2000
        corners.append(emptied_above_hz(noisy, segments, sample_period_s=PERIOD_S))
        corners.append(emptied_above_hz(drifting(seed, 3000)[1], sample_period_s=PERIOD_S))
        corners.append(emptied_above_hz(rng.standard_normal(400), sample_period_s=PERIOD_S))
        corners.append(
            emptied_above_hz(rng.standard_normal(400).cumsum(), sample_period_s=PERIOD_S)
        )
    assert set(corners) == {None}
    assert emptied_above_hz(np.arange(20.0), sample_period_s=PERIOD_S) is None
