from __future__ import annotations

import ast
import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pysindy.feature_library import FourierLibrary, PolynomialLibrary
from scipy.integrate import solve_ivp
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, SplineTransformer, StandardScaler

from sindy_surge import InputError
from sindy_surge.candidate_terms import CandidateTerms
from sindy_surge.equations import EquationParts
from sindy_surge.export import RateFunction, SelectedTerms, python_source

TAU_S = 0.018
QUADRATIC = EquationParts(("1", "phi", "phi^2"), (0.35, 1.2, -1.9), (0.1,) * 3, TAU_S, 1e-4)


def run(source: str) -> dict[str, Any]:
    assert source.isascii()
    space: dict[str, Any] = {}
    exec(compile(source, "<exported>", "exec"), space)
    return space


def with_library(
    X: np.ndarray, names: list[str], library: Any = None, seed: int = 0, **times: float
) -> tuple[EquationParts, SelectedTerms]:
    """All candidates of a library under random coefficients."""
    terms = CandidateTerms(library, X, names)
    size = len(terms.names)
    coef = np.random.default_rng(seed).normal(size=size)
    parts = EquationParts(
        terms.names, tuple(coef), (0.1,) * size, TAU_S, 1e-4, input_names=tuple(names), **times
    )
    return parts, SelectedTerms(terms, tuple(range(size)))


