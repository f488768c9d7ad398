"""The tables of the terminal."""

from __future__ import annotations

import dataclasses

from comparison_data import made_comparison


def test_a_time_constant_not_separated_from_zero_gets_an_upper_bound() -> None:
    comparison = made_comparison()
    small = {"time_constant_s": 2e-5, "time_constant_stderr_s": 1.6e-4}
    result = comparison.results[0]
    wide = dataclasses.replace(result, model=dataclasses.replace(result.model, **small))
    comparison = dataclasses.replace(comparison, results=(wide, *comparison.results[1:]))
    assert "< 0.28" in comparison.grid().rows[0]
