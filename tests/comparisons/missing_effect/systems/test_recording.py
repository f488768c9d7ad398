"""The recording filter: an all-pass that has an inverse, no gain, and the delay of its formula."""

from __future__ import annotations

import numpy as np
import pytest

from comparisons.missing_effect.systems.recording import all_pass

FILTERS = [(0.3, 0.05), (1.0, 0.4), (2.5, 1.5), (-0.8, 0.2)]
# Rows at either end that the prolongation of the record may disturb.
EDGE = 100


def smooth(n: int = 1500, seed: int = 0) -> np.ndarray:
    """Two channels of tones up to a quarter of the sample rate."""
    rng = np.random.default_rng(seed)
    k = np.arange(n)
    hz = rng.uniform(0.005, 0.25, (2, 8))
    phase = rng.uniform(0.0, 6.28, (2, 8))
    return np.sin(2 * np.pi * hz[:, :, None] * k + phase[:, :, None]).sum(axis=1).T


def phase_of(alpha: float, beta: float, omega: np.ndarray) -> np.ndarray:
    """Phase of (1 − αs + βs²)/(1 + αs + βs²) at s = iω, by complex division."""
    s = 1j * omega
    return np.unwrap(np.angle((1 - alpha * s + beta * s**2) / (1 + alpha * s + beta * s**2)))


@pytest.mark.parametrize(("alpha", "beta"), FILTERS)
def test_the_inverse_undoes_the_filter(alpha: float, beta: float) -> None:
    values = smooth()
    there_and_back = all_pass(all_pass(values, alpha, beta), alpha, beta, inverse=True)
    inner = slice(EDGE, -EDGE)
    assert np.max(np.abs(there_and_back - values)[inner]) < 2e-3 * np.std(values)


@pytest.mark.parametrize(("alpha", "beta"), FILTERS)
@pytest.mark.parametrize("hz", [0.01, 0.07, 0.2])
def test_a_tone_keeps_its_size_and_turns_by_the_phase(alpha: float, beta: float, hz: float) -> None:
    k = np.arange(2000)
    tone = np.cos(2 * np.pi * hz * k)
    turned = all_pass(tone[:, None], alpha, beta)[:, 0]
    phase = phase_of(alpha, beta, np.array([2 * np.pi * hz]))[0]
    wanted = np.cos(2 * np.pi * hz * k + phase)
    inner = slice(EDGE, -EDGE)
    assert np.max(np.abs(turned - wanted)[inner]) < 5e-3


@pytest.mark.parametrize("n", [801, 1003, 800])
def test_a_constant_and_a_ramp_pass(n: int) -> None:
    """At rest the filter is nothing; a ramp comes late by 2α, whatever the length of the record."""
    k = np.arange(float(n))
    both = np.column_stack([np.full(n, 3.0), 0.5 * k])
    passed = all_pass(both, 0.9, 0.3)
    inner = slice(EDGE, -EDGE)
    assert np.allclose(passed[inner, 0], 3.0, atol=1e-9)
    assert np.allclose(passed[inner, 1], 0.5 * (k - 2 * 0.9)[inner], atol=5e-3)
