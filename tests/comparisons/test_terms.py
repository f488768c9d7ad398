"""Names of terms mean their functions, and nothing in a name is executed."""

from __future__ import annotations

import numpy as np
import pytest

from classic_ml import LagRegressor, PiecewiseLinear
from comparisons.results import evaluate_terms, is_known_term
from surge_core.errors import InputError

PHI = np.array([-0.1, 0.0, 0.05, 0.3])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("1", [1.0, 1.0, 1.0, 1.0]),
        ("phi", PHI),
        ("phi^3", PHI**3),
        ("phi^2[phi<0]", [0.01, 0.0, 0.0, 0.0]),
        ("relu(phi-0.05)", [0.0, 0.0, 0.0, 0.25]),
        ("relu(phi--0.05)", [0.0, 0.05, 0.1, 0.35]),
        ("relu(phi+0.05)", [0.0, 0.05, 0.1, 0.35]),
        ("relu(phi)", [0.0, 0.0, 0.05, 0.3]),
        ("exp(-phi/0.1)", np.exp(-PHI / 0.1)),
        ("min(phi,0.05)", [-0.1, 0.0, 0.05, 0.05]),
        ("clip(phi-0.05,0,0.2)", [0.0, 0.0, 0.0, 0.2]),
    ],
)
def test_a_name_gives_its_function(name: str, expected: np.ndarray) -> None:
    assert is_known_term(name)
    np.testing.assert_allclose(evaluate_terms([name], PHI)[:, 0], expected, atol=1e-15)


@pytest.mark.parametrize(
    "name",
    ["__import__('os')", "phi**2", "psi", "phi^-1", "phi^2.5", "relu(x-1)", "relu(phi0.05)", ""],
)
def test_other_names_are_refused(name: str) -> None:
    assert not is_known_term(name)
    with pytest.raises(InputError, match="term"):
        evaluate_terms([name], PHI)


def test_the_classical_bases_are_known_by_name() -> None:
    rng = np.random.default_rng(0)
    phi = rng.uniform(-0.1, 0.4, 300)
    y = 0.2 * np.cumsum(rng.standard_normal(300)) / 20
    for basis in (None, PiecewiseLinear((0.1, 0.2)), PiecewiseLinear((0.1,))):
        m = LagRegressor(basis=basis, degree=3).fit(phi[:, None], y)
        value = evaluate_terms(m.terms_, PHI) @ m.coef_
        np.testing.assert_allclose(value, m.characteristic(PHI)[0], rtol=1e-12)
