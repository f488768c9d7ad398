"""LagRegressor keeps scikit-learn's contract."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from sklearn.utils.estimator_checks import parametrize_with_checks

from classic_ml import LagRegressor


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
@parametrize_with_checks(
    [LagRegressor(), LagRegressor(noise="arx", hold="first"),
     LagRegressor(noise="output-error", drift="spline", hold="first")],
)  # fmt: skip
def test_scikit_learn_contract(estimator: LagRegressor, check: Callable[..., None]) -> None:
    check(estimator)
