"""Order statistics are exactly numpy's, and sums exact to the last bit, wherever blocks end."""

from __future__ import annotations

from math import fsum

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from classic_ml.columns import workspace
from classic_ml.columns.order_statistics import lowest, mean, median, percentile, total
from classic_ml.columns.workspace import OnDisk

BLOCKS = [7, 97, workspace.BLOCK_ROWS]
# Ties, zeros of both signs and neighbours are what a digit-by-digit search can get wrong.
NUMBERS = st.one_of(
    st.floats(-1e300, 1e300),
    st.sampled_from([0.0, -0.0, 1.0, -1.0, np.nextafter(1.0, 2.0), 5e-324, -5e-324]),
    st.integers(-3, 3).map(float),
)
COLUMNS = st.lists(NUMBERS, min_size=1, max_size=60).map(np.array)
SHARES = st.lists(st.floats(0.0, 100.0), min_size=1, max_size=3).map(np.array)


@pytest.fixture(params=BLOCKS)
def block(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(workspace, "BLOCK_ROWS", request.param)
    return request.param


@given(values=COLUMNS, q=SHARES, rows=st.sampled_from([1, 3, 1000]))
@settings(max_examples=150, deadline=None)
def test_median_and_percentiles_are_numpy_s(values: np.ndarray, q: np.ndarray, rows: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workspace, "BLOCK_ROWS", rows)
        with np.errstate(over="ignore"):
            assert median(values) == np.median(values)
            np.testing.assert_array_equal(percentile(values, q), np.percentile(values, q))
            assert percentile(values, q[0]) == np.percentile(values, q[0])


@given(values=COLUMNS, rows=st.sampled_from([1, 3, 1000]))
@settings(max_examples=100, deadline=None)
def test_a_total_depends_neither_on_blocks_nor_much_on_rounding(
    values: np.ndarray, rows: int
) -> None:
    values = np.clip(values, -1e15, 1e15)
    with pytest.MonkeyPatch.context() as patch:
        whole = total(values)
        patch.setattr(workspace, "BLOCK_ROWS", rows)
        assert total(values) == whole
    assert whole == pytest.approx(fsum(values), rel=1e-15, abs=1e-15 * np.abs(values).max())


def test_infinities_are_the_largest_and_a_nan_is_the_answer(block: int) -> None:
    values = np.concatenate((np.full(60, -np.inf), np.arange(81.0), np.full(60, np.inf)))
    assert median(values) == np.median(values) == 40.0
    assert percentile(values, 100.0) == np.inf
    assert total(values[60:]) == np.inf
    values[3] = np.nan
    assert np.isnan(median(values))
    assert np.isnan(percentile(values, [10.0, 90.0])).all()


@pytest.mark.parametrize("kind", ["counts", "pascal", "ties", "near"])
def test_long_columns_of_every_kind(kind: str, block: int) -> None:
    rng = np.random.default_rng(4)
    values = {
        "counts": rng.integers(0, 4096, 5001).astype(float),
        "pascal": 5.5e4 + 300.0 * rng.standard_normal(5002),
        "ties": rng.choice([-2.0, 1.0], 5003),
        "near": 1.0 + 2.0**-52 * rng.integers(0, 500, 5004),
    }[kind]
    shuffled = rng.permutation(values)
    mask = rng.random(values.size) < 0.4
    rows = slice(100, 4100)
    for part, chosen in ((None, values), (rows, values[rows]), (mask, values[mask])):
        assert median(values, part) == np.median(chosen)
        np.testing.assert_array_equal(
            percentile(values, [0, 16, 84, 100], part), np.percentile(chosen, [0, 16, 84, 100])
        )
        assert mean(values, part) == fsum(chosen) / chosen.size
    assert lowest(values, rows) == (values[rows].min(), np.argmin(values[rows]))
    assert median(shuffled) == median(values)
    assert mean(shuffled) == mean(values)


def test_a_column_on_disk_and_one_that_is_made_piece_by_piece(block: int) -> None:
    values = np.random.default_rng(5).standard_normal(4000)
    disk = OnDisk()
    column = disk.column(values.size)
    column[:] = values
    assert median(column, workspace=disk) == median(values)
    assert mean(column, workspace=disk) == mean(values)

    def squares() -> list[np.ndarray]:
        return [values[:1111] ** 2, values[1111:1111], values[1111:] ** 2]

    assert median(squares) == np.median(values**2)
    assert mean(squares) == mean(values**2)
    assert percentile(squares, 84.0) == np.percentile(values**2, 84.0)


def test_nothing_has_no_median_and_no_mean() -> None:
    for function in (median, mean):
        with pytest.raises(ValueError, match="no values"):
            function(np.zeros(5), slice(2, 2))
    assert total(np.zeros(0)) == 0.0
