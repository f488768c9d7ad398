from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sindy_surge.segments import Segments
from sindy_surge.weak import MIN_HALF_WIDTH, WeakEquations, half_width_samples, weak_lag


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


def test_clean_record_gives_tau_from_both_directions(surge: Callable[..., Any]) -> None:
    record = surge("quadratic", 0.0, 1)
    whole = Segments.from_labels(None, record.phi.size)
    weak = weak_lag(record.psi_p, _powers(record.phi), whole, 1e-3)
    assert weak is not None
    assert weak.forward_s == pytest.approx(0.018, rel=1e-4)
    assert weak.reverse_s == pytest.approx(0.018, rel=1e-4)
    assert 1.5 < weak.half_width_s / 0.018 < 3


def test_gap_grows_with_the_noise(surge: Callable[..., Any]) -> None:
    gaps = []
    for noise in (0.01, 0.03, 0.09):
        record = surge("quadratic", noise, 1)
        whole = Segments.from_labels(None, record.phi.size)
        weak = weak_lag(record.psi_p, _powers(record.phi), whole, 1e-3)
        assert weak is not None
        gaps.append(weak.forward_s / weak.reverse_s - 1)
    # The attenuation goes with the variance: nine times for three times the noise.
    assert gaps[0] > 0
    assert 4 < gaps[1] / gaps[0] < 20
    assert 4 < gaps[2] / gaps[1] < 20


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
