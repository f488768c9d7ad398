from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from lag_data import flow, lagged
from sklearn.utils.estimator_checks import check_estimator

from sindy_surge import SparseLagRegressor

# A free run over time depends on the order of its rows and on every row before.
FREE_RUN = {
    "check_methods_sample_order_invariance": "a free run depends on the order of time",
    "check_methods_subset_invariance": "a free run depends on the rows before",
}


def test_scikit_learn_contract() -> None:
    results = check_estimator(
        SparseLagRegressor(n_bootstrap=2),
        expected_failed_checks=FREE_RUN,
        on_skip=None,
        on_fail="raise",
    )
    assert {r["check_name"] for r in results if r["status"] == "xfail"} == set(FREE_RUN)
    tags = SparseLagRegressor().__sklearn_tags__()
    assert not tags.non_deterministic


@pytest.fixture(scope="module")
def fitted() -> SparseLagRegressor:
    rng = np.random.default_rng(0)
    phi = flow(2000, rng)
    psi_p = lagged(phi, "first") + 0.0005 * rng.standard_normal(2000)
    return SparseLagRegressor(sample_period_s=1e-3, hold="first").fit(phi[:, None], psi_p)


def test_attributes_of_a_fit(fitted: SparseLagRegressor) -> None:
    assert abs(fitted.time_constant_s_ - 0.018) < 4 * fitted.time_constant_stderr_s_
    assert set(fitted.terms_) == {"1", "phi", "phi^2"}
    assert fitted.coef_.shape == (3,)
    assert fitted.covariance_.shape == (3, 3)
    assert np.all(np.linalg.eigvalsh(fitted.covariance_) > 0)
    assert len(fitted.candidate_terms_) >= 15
    assert set(fitted.terms_) <= set(fitted.candidate_terms_)
    assert "phi^2[phi<0]" in fitted.candidate_terms_
    assert "psi_p" not in (*fitted.candidate_terms_, *fitted.terms_)
    assert "s · dψ'/dt" in fitted.equation()


def test_characteristic_takes_flat_and_column_arrays(fitted: SparseLagRegressor) -> None:
    phi = np.linspace(0, 0.45, 7)
    flat, column = fitted.characteristic(phi), fitted.characteristic(phi[:, None])
    np.testing.assert_array_equal(flat[0], column[0])
    assert flat[0].shape == flat[1].shape == (7,)
    powers = np.vander(phi, 3, increasing=True)
    order = [fitted.terms_.index(name) for name in ("1", "phi", "phi^2")]
    np.testing.assert_allclose(flat[0], powers @ fitted.coef_[order])


def test_import_stays_cheap() -> None:
    code = "import sindy_surge, sys; print([m for m in ('pysindy', 'sklearn') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
