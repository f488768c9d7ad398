"""The report: everything in one file, nothing from outside, every text escaped."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from comparison_data import made_comparison, made_series
from raw_data import make_test
from report_page import Page, without_own_script

from classic_ml.records import Dropped, LedgerEntry
from classic_ml.reduction import Reduction, reduce_record
from comparisons.harness.answer import answer_of
from comparisons.harness.reconstruction import reconstruct_record
from comparisons.page.blocks import Part, Words
from comparisons.page.html import render_page
from comparisons.results import Caution, Truth
from comparisons.show.figures import write_figures
from comparisons.show.report import ReportSection, report_pages

EVIL = "<script>alert('x')</script>\"'><img src=http://evil.example/x.png onerror=alert(1)>&amp;$x$"
HEADINGS = ("Evidence", "Diagnosis", "Checks", "Data quality", "Ledger", "Settings")


@pytest.fixture(scope="module", autouse=True)
def _undrawn() -> Iterator[None]:
    """The pictures are drawn in test_pictures.py."""
    with pytest.MonkeyPatch.context() as patch:
        uri = "data:image/png;base64,AA=="
        patch.setattr("comparisons.page.style.figure_to_data_uri", lambda _: uri)
        yield


@pytest.fixture(scope="module")
def reduction() -> Reduction:
    return reduce_record(*make_test(cells_lbm_s=8.0, noise_counts=1.5).load())


@pytest.fixture(scope="module")
def html(reduction: Reduction) -> str:
    comparison = made_comparison(
        cautions=(
            Caution("ledger", "record.csv", "inspect", {"finding": "P25_A: 40 rows clipped"}),
        )
    )
    phi = np.linspace(0.0, 1.0, 50)
    truth = Truth(0.018, phi, 0.3 + 1.2 * phi - 1.5 * phi**2, "truth of the rig")
    section = ReportSection(
        "A test at 98.5 % speed",
        comparison,
        reduction=reduction,
        truth=truth,
        validation=(reconstruct_record(comparison.results[0].model, made_series(5, "other.csv")),),
        extra=(Part("Diagnosis", (Words("nothing is missing"),)),),
    )
    page = render_page(
        report_pages([section]), title="The report", command="sindy-surge compare x.csv"
    )
    return without_own_script(page)


def test_the_answer_is_open_and_every_other_part_folded_in_order(html: str) -> None:
    places = [html.index(f"<details><summary><h3>{heading}</h3>") for heading in HEADINGS]
    assert places == sorted(places)
    opened, *_ = html.split("<details>")
    # Of sindy, which is recommended: not of the least held-out rms, nor of the first key.
    for words in ("18.01 ± 0.22 ms", "17.58 to 18.45", "Believe sparse regression", "φ²"):
        assert words in opened


def test_nothing_comes_from_outside(html: str) -> None:
    page = Page(html)
    assert page.all("script") == page.all("link") == page.all("iframe") == []
    for _, attributes in page.tags:
        for name in ("src", "href", "srcset", "action", "data"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:image/png;base64,", "#"))
        assert not any(name.startswith("on") or name == "style" for name in attributes)
    style = html[html.index("<style>") : html.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style
    assert "http" not in re.sub(r"data:image/png;base64,[^\"]*|http-equiv", "", html)


def test_what_files_and_ledgers_say_is_text() -> None:
    entry = LedgerEntry(EVIL, EVIL, {EVIL: EVIL}, (Dropped(EVIL, 1, EVIL),), (EVIL,))
    comparison = made_comparison(
        made_series(source=EVIL, history=(entry,)),
        cautions=(Caution.of("estimator", remark=EVIL),) * 2,
    )
    run = reconstruct_record(comparison.results[0].model, made_series(5, EVIL))
    phi = np.linspace(0.0, 1.0, 50)
    html = render_page(
        report_pages(
            [ReportSection(EVIL, comparison, truth=Truth(0.018, phi, phi, EVIL), validation=(run,))]
        ),
        title=EVIL,
        command=EVIL,
    )
    page = Page(without_own_script(html))
    assert page.all("script") == []
    assert page.all("b") == []  # no label's markup
    for attributes in page.all("img"):
        assert set(attributes) == {"src", "alt"}
        assert (attributes["src"] or "").startswith("data:image/png;base64,")
    assert page.texts.count(EVIL) > 5  # it is shown, as it stands


def test_the_recommended_estimator_leads_and_is_marked(html: str) -> None:
    row = html.split('<tr class="best">', 1)[1].split("</tr>", 1)[0]
    assert "<small>sindy</small>" in row
    assert "18.01 ± 0.22" in row
    assert "Believe sparse regression" in Page(html).text
    none = dataclasses.replace(made_comparison(), quotable=())
    page = render_page(report_pages([ReportSection("x", none)]), title="x", command="x")
    assert '<tr class="best">' not in page
    assert "none to quote" in Page(page).text


def test_pictures_tables_and_the_curve_can_be_taken_away(tmp_path: Path) -> None:
    comparison = made_comparison()
    pages = report_pages([ReportSection("x", comparison)])
    curve = answer_of(comparison).curve
    assert curve is not None
    n = write_figures(pages, tmp_path, curve)
    assert n == len(list(tmp_path.iterdir()))
    for path in tmp_path.glob("*.svg"):
        assert ElementTree.parse(path).getroot().tag.endswith("svg")
    assert {p.stem for p in tmp_path.glob("*.svg")} == {p.stem for p in tmp_path.glob("*.pdf")}
    (estimators,) = tmp_path.glob("table_01*.csv")
    assert list(pd.read_csv(estimators)["τ [ms]"]) == ["18.01 ± 0.22", "30.1 ± 1.2", "20.00 ± ?"]
    latex = estimators.with_suffix(".tex").read_text("utf-8")
    assert r"\toprule" in latex
    assert r"18.01 $\pm$ 0.22" in latex
    assert r"classic\_ml" in latex
    table = pd.read_csv(tmp_path / "characteristic.csv")
    np.testing.assert_allclose(
        np.polyval(curve.coefficients[::-1], table.phi), table.psi_p, atol=0.02
    )
    assert table.phi.min() >= curve.valid_phi[0]
    assert table.phi.max() <= curve.valid_phi[1]
