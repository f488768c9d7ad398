"""Residual checks: their false alarms and what they are there to see."""

from __future__ import annotations

import numpy as np
from lag_data import flow

from classic_ml.residual_checks import coverage, input_correlation, whiteness

WHOLE = [slice(0, 2000)]


def test_white_errors_raise_a_false_alarm_about_once_in_a_hundred() -> None:
    alarms = [
        not whiteness(np.random.default_rng(seed).standard_normal(2000), WHOLE).passed
        for seed in range(300)
    ]
    # 1 % of 300 is 3; ten would be four standard deviations too many.
    assert sum(alarms) <= 10


def test_coloured_errors_are_seen() -> None:
    rng = np.random.default_rng(0)
    white = rng.standard_normal(2001)
    assert not whiteness(white[1:] + 0.3 * white[:-1], WHOLE).passed


def test_errors_that_follow_the_flow_are_seen_and_others_are_not() -> None:
    alarms = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        phi = flow(2000, rng)
        noise = rng.standard_normal(2000)
        alarms += not input_correlation(noise, phi, WHOLE).passed
        moved = noise + 0.5 * (phi - phi.mean()) / phi.std()
        assert not input_correlation(moved, phi, WHOLE).passed
    assert alarms <= 3


def test_no_correlation_straddles_two_segments() -> None:
    errors = np.zeros(200)
    errors[99], errors[100] = 1.0, 1.0
    together = whiteness(errors, [slice(0, 200)]).statistic
    apart = whiteness(errors, [slice(0, 100), slice(100, 200)]).statistic
    assert together > 0.4
    assert apart == 0.0


def test_sweeps_are_counted_within_every_segment() -> None:
    phase = np.linspace(0.0, 2 * np.pi * 14, 2000)
    phi = 0.2 + 0.15 * np.sin(phase)
    one = coverage(phi, [slice(0, 2000)], (0.05, 0.35))
    two = coverage(phi, [slice(0, 1000), slice(1000, 2000)], (0.05, 0.35))
    assert one.statistic in (27.0, 28.0)
    assert two.passed
    assert not coverage(np.linspace(0.0, 0.4, 500), [slice(0, 500)], (0.02, 0.38)).passed
