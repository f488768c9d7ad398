from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sindy_surge import InputError, SparseLagRegressor
from sindy_surge.candidate_terms import PhysicalForm
from sindy_surge.constraints import binding_constraints, constraints_of
from sindy_surge.linear_problem import LinearProblem
from sindy_surge.search import beam_search, proposals

NAMES = ("1", "phi", "phi^2", "phi^3")


def _fit(record: Any, **options: Any) -> SparseLagRegressor:
    model = SparseLagRegressor(psi_terms=False, n_bootstrap=0, **options)
    return model.fit(record.phi[:, None], record.psi_p)


def test_required_forbidden_and_signed_terms(surge: Callable[..., Any]) -> None:
    record = surge("quadratic", 0.02, 1)
    free = _fit(record)
    assert set(free.terms_) == {"1", "phi", "phi^2"}
    asked = _fit(record, constraints={"phi^3": "required"})
    assert set(asked.terms_) == {"1", "phi", "phi^2", "phi^3"}
    number = asked.terms_.index("phi^3")
    # A term that does not belong comes out as zero within its error.
    assert abs(asked.coef_[number]) < 4 * np.sqrt(asked.covariance_[number, number])
    barred = _fit(record, constraints={"phi^2": "forbidden"})
    assert "phi^2" not in barred.terms_
    assert all("phi^2" not in row.terms for row in barred.path_)
    signed = _fit(record, constraints={"phi^2": "positive", "1": "required positive"})
    assert "1" in signed.terms_
    where = [c for t, c in zip(signed.terms_, signed.coef_, strict=True) if t == "phi^2"]
    assert all(c >= 0 for c in where)
    right = _fit(record, constraints={"phi^2": "negative", "phi": "positive"})
    assert right.terms_ == free.terms_
    np.testing.assert_array_equal(right.coef_, free.coef_)
    # What the data agree with does not bind; what they do not is said, with its size.
    assert right.binding_ == asked.binding_ == ()
    for model, word in ((signed, "positive"), (barred, "forbidden")):
        (binding,) = model.binding_
        assert (binding.term, binding.constraint) == ("phi^2", word)
        assert binding.coefficient == pytest.approx(free.coef_[free.terms_.index("phi^2")])
        assert binding.coefficient < -10.0 * binding.stderr
        assert binding.text in model.cautions_
        assert binding.text in " ".join(str(model.summary().sheet().text()).split())


def test_a_constraint_binds_beyond_its_standard_error_alone() -> None:
    """At the limit: one-sided for a sign, two-sided for a term that is forbidden."""
    words = {"positive": (-1.7, -1.6), "negative": (1.7, 1.6), "forbidden": (-2.0, 1.9)}
    for word, (beyond, within) in words.items():
        for value, n in ((beyond, 1), (within, 0), (-within, 0)):
            form = PhysicalForm(("1", "phi"), np.array([5.0, value]), 0.018, np.eye(3))
            assert len(binding_constraints(form, {"phi": f"required {word}"})) == n


def test_positions_follow_the_usable_terms() -> None:
    columns, known = constraints_of(
        {"phi": "forbidden", "phi^3": "required negative"}, NAMES, np.array([0, 1, 3])
    )
    assert columns.tolist() == [0, 3]
    assert known.required == (1,)
    assert known.signs.tolist() == [0.0, -1.0]
    assert known.allow((0, 1), np.array([5.0, -1.0]))
    assert not known.allow((1,), np.array([0.5]))


@pytest.mark.parametrize(
    ("wishes", "where"),
    [
        ({"phi^9": "required"}, "phi\\^9"),
        ({"phi": "wanted"}, "wanted"),
        ({"phi": "required forbidden"}, "forbidden"),
        ({"phi^2": "required"}, "separable"),
    ],
)
def test_wishes_that_cannot_be_met_are_named(wishes: Any, where: str) -> None:
    with pytest.raises(InputError, match=where):
        constraints_of(wishes, NAMES, np.array([0, 1, 3]))


def _problem(seed: int = 0) -> LinearProblem:
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((30, 8)) + rng.standard_normal((30, 1))
    columns /= np.linalg.norm(columns, axis=0)
    target = columns @ np.array([0, 3.0, 0, 0, -2.0, 0, 0, 1.5])
    return LinearProblem(columns, target + 0.1 * rng.standard_normal(30), np.ones(8), 2.0, 500)


def test_search_with_required_terms_is_that_of_all_supports_that_hold_them() -> None:
    problem = _problem()
    every = beam_search(problem, 4, width=1000)
    held = beam_search(problem, 4, width=1000, required=(2, 5))
    assert min(held) == 2
    for size, ranked in held.items():
        wanted = [(c, s) for c, s in every[size] if {2, 5} <= set(s)]
        assert [s for _, s in ranked[:5]] == [s for _, s in wanted[:5]]
        np.testing.assert_allclose([c for c, _ in ranked[:5]], [c for c, _ in wanted[:5]])
    for support in proposals(problem, "SSR", 5, (2, 5)):
        assert {2, 5} <= set(support)
        assert problem.chi2(support) >= 2.0
