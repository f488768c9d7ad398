"""What a terminal and a notebook show of fits, records, series and reductions."""

from __future__ import annotations

import re

import numpy as np
import pytest
from lag_data import BETA, PERIOD_S, flow, lagged
from report_page import Page

from classic_ml import LagRegressor


def fitted(seed: int = 0) -> LagRegressor:
    rng = np.random.default_rng(seed)
    phi = flow(1500, rng)
    psi_p = lagged(phi, "zero") + 0.003 * rng.standard_normal(phi.size)
    return LagRegressor(PERIOD_S, noise="output-error").fit(phi[:, None], psi_p)


@pytest.fixture(scope="module")
def model() -> LagRegressor:
    return fitted()


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
    tau = rf"{value}\({error.removeprefix('0.')}\) ms · dy/dt \+ y = 0\.30"
    assert re.search(tau, str(model))
    assert str(model) == model._repr_mimebundle_()["text/plain"]
    assert model._repr_mimebundle_()["text/html"] == shown
