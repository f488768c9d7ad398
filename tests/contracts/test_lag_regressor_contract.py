"""LagRegressor keeps scikit-learn's contract."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from sklearn.utils.estimator_checks import parametrize_with_checks

from classic_ml import LagRegressor

FREE_RUN = {
    "check_methods_sample_order_invariance": "a free run over time depends on the order of rows",
    "check_methods_subset_invariance": "a free run over time depends on the rows before",
}


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
@parametrize_with_checks(
    [
        LagRegressor(),
        LagRegressor(noise="arx", hold="first"),
        LagRegressor(noise="output-error", drift="spline", hold="first"),
    ],
    expected_failed_checks=lambda estimator: FREE_RUN,
)
def test_scikit_learn_contract(estimator: LagRegressor, check: Callable[..., None]) -> None:
    check(estimator)
