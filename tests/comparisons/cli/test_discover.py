"""`sindy-surge discover` through the command line."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from commands import refused
from surge_machines import STEP_S, draw, measured

from classic_ml.series import CoefficientSeries
from comparisons.cli import main
from comparisons.cli.discover import discover_series_loop
from comparisons.page.html import render_page
from comparisons.show.discover_output import loop_document, loop_lines, loop_parts
from sindy_surge import discover_loop
from surge_core.files import to_strict_json

PERIOD_S = 0.05


@pytest.fixture
def files(tmp_path):
    """Two swings of a damped oscillator, x'' = -x - 0.2 x', beside a constant temperature."""
    rng = np.random.default_rng(8)
    times = np.arange(600) * PERIOD_S
    rate = -0.1 + 1j * np.sqrt(1 - 0.01)
    paths = []
    for number, start in enumerate((2.0, 1.0 - 1.5j)):
        x, v = (start * np.exp(rate * times)).real, (start * rate * np.exp(rate * times)).real
        table = pd.DataFrame({"time_s": times, "x": x, "v": v})
        table[["x", "v"]] += 0.02 * rng.standard_normal((600, 2))
        table["T [K]"] = rng.normal(288.15, 0.05, 600)
        paths.append(tmp_path / f"swing{number}.csv")
        table.to_csv(paths[-1], index=False)
    return paths


def test_equations_reach_json_and_page(files, tmp_path, capsys):
    out, page = tmp_path / "d.json", tmp_path / "d.html"
    given = [*map(str, files), "--states", "x,v,T [K]", "--json", str(out), "--report", str(page)]
    assert main(["discover", *given, "--library", "poly1 + sin(x)+sqrt(v)+cos( x)+abs(T [K])"]) == 0
    document = json.loads(out.read_text())
    assert document["schema"] == "sindy-surge/discover/1"
    found = {
        e["state"]: {t["name"]: t["coefficient"] for t in e["terms"]} for e in document["equations"]
    }
    assert found["x"] == {"v": pytest.approx(1.0, abs=0.01)}
    assert found["v"] == {"x": pytest.approx(-1.0, abs=0.01), "v": pytest.approx(-0.2, abs=0.01)}
    assert all(t["stderr"] > 0 for e in document["equations"] for t in e["terms"])
    assert document["fit_state"]["code"] == "ok"
    text = capsys.readouterr().out
    assert "dv/dt = " in text
    assert "\ndT [K]/dt = 0\nidle: T [K] (" in text
    assert (document["idle"], found["T [K]"]) == (["T [K]"], {})
    assert "data:image" in page.read_text()


def test_one_state_alone_is_not_called_ok_and_no_equation_is_stated(files, tmp_path, capsys):
    out = tmp_path / "d.json"
    assert main(["discover", str(files[0]), "--states", "x", "--json", str(out)]) == 0
    text = capsys.readouterr().out
    assert text.startswith(("unexplained: ", "no_equations: "))
    assert "dx/dt" not in text
    document = json.loads(out.read_text())
    assert document["equations"] == document["rivals"] == []


@pytest.mark.parametrize(
    ("options", "spoil", "named"),
    [
        (["--states", "x,w"], None, "w"),
        (["--states", "x,x"], None, "--states"),
        (["--states", "x,v", "--library", "sqrt(p)"], None, "the columns of the fit are x, v"),
        (["--states", "x,v", "--hidden", "h"], None, "hidden"),
        (["--states", "x,v", "--known", "q: x=1"], None, "known"),
        (["--states", "x,v", "--known", "nonsense"], None, "--known"),
        (["--states", "x,v"], ("x", 3, "n/a"), "row 4; cut the record there and give the parts"),
        (["--states", "x,v"], ("time_s", 1, 0.0), "leave one of the two rows out"),
        (["--states", "x,v"], ("time_s", 7, 0.0), "time_s"),
        (["--states", "x,v"], ("x", 3, 99.0), "swing0.csv: expected readings that follow one"),
        (["--states", "x,time_s"], None, "the clock"),
        ([], None, "are x, v"),
    ],
)
def test_a_mistake_is_one_sentence(files, capsys, options, spoil, named):
    if spoil:
        table = pd.read_csv(files[0], dtype=object)
        table.loc[spoil[1], spoil[0]] = spoil[2]
        table.to_csv(files[0], index=False)
    assert named in refused(capsys, "discover", files[0], *options)


def test_a_loop_gives_text_document_and_report() -> None:
    machine, states, _ = draw(0, "two")
    loop = discover_loop(*measured(states, 0.01, 3).T, STEP_S)
    document = loop_document(loop)
    to_strict_json(document)
    assert document["schema"] == "sindy-surge/discover/1"
    assert [b["name"] for b in document["branches"]] == ["stalled", "unstalled"]
    assert abs(document["levels"]["recover_phi"]["value"] - machine.levels[0]) < 0.005
    assert [t["name"] for t in document["equations"][1]["terms"]] == ["phi", "sqrt(plenum)"]
    assert document["fit_state"]["code"] == loop.state.code
    assert any("[stalled]" in line for line in loop_lines(loop))
    page = render_page([("s", loop_parts(loop, "s.csv"))], title="t", command="c")
    assert "Surge loop of s.csv" in page


def test_a_plenum_that_was_not_measured_is_taken_from_the_duct() -> None:
    machine, states, _ = draw(0, "two")
    phi, psi_p, _ = measured(states, 0.005, 3).T
    n = phi.size
    series = CoefficientSeries(np.arange(n) * STEP_S, phi, psi_p, np.ones(n, dtype=np.int64))
    loop = discover_series_loop(series)
    assert (loop.plenum_hidden, loop.duct.terms) == (True, ("psi_p", "plenum"))
    assert loop.n_branches == 2
    assert abs(loop.time_constant_s / machine.tau_s - 1) < 0.01