def quadratic_terms(psi_p: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    return np.vander(inputs[:, 0], 3, increasing=True)


@pytest.mark.parametrize(
    ("low", "high", "names"),
    [
        ([-0.04], [0.51], ["phi"]),
        ([-0.3], [0.27], ["phi"]),
        ([-40.0], [510.0], ["mass_flow_kg_s"]),
        ([-0.04, 2.0], [0.51, 3.0], ["phi", "speed"]),
        ([0.0, 0.0, -1.0], [1.0, 1.0, 1.0], ["x0", "x1", "x10"]),
    ],
)
def test_source_equals_the_default_library(
    low: list[float], high: list[float], names: list[str]
) -> None:
    rng = np.random.default_rng(1)
    X = rng.uniform(low, high, (300, len(names)))
    parts, evaluate = with_library(X, names)
    fresh = rng.uniform(low, high, (200, len(names)))
    psi_p = rng.uniform(0.1, 0.6, 200)
    # Each kind of term by itself, so that none hides behind another's size.
    for number, column in enumerate(evaluate(psi_p, fresh).T):
        single = EquationParts(
            (parts.terms[number],), (1.0,), (0.1,), TAU_S, 1e-4, input_names=tuple(names)
        )
        space = run(python_source(single))
        scale = np.max(np.abs(column)) + 1e-300
        np.testing.assert_allclose(
            space["characteristic"](*fresh.T) / scale,
            column / scale,
            atol=1e-10,
            err_msg=parts.terms[number],
        )
    space = run(python_source(parts, evaluate, np.stack((low, high))))
    np.testing.assert_allclose(
        space["rate"](psi_p, *fresh.T), RateFunction(parts, evaluate)(psi_p, *fresh.T), rtol=1e-8
    )


@pytest.mark.parametrize(
    "library", [PolynomialLibrary(3), FourierLibrary(2), PolynomialFeatures(3)]
)
def test_source_equals_libraries_of_ones_own(library: Any) -> None:
    phi = np.linspace(-0.04, 0.51, 80)
    parts, evaluate = with_library(phi[:, None], ["phi"], library)
    space = run(python_source(parts, evaluate, [[-0.04], [0.51]]))
    expected = evaluate(phi, phi[:, None]) @ np.array(parts.coef)
    np.testing.assert_allclose(space["characteristic"](phi), expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    ("term", "formula"),
    [
        ("|phi| phi", lambda p: np.abs(p) * p),
        ("phi |phi|", lambda p: np.abs(p) * p),
        ("phi^-1", lambda p: 1 / p),
        ("2 phi^3/4", lambda p: p**3 / 2),
        ("[phi<0.1]", lambda p: 1.0 * (p < 0.1)),
        ("tanh(phi-0.2)^2", lambda p: np.tanh(p - 0.2) ** 2),
        ("exp(-phi/1e-01)", lambda p: np.exp(-p / 0.1)),
        ("phi^2[phi<0] (phi+1)", lambda p: p**2 * (p < 0) * (p + 1)),
    ],
)
def test_formulas_in_names(term: str, formula: Any) -> None:
    phi = np.random.default_rng(2).uniform(-0.3, 0.5, 50)
    parts = EquationParts((term,), (1.5,), (0.1,), TAU_S, 1e-4)
    np.testing.assert_allclose(run(python_source(parts))["characteristic"](phi), 1.5 * formula(phi))


def test_rate_times_and_shapes() -> None:
    parts = replace(QUADRATIC, dead_time_s=0.002)
    space = run(python_source(parts))
    assert space["TIME_CONSTANT_S"] == TAU_S
    assert space["DEAD_TIME_S"] == 0.002
    assert space["rate"](0.4, 0.2) == pytest.approx((0.35 + 0.24 - 0.076 - 0.4) / TAU_S)
    assert space["characteristic"]([0.1, 0.2]).shape == (2,)
    constant = run(python_source(EquationParts(("1",), (0.35,), (0.1,), TAU_S, 1e-4)))
    np.testing.assert_array_equal(constant["characteristic"](np.zeros(3)), np.full(3, 0.35))


def test_a_static_fit_has_a_characteristic_and_no_rate() -> None:
    space = run(python_source(replace(QUADRATIC, time_constant_s=math.nan)))
    assert math.isnan(space["TIME_CONSTANT_S"])
    assert "rate" not in space
    assert space["characteristic"](0.0) == 0.35
    with pytest.raises(InputError, match="static"):
        RateFunction(replace(QUADRATIC, time_constant_s=math.nan), quadratic_terms)


def test_terms_in_psi_p_act_in_the_rate_and_at_rest() -> None:
    parts = EquationParts(
        ("1", "phi", "psi_p^2", "psi_p phi"), (0.35, 0.8, 0.3, -0.5), (0.1,) * 4, TAU_S, 1e-4
    )
    space = run(python_source(parts))
    rng = np.random.default_rng(3)
    psi_p, phi = rng.uniform(0, 0.6, (2, 100))
    right = 0.35 + 0.8 * phi + 0.3 * psi_p**2 - 0.5 * psi_p * phi
    np.testing.assert_allclose(space["rate"](psi_p, phi), (right - psi_p) / TAU_S)
    rest = space["characteristic"](phi)
    # 0.3 ψ'² − (1 + φ/2) ψ' + 0.35 + 0.8 φ = 0, on the branch that starts from ψ'_QS.
    slope = 1 + 0.5 * phi
    expected = (slope - np.sqrt(slope**2 - 1.2 * (0.35 + 0.8 * phi))) / 0.6
    np.testing.assert_allclose(rest, expected, rtol=1e-9)
    assert np.isnan(run(python_source(replace(parts, coef=(9, 0, 9, 0))))["characteristic"](0.1))


def test_the_rate_of_a_state_dependent_model_is_its_librarys() -> None:
    parts = EquationParts(("psi_p^2", "phi"), (0.3, 0.8), (0.1,) * 2, TAU_S, 1e-4)
    rate = RateFunction(parts, lambda psi_p, inputs: np.column_stack((psi_p**2, inputs[:, 0])))
    source = python_source(parts, rate.evaluate, [[0.0], [0.5]])
    psi_p, phi = np.random.default_rng(4).uniform(0, 0.6, (2, 30))
    np.testing.assert_allclose(rate(psi_p, phi), run(source)["rate"](psi_p, phi))


def test_odd_column_names_are_renamed() -> None:
    names = ["flow coefficient", "class", "φ", "x'\nimport os #", "np", "x0", "phi-2"]
    X = np.random.default_rng(5).uniform(0, 1, (50, len(names)))
    parts, evaluate = with_library(X, names, PolynomialLibrary(2))
    source = python_source(parts, evaluate, np.stack((X.min(0), X.max(0))))
    space = run(source)
    expected = evaluate(X[:, 0], X) @ np.array(parts.coef)
    np.testing.assert_allclose(space["characteristic"](*X.T), expected)
    imports = [
        n for n in ast.walk(ast.parse(source)) if isinstance(n, (ast.Import, ast.ImportFrom))
    ]
    assert len(imports) == 1
    assert "# The column 'flow coefficient' is called x0_ here." in source
    assert "The column 'x0'" not in source


@pytest.mark.parametrize(
    "term",
    [
        "f0(phi)",
        "phi_sp_0",
        "",
        "phi^",
        "sin()",
        "0<phi<1",
        "(phi",
        "|phi",
        "os.system",
        "phi=1",
        "s0",
    ],
)
def test_a_name_that_is_no_formula_is_refused(term: str) -> None:
    parts = EquationParts(("1", term), (1.0, 2.0), (0.1, 0.1), TAU_S, 1e-4)
    with pytest.raises(InputError, match="the estimator's own `characteristic`"):
        python_source(parts)


def test_a_name_that_is_not_what_the_library_computes_is_refused() -> None:
    phi = np.linspace(-0.04, 0.51, 80)
    scaled = make_pipeline(StandardScaler(), PolynomialFeatures(2))
    parts, evaluate = with_library(phi[:, None], ["phi"], scaled)
    assert parts.terms == ("1", "phi", "phi^2")
    with pytest.raises(InputError, match="what its name says"):
        python_source(parts, evaluate, [[-0.04], [0.51]])
    parts, evaluate = with_library(phi[:, None], ["phi"], SplineTransformer(4))
    with pytest.raises(InputError, match="cannot be written"):
        python_source(parts, evaluate, [[-0.04], [0.51]])


def test_an_input_called_as_the_state_is_refused() -> None:
    parts = EquationParts(("psi_p",), (1.0,), (0.1,), TAU_S, 1e-4, input_names=("psi_p",))
    with pytest.raises(InputError, match="different names"):
        python_source(parts)


def test_the_function_integrates_to_the_exponential_of_the_lag() -> None:
    rate = pickle.loads(pickle.dumps(RateFunction(QUADRATIC, quadratic_terms)))
    t = np.linspace(0, 5 * TAU_S, 30)
    run_ = solve_ivp(
        lambda t, psi_p: rate(psi_p, 0.2), (0, t[-1]), [0.1], t_eval=t, rtol=1e-9, atol=1e-11
    )
    rest = 0.35 + 1.2 * 0.2 - 1.9 * 0.04
    np.testing.assert_allclose(run_.y[0], rest + (0.1 - rest) * np.exp(-t / TAU_S), atol=1e-7)


def test_the_function_takes_scalars_and_arrays() -> None:
    rate = RateFunction(QUADRATIC, quadratic_terms)
    assert isinstance(rate(0.4, 0.2), float)
    assert rate(0.4, np.zeros((2, 3))).shape == (2, 3)
    assert rate(np.zeros(0), 0.2).shape == (0,)
    np.testing.assert_allclose(rate([0.1, 0.2], 0.0), [0.25 / TAU_S, 0.15 / TAU_S])
    with pytest.raises(InputError, match="one argument for each of phi"):
        rate(0.4)
