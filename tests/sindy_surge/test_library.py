from __future__ import annotations

import pickle

import numpy as np
import pytest
from pysindy.feature_library import FourierLibrary, PolynomialLibrary
from sklearn.preprocessing import PolynomialFeatures, SplineTransformer

from sindy_surge import InputError
from sindy_surge.candidate_terms import CandidateTerms, independent_columns
from sindy_surge.library import default_knots

PHI = np.linspace(-0.04, 0.51, 400)


def _terms(phi: np.ndarray, **options: object) -> CandidateTerms:
    return CandidateTerms(options.pop("library", None), phi[:, None], ["phi"], **options)  # type: ignore[arg-type]


def test_default_names_and_values() -> None:
    terms = _terms(PHI)
    values = dict(zip(terms.names, terms(PHI[:, None]).T, strict=True))
    expected = {
        "1": np.ones_like(PHI),
        "phi": PHI,
        "phi^5": PHI**5,
        "relu(phi)": np.maximum(PHI, 0),
        "relu(phi-0.05)": np.maximum(PHI - 0.05, 0),
        "relu(phi-0.3)": np.maximum(PHI - 0.3, 0),
        "phi^2[phi<0]": np.where(PHI < 0, PHI**2, 0),
        "exp(-phi/0.1)": np.exp(-PHI / 0.1),
    }
    for name, column in expected.items():
        np.testing.assert_allclose(values[name], column, atol=1e-15, err_msg=name)
    assert len(set(terms.names)) == len(terms.names)
    assert independent_columns(terms(PHI[:, None])).size == len(terms.names)


@pytest.mark.parametrize(
    ("low", "high", "wanted"),
    [(-0.04, 0.51, {0.05, 0.3}), (-0.03, 0.27, {0.05, 0.1}), (-40, 510, {50, 300}), (2, 3, {2.5})],
)
def test_knots_are_round_and_inside(low: float, high: float, wanted: set[float]) -> None:
    knots = default_knots(np.linspace(low, high, 500))
    assert wanted <= set(knots)
    assert all(low < k < high for k in knots)
    assert 5 <= len(knots) <= 15


@pytest.mark.parametrize(
    ("low", "high"),
    [(0.0, 1.0), (-3.0, -2.0), (1e6, 1e6 + 1), (1e-9, 3e-9), (0.5, 0.5), (-1, 1e-3)],
)
def test_at_least_fifteen_finite_candidates_anywhere(low: float, high: float) -> None:
    phi = np.linspace(low, high, 100)
    terms = _terms(phi)
    assert len(terms.names) >= 15
    assert len(set(terms.names)) == len(terms.names)
    assert np.all(np.isfinite(terms(phi[:, None])))


def test_what_cannot_be_separated_is_dropped() -> None:
    forward = np.linspace(0.0, 0.5, 300)
    terms = _terms(forward)
    kept = {terms.names[i] for i in independent_columns(terms(forward[:, None]))}
    # Without reversed flow the branch is zero, and a hinge at 0 would be phi itself.
    assert "phi^2[phi<0]" in terms.names
    assert "phi^2[phi<0]" not in kept
    constant = np.full(50, 0.2)
    kept = independent_columns(_terms(constant)(constant[:, None]))
    assert kept.tolist() == [0]


@pytest.mark.parametrize(
    "library",
    [
        PolynomialLibrary(3),
        FourierLibrary(2),
        PolynomialLibrary(1) + FourierLibrary(1),
        PolynomialFeatures(3),
        SplineTransformer(4),
    ],
)
def test_any_library_or_transformer_serves(library: object) -> None:
    terms = _terms(PHI, library=library)
    values = terms(PHI[:, None])
    assert values.shape == (PHI.size, len(terms.names))
    assert type(values) is np.ndarray
    again = pickle.loads(pickle.dumps(terms))
    np.testing.assert_array_equal(again(PHI[:, None]), values)


def test_bad_libraries_are_refused() -> None:
    with pytest.raises(InputError, match="library"):
        _terms(PHI, library=object())
    huge = 1e100 * PHI
    with pytest.raises(InputError, match="finite"):
        _terms(huge, library=PolynomialLibrary(5))(huge[:, None])
