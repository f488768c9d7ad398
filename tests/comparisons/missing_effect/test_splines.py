"""The free characteristic: splines that leave the base alone and end at the range of φ."""

from __future__ import annotations

import numpy as np
import pytest

from comparisons.missing_effect.catalogue.characteristic_effects import shape_columns


@pytest.mark.parametrize("n_base", [2, 3, 4])
def test_splines_leave_the_powers_of_the_base_alone(n_base: int) -> None:
    span = (-0.12, 0.55)
    phi = np.linspace(*span, 4001)
    columns = shape_columns(phi, span, 7, n_base)
    assert columns.shape[1] == 7 + 3 - n_base
    powers = np.vander((phi - span[0]) / (span[1] - span[0]), n_base, increasing=True)
    # Over the range no power of the base has a share in them, and none doubles another.
    assert np.max(np.abs(powers.T @ columns)) / phi.size < 0.02
    normal = columns.T @ columns / phi.size
    assert np.allclose(normal, np.eye(columns.shape[1]), atol=0.05)
    # What a base of degree below three lacks of a cubic, the splines have.
    lacking = phi**3 - np.polynomial.Polynomial.fit(phi, phi**3, n_base - 1)(phi)
    both = np.column_stack([powers, columns])
    left = phi**3 - both @ np.linalg.lstsq(both, phi**3, rcond=None)[0]
    assert np.max(np.abs(left)) < 1e-9
    assert np.max(np.abs(lacking)) > 1e-3 or n_base == 4


def test_splines_are_smooth_and_constant_beyond_the_range() -> None:
    span = (-0.12, 0.55)
    for side, end in (((-0.5, -0.12), -0.12), ((0.55, 0.9), 0.55)):
        beyond = shape_columns(np.linspace(*side, 50), span, 12, 4)
        assert np.allclose(beyond, shape_columns(np.array([end]), span, 12, 4))
    phi = np.linspace(*span, 20_001)
    columns = shape_columns(phi, span, 12, 4)
    # The second derivative of cubic splines has no jumps.
    bend = np.diff(columns, 2, axis=0) / (phi[1] - phi[0]) ** 2
    assert np.max(np.abs(np.diff(bend, axis=0))) < 0.02 * np.max(np.abs(bend))
