"""What a terminal and a notebook show of fits, records, series and reductions."""

from __future__ import annotations

import html
import re

import numpy as np
import pytest
from lag_data import BETA, PERIOD_S, flow, lagged
from report_page import Page

from classic_ml import LagRegressor
from surge_core.display import Field, Grid, Sheet

EVIL = "<script>alert('x')</script>\"><img src=x onerror=alert(1)></style>&amp;"
SHEET = Sheet(
    "Something",
    (Field("state", "well: as it should be", "good"), Field("names", ("a", "b"))),
    (
        Grid("Numbers", ("name", "value"), (("first", "1.2 ± 0.3"), ("second", "10")), marked=1),
        Grid("Ledger", ("step", "did"), (("read", "4001 rows"),), frozenset({0, 1}), folded=True),
    ),
)


def fitted(seed: int = 0) -> LagRegressor:
    rng = np.random.default_rng(seed)
    phi = flow(1500, rng)
    psi_p = lagged(phi, "zero") + 0.003 * rng.standard_normal(phi.size)
    return LagRegressor(PERIOD_S, noise="output-error").fit(phi[:, None], psi_p)


@pytest.fixture(scope="module")
def model() -> LagRegressor:
    return fitted()


def test_text_and_html_tell_the_same() -> None:
    words = Page(SHEET.html()).texts
    told = [SHEET.title, *(line for f in SHEET.fields for line in (f.label, *f.lines))]
    told += [cell for row in SHEET.grids[0].rows for cell in row]
    for line in told:
        assert line in words
        assert line in SHEET.text()
    # A folded table is a line in a terminal and opens in a notebook.
    assert "4001 rows" not in SHEET.text()
    assert "4001 rows" in words
    assert SHEET.html().count("<details>") == 1
    assert SHEET.html().count('class="chosen"') == 1


def test_every_string_is_escaped_and_every_head_has_a_scope() -> None:
    sheet = Sheet(
        EVIL,
        (Field(EVIL, EVIL, "advice"), Field("b", (EVIL, EVIL))),
        (
            Grid(EVIL, (EVIL, EVIL), ((EVIL, EVIL),)),
            Grid(EVIL, (EVIL,), ((EVIL,),), folded=True),
        ),
    )
    text = sheet.html()
    markup = Page(text)
    assert {tag for tag, _ in markup.tags}.isdisjoint({"script", "img", "a", "link"})
    assert text.count("<style>") == text.count("</style>") == 1
    assert html.escape(EVIL) in text
    assert markup.texts.count(EVIL) == 13
    assert all(attrs.get("scope") in ("row", "col") for tag, attrs in markup.tags if tag == "th")
    assert not any(name.startswith("on") for _, attrs in markup.tags for name in attrs)
    assert "url(" not in text


def test_a_fit_shows_its_lag_and_terms_to_their_errors(model: LagRegressor) -> None:
    shown = model._repr_html_()
    words = Page(shown).texts
    value, error = re.search(r"([\d.]+) ± ([\d.]+) ms", shown).groups()  # type: ignore[union-attr]
    assert float(value) == pytest.approx(1e3 * model.time_constant_s_, abs=float(error))
    assert float(error) == pytest.approx(1e3 * model.time_constant_stderr_s_, rel=0.1)
    # As many decimals for the value as for its error.
    assert len(value.partition(".")[2]) == len(error.partition(".")[2])
    assert abs(float(value) - 18.0) < 4.0 * float(error)
    for name, beta, stderr in zip(
        model.terms_, BETA, np.sqrt(np.diag(model.covariance_)), strict=True
    ):
        told = words[words.index(name) + 1]
        number, _, spread = told.partition(" ± ")
        assert abs(float(number) - beta) < 4.5 * stderr
        assert float(spread) == pytest.approx(stderr, rel=0.1)
    assert "converged" in shown
    tau = rf"{value}\({error.removeprefix('0.')}\) ms · dy/dt \+ y = 0\.30"
    assert re.search(tau, str(model))
    assert str(model) == model._repr_mimebundle_()["text/plain"]
    assert model._repr_mimebundle_()["text/html"] == shown
