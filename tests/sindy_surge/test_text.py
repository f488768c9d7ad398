from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from pysindy import PolynomialLibrary
from scipy.integrate import solve_ivp

from sindy_surge import InputError
from sindy_surge.candidate_terms import CandidateTerms
from sindy_surge.free_run import FreeModel
from sindy_surge.text import EquationParts, interval95, pysindy_equations
from surge_core.lag import FirstOrderLag

QUADRATIC = EquationParts(
    ("1", "phi", "phi^2"), (0.35, 1.2, -1.9), (0.004, 0.03, 0.05), 0.018, 0.0002
)
PHI = np.linspace(-0.05, 0.5, 23)


def test_pysindy_strings_are_those_of_the_rate() -> None:
    (text,) = pysindy_equations(QUADRATIC)
    assert text == "-55.556 psi_p + 19.444 1 + 66.667 phi + -105.556 phi^2"
    late = EquationParts(("phi^2",), (0.5,), (0.01,), 0.018, 0.0002, dead_time_s=0.002)
    assert "phi(t-0.002)^2" in pysindy_equations(late)[0]
    static = EquationParts(("1",), (0.3,), (math.nan,), math.nan, math.nan)
    with pytest.raises(InputError, match="static"):
        pysindy_equations(static)


def test_the_function_integrates_to_the_exponential_of_the_lag() -> None:
    terms = CandidateTerms(PolynomialLibrary(2), PHI[:, None], ["phi"])
    lag = FirstOrderLag(QUADRATIC.time_constant_s, 1e-3, "first")
    model = FreeModel(terms, np.arange(3), np.array(QUADRATIC.coef), lag, (0.0, 1.0))
    rate = pickle.loads(pickle.dumps(model.rate))
    rest = 0.35 + 1.2 * 0.2 - 1.9 * 0.04
    found = solve_ivp(lambda t, y: rate(y, 0.2), (0, 0.018), [1.0], rtol=1e-10, atol=1e-12)
    assert found.y[0, -1] == pytest.approx(rest + (1 - rest) * np.exp(-1), rel=1e-8)
    assert isinstance(rate(0.4, 0.2), float)
    assert rate(np.zeros((3, 1)), PHI).shape == (3, PHI.size)


def test_interval_covers_as_often_as_it_says() -> None:
    values = np.random.default_rng(0).normal(0.018, 0.002, 2000)
    low, high = np.array([interval95(value, 0.002) for value in values]).T
    assert 0.93 < np.mean((low <= 0.018) & (high >= 0.018)) < 0.97
    assert interval95(0.001, 0.002)[0] == 0.0
    assert all(map(math.isnan, interval95(1.0, math.nan)))
