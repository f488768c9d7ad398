from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sindy_surge.segments import Segments
from sindy_surge.weak import MIN_HALF_WIDTH, WeakEquations, half_width_samples


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
