"""The loop of a reduced record as text, JSON and a section of a report."""

from __future__ import annotations

import numpy as np
from surge_machines import STEP_S, draw, measured

from classic_ml.series import CoefficientSeries
from comparisons.cli.discover_loop import (
    discover_series_loop,
    loop_document,
    loop_parts,
    loop_text,
)
from comparisons.page.html import render_page
from surge_core.files import to_strict_json


def test_a_series_gives_text_document_and_report() -> None:
    machine, states, _ = draw(0, "two")
    phi, psi_p, plenum = measured(states, 0.01, 3).T
    n = phi.size
    series = CoefficientSeries(np.arange(n) * STEP_S, phi, psi_p, np.ones(n, dtype=np.int64))
    loop = discover_series_loop(series, plenum)
    document = loop_document(loop)
    to_strict_json(document)
    assert document["schema"] == "sindy-surge/discover/1"
    assert [b["name"] for b in document["branches"]] == ["stalled", "unstalled"]
    assert abs(document["levels"]["recover_phi"]["value"] - machine.levels[0]) < 0.005
    assert [t["name"] for t in document["equations"][1]["terms"]] == ["phi", "sqrt(plenum)"]
    assert document["fit_state"]["code"] == loop.state.code
    assert any("[stalled]" in line for line in loop_text(loop))
    page = render_page([("s", loop_parts(loop, "s.csv"))], title="t", command="c")
    assert "Surge loop of s.csv" in page


def test_a_plenum_that_was_not_measured_is_taken_from_the_duct() -> None:
    machine, states, _ = draw(0, "two")
    phi, psi_p, _ = measured(states, 0.005, 3).T
    n = phi.size
    series = CoefficientSeries(np.arange(n) * STEP_S, phi, psi_p, np.ones(n, dtype=np.int64))
    loop = discover_series_loop(series)
    assert loop.plenum_hidden
    assert loop.n_branches == 2
    assert abs(loop.time_constant_s / machine.tau_s - 1) < 0.01
