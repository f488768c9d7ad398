from __future__ import annotations

import math

import numpy as np
import pytest

from sindy_surge.equations import format_equation, format_uncertain


@pytest.mark.parametrize(
    ("value", "stderr", "text"),
    [
        (1.2134, 0.03, "1.213(30)"),
        (1.2134, 0.04, "1.21(4)"),
        (0.018012, 0.00012, "0.01801(12)"),
        (47.38, 1.2, "47.4(1.2)"),
        (47.38, 5.2, "47(5)"),
        (1234.0, 56.0, "1230(60)"),
        (2.0, 0.0, "2"),
        (2.5, math.nan, "2.5"),
        (0.35, 1e-20, "0.35"),
        (1.0, 0.0999, "1.00(10)"),
    ],
)
def test_values_are_rounded_to_their_error(value: float, stderr: float, text: str) -> None:
    assert format_uncertain(value, stderr) == text


def test_text_carries_units_signs_and_terms() -> None:
    text = format_equation(
        ["1", "phi", "phi^2[phi<0]", "relu(phi-0.05)"],
        [0.35, -1.2, 20.0, -0.5],
        [0.004, 0.05, 0.7, 0.04],
        0.018,
        0.00012,
    )
    assert text == (
        "0.01800(12) s · dψ'/dt + ψ' = 0.350(4) − 1.20(5) φ + 20.0(7) φ²[φ<0] "
        "− 0.50(4) relu(φ-0.05)   [φ, ψ' dimensionless, t in s]"
    )


def test_static_fit_has_no_derivative() -> None:
    text = format_equation(["1"], [-0.35], [math.nan], math.nan, math.nan)
    assert text == "ψ' = −0.35   [ψ' dimensionless]"


def test_python_source_is_the_characteristic() -> None:
    terms = ["1", "phi", "phi^2", "phi^2[phi<0]", "relu(phi-0.05)", "exp(-phi/0.1)"]
    coef = [0.35, -1.2, 3.0, 20.0, -0.5, 0.1]
    source = format_equation(terms, coef, [0.1] * 6, 0.018, 1e-4, "python")
    space: dict[str, object] = {}
    exec(source, space)
    phi = np.linspace(-0.05, 0.5, 23)
    expected = (
        0.35
        - 1.2 * phi
        + 3 * phi**2
        + 20 * phi**2 * (phi < 0)
        - 0.5 * np.maximum(phi - 0.05, 0)
        + 0.1 * np.exp(-phi / 0.1)
    )
    np.testing.assert_allclose(space["characteristic"](phi), expected)  # type: ignore[operator]
    assert space["TIME_CONSTANT_S"] == 0.018


def test_python_source_of_products_and_static_fits() -> None:
    source = format_equation(["x0 x1^2"], [2.0], [0.1], math.nan, math.nan, "python")
    space: dict[str, object] = {}
    exec(source, space)
    assert space["characteristic"](3.0, 2.0) == 24.0  # type: ignore[operator]
    assert math.isnan(space["TIME_CONSTANT_S"])  # type: ignore[arg-type]


def test_latex_balances_its_braces() -> None:
    text = format_equation(["1", "phi^2"], [0.3, -2.0], [0.01, 0.1], 0.018, 1e-4, "latex")
    assert text.count("{") == text.count("}")
    assert r"\varphi" in text
    assert "^{2}" in text
