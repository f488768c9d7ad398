from __future__ import annotations

import re

import numpy as np
import pytest

from sindy_surge import FitState, SparseLagRegressor
from sindy_surge.library import StallLibrary

from .conftest import PERIOD_S, TAU_S, lag, relaxation_wave


def _record(knot: float, noise: float, seed: int, n: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    fine = relaxation_wave(8 * n, PERIOD_S / 8, rng)
    psi_p = lag(0.35 + 0.8 * fine - 1.6 * np.maximum(fine - knot, 0), PERIOD_S / 8)[::8]
    phi = fine[::8]
    white = rng.standard_normal((2, n))
    return phi + noise * phi.std() * white[0], psi_p + noise * psi_p.std() * white[1]


@pytest.mark.parametrize("noise", [0.01, 0.05])
@pytest.mark.parametrize("knot", [0.27, 0.13])
def test_kink_between_the_knots_is_one_hinge_where_it_is(knot: float, noise: float) -> None:
    phi, psi_p = _record(knot, noise, 0)
    model = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)
    assert model.fit_state_ is FitState.OK
    assert model.terms_[:2] == ("1", "phi")
    assert len(model.terms_) == 3
    found = re.fullmatch(r"relu\(phi-([\d.]+)\)", model.terms_[2])
    assert found
    assert abs(float(found[1]) - knot) < 0.01
    assert model.terms_[2] in model.candidate_terms_
    caution = next(c for c in model.cautions_ if "kink" in c)
    stderr = float(re.search(r"standard error ([\d.e-]+)", caution)[1])  # type: ignore[index]
    assert abs(float(found[1]) - knot) < 5 * stderr + 1e-9
    assert abs(model.time_constant_s_ - TAU_S) < 4 * model.time_constant_stderr_s_
    assert abs(model.coef_[2] + 1.6) < 5 * np.sqrt(model.covariance_[2, 2])


def test_a_knot_that_was_searched_widens_the_errors() -> None:
    phi, psi_p = _record(0.27, 0.02, 3)
    searched = SparseLagRegressor(n_bootstrap=0).fit(phi[:, None], psi_p)
    library = StallLibrary(5, [[0.1, 0.27, 0.4]], [[]])
    given = SparseLagRegressor(library=library, n_bootstrap=0).fit(phi[:, None], psi_p)
    assert set(given.terms_) == {"1", "phi", "relu(phi-0.27)"}
    assert not any("kink" in c for c in given.cautions_)
    order = [searched.terms_.index(term) for term in given.terms_]
    wide = np.sqrt(np.diag(searched.covariance_))[order]
    assert np.all(wide > 0.9 * np.sqrt(np.diag(given.covariance_)))
    assert wide[1] > 1.1 * np.sqrt(given.covariance_[1, 1])
