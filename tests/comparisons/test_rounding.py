"""Values rounded to their uncertainty, as the Particle Data Group does."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from surge_core.rounding import bracketed, round_to_error


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (30.0634, 1.2417, "30.1 ± 1.2"),
        (0.827, 0.119, "0.83 ± 0.12"),  # the three examples of the Review of Particle Physics
        (0.827, 0.367, "0.8 ± 0.4"),
        (0.827, 0.0952, "0.83 ± 0.10"),
        (18.0, 0.950, "18.0 ± 1.0"),
        (-0.004, 0.2, "0.00 ± 0.20"),
        (12345.0, 678.0, "12300 ± 700"),
        (1.23e-6, 4.6e-8, "(1.23 ± 0.05)e-06"),
        (3.0, 0.0, "3.000"),
        (3.0, math.nan, "3.000 ± ?"),
        (math.nan, 1.0, "n/a"),
    ],
)
def test_a_value_is_rounded_to_its_error(value: float, error: float, text: str) -> None:
    assert round_to_error(value, error) == text


def test_rounding_moves_a_value_by_less_than_half_its_error() -> None:
    rng = np.random.default_rng(3)
    values = rng.standard_normal(2000) * 10.0 ** rng.integers(-12, 12, 2000)
    errors = np.abs(values) * 10.0 ** rng.uniform(-5, 2, 2000)
    for value, error in zip(values, errors, strict=True):
        text = round_to_error(value, error)
        scaled = re.fullmatch(r"\((.*) ± (.*)\)e(.*)", text)
        mantissas = scaled.groups() if scaled else (*text.split(" ± "), "0")
        shown, shown_error = (float(part) * 10.0 ** int(mantissas[2]) for part in mantissas[:2])
        assert abs(shown - value) <= 0.5 * error
        assert shown_error == pytest.approx(error, rel=0.15)


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.35123, 0.0123, "0.351(12)"),
        (30.123, 1.23, "30.1(1.2)"),
        (1.0, 0.098, "1.00(10)"),
        (1.5, math.nan, "1.500"),
    ],
)
def test_a_bracketed_error_stands_for_the_last_digits(
    value: float, error: float, text: str
) -> None:
    assert bracketed(value, error) == text
