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


def test_no_alpha_is_no_filter() -> None:
    values = smooth()
    assert np.array_equal(all_pass(values, 0.0, 0.7), values)


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


@pytest.mark.parametrize(("alpha", "beta"), FILTERS)
def test_a_slow_packet_comes_late_by_the_group_delay(alpha: float, beta: float) -> None:
    """−dφ/dω at the carrier, from differences of the formula's phase."""
    n, centre, omega = 2000, 1000.0, 0.6
    k = np.arange(n)
    envelope = np.exp(-(((k - centre) / 60.0) ** 2))
    packet = envelope * np.cos(omega * k)
    moved = all_pass(packet[:, None], alpha, beta)[:, 0]
    late = float(
        np.sum(k * moved**2) / np.sum(moved**2) - np.sum(k * packet**2) / np.sum(packet**2)
    )
    near = np.array([omega - 1e-4, omega + 1e-4])
    wanted = -np.diff(phase_of(alpha, beta, near))[0] / 2e-4
    assert late == pytest.approx(wanted, abs=0.02)


@pytest.mark.parametrize(
    "n",
    [
        801,
        1003,
        800,
    ],
)
def test_a_constant_and_a_ramp_pass(n: int) -> None:
    """At rest the filter is nothing; a ramp comes late by 2α, whatever the length of the record."""
    k = np.arange(float(n))
    both = np.column_stack([np.full(n, 3.0), 0.5 * k])
    passed = all_pass(both, 0.9, 0.3)
    inner = slice(EDGE, -EDGE)
    assert np.allclose(passed[inner, 0], 3.0, atol=1e-9)
    assert np.allclose(passed[inner, 1], 0.5 * (k - 2 * 0.9)[inner], atol=5e-3)


def test_it_is_linear_and_takes_columns_alike() -> None:
    values = smooth(600)
    mixed = all_pass(values @ np.array([[2.0], [-3.0]]), 1.1, 0.5)[:, 0]
    assert np.allclose(mixed, all_pass(values, 1.1, 0.5) @ np.array([2.0, -3.0]), atol=1e-10)
    stacked = all_pass(np.stack([values, 2 * values], axis=2), 1.1, 0.5)
    assert np.allclose(stacked[:, :, 1], 2 * all_pass(values, 1.1, 0.5), atol=1e-10)


def test_a_stretch_shorter_than_its_padding_is_filtered_too() -> None:
    values = smooth(60)
    passed = all_pass(values, 0.5, 0.1)
    assert passed.shape == values.shape
    assert np.all(np.isfinite(passed))
