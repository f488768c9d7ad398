"""Straight lines across unknown rows are numpy's, wherever blocks end."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from classic_ml.columns import workspace
from classic_ml.columns.workspace import IN_MEMORY, evaluated
from classic_ml.faults.bridging import bridged_rows


@given(
    known=st.lists(st.booleans(), min_size=1, max_size=60).map(np.array),
    rows=st.sampled_from([1, 7, 1000]),
    seed=st.integers(0, 100),
)
@settings(max_examples=200, deadline=None)
def test_bridged_is_interpolated_between_what_is_known(
    known: np.ndarray, rows: int, seed: int
) -> None:
    values = np.random.default_rng(seed).standard_normal(known.size)
    values[~known] = np.inf
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workspace, "BLOCK_ROWS", rows)
        n = known.size
        rows_of = bridged_rows(IN_MEMORY, n, values.__getitem__, known.__getitem__)
        got = evaluated(IN_MEMORY, n, rows_of)
    places = np.arange(known.size)
    expected = np.interp(places, places[known], values[known]) if known.any() else values
    np.testing.assert_array_equal(got, expected)
