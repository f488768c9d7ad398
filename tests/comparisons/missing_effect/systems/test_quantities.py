"""Numbers of effects in physical units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_systems import STATES, fit_of, machine, placed_at

from comparisons.missing_effect.systems.quantities import numbers_of


@pytest.mark.parametrize(
    ("speed", "reach"),
    [("m/s", "m"), ("rad/s", "rad"), ("1/s", "1"), ("m/s²", "m/s"), ("1", "s"), ("A", "A·s")],
)
def test_what_a_rate_sums_up_to_has_the_unit_of_the_sum(speed: str, reach: str) -> None:
    model = machine()
    model = replace(model, states={**STATES, "v": speed})
    effect = placed_at(model, "hysteresis")
    fit = fit_of(model, (effect,), ())
    clock = np.array([0.0, 0.02, 0.0, 1.0])
    _, second, _ = numbers_of(fit, effect, np.eye(fit.theta.size), clock)
    assert (second.name, second.unit) == ("reach", reach)
