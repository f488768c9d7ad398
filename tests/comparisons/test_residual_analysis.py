"""Where φ dwells and where stall begins, on signals whose answer is known."""

from __future__ import annotations

import numpy as np

from comparisons.harness.residual_analysis import (
    dwelt_on,
    stall_inception,
)


def test_a_hole_in_phi_is_not_dwelt_on() -> None:
    phi = np.concatenate([np.linspace(-0.1, -0.05, 50), np.linspace(0.05, 0.3, 300)])
    grid = np.array([-0.12, -0.1, -0.06, -0.045, 0.0, 0.04, 0.045, 0.2, 0.31])
    expected = [False, True, True, True, False, False, True, True, False]
    assert dwelt_on(grid, phi).tolist() == expected


def test_stall_inception_is_the_last_summit_before_the_first_stall() -> None:
    ratio = np.concatenate(
        [np.full(400, 22.0), np.linspace(22.0, 23.7, 80), np.linspace(23.7, 2.0, 120)]
    )
    in_stall = np.arange(600) > 500
    assert ratio[stall_inception(ratio, in_stall, 1000.0)] == 23.7
    assert stall_inception(ratio, np.zeros(600, dtype=bool), 1000.0) is None
    assert stall_inception(ratio, np.ones(600, dtype=bool), 1000.0) is None
