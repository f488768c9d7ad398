from __future__ import annotations

import html
import math
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from sklearn import config_context
from sklearn.base import BaseEstimator, clone
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sindy_surge import FitState
from sindy_surge.display import FittedDisplay, html_summary, text_summary
from sindy_surge.equations import EquationParts
from sindy_surge.selection import PathRow
from sindy_surge.summary import ModelSummary, interval95, summary_fields, summary_tables
from sindy_surge.weak_form import WeakLag

TERMS = ("1", "phi", "phi^2[phi<0]")
PATH = (
    PathRow(1, ("1",), 4.1e6, 4.1e6, math.nan, False, False, False),
    PathRow(2, ("1", "phi"), 900.0, 880.0, math.nan, False, False, False),
    PathRow(2, ("1", "phi^2"), 950.0, 930.0, math.nan, False, False, False),
    PathRow(3, ("1", "phi", "phi^3"), 80.0, 50.0, 0.02, True, False, False),
    PathRow(3, TERMS, 82.0, 52.0, 0.018, True, True, True),
)
SUMMARY = ModelSummary(
    EquationParts(TERMS, (0.35, -1.2, 20.0), (0.004, 0.05, 0.7), 0.018, 0.0003, 0.002, 0.0002),
    FitState.OK,
    n_candidates=18,
    inclusion=(1.0, 0.97, 0.61),
    rivals=(("1", "phi", "phi^3"),),
    aliases=(("|phi| phi", "phi^2"),),
    noise=(0.0005, (0.002,)),
    weak=WeakLag(0.0187, 0.0179, 0.036, 400),
    path=PATH,
    input_ranges=[[-0.04], [0.51]],
)
STATIC = ModelSummary(
    EquationParts(("1",), (0.4,), (math.nan,), math.nan, math.nan), FitState.CONSTANT_SIGNAL
)


class Markup(HTMLParser):
    """Tags and words of a document; an unbalanced tag is an error."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag != "br":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)


@pytest.mark.parametrize("summary", [SUMMARY, STATIC])
def test_text_and_html_tell_the_same(summary: ModelSummary) -> None:
    text = " ".join(text_summary(summary).split())
    words = Markup(html_summary(summary)).words
    fields = summary_fields(summary)
    assert len({field.label for field in fields}) == len(fields)
    lines = [line for field in fields for line in (field.label, *field.lines)]
    for table in summary_tables(summary):
        lines += [table.title, *table.header, *(cell for row in table.rows for cell in row if cell)]
    for line in lines:
        assert " ".join(line.split()) in text
        assert line in words


def test_numbers_are_told_to_their_error_with_units() -> None:
    fields = {field.label: field.lines for field in summary_fields(SUMMARY)}
    assert fields["time constant τ"] == ("0.01800 ± 0.00030 s",)
    assert fields["τ, 95 % interval"] == ("0.01742 to 0.01860 s",)
    assert fields["dead time d"] == ("0.00200 ± 0.00020 s",)
    assert fields["noise of φ (std)"] == ("0.002",)
    assert fields["weak gap (noise)"] == ("4.47 %",)
    assert fields["rivals"][1:] == ("1, φ, φ³",)
    assert fields["aliases"][1:] == ("|φ| φ = φ²",)
    terms = summary_tables(SUMMARY)[0]
    assert terms.title.endswith("3 of 18 candidates")
    assert terms.rows[1] == ("φ", "-1.20", "0.05", "-1.30 to -1.10", "1", "0.97")


def test_a_ledger_is_told_even_when_it_is_empty() -> None:
    empty = {f.label: f.value for f in summary_fields(replace(SUMMARY, rivals=(), aliases=()))}
    assert empty["rivals"] == empty["aliases"] == ("none",)
    unknown = {field.label: field.value for field in summary_fields(STATIC)}
    assert unknown["rivals"] == unknown["aliases"] == ("not looked for",)
    assert unknown["time constant τ"] == ("none: the fit is static",)
    assert FitState.CONSTANT_SIGNAL.advice in unknown["state"][0]


@pytest.mark.parametrize(
    ("term", "unit"),
    [
        ("1", "1"),
        ("psi_p phi^2", "1"),
        ("|phi| phi", "1"),
        ("speed^2", "per speed²"),
        ("relu(speed-3)", "per relu(speed-3)"),
        ("exp(-speed/3)", "1"),
        ("phi^2[speed<3]", "1"),
        ("phi_sp_0", "per phi_sp_0"),
    ],
)
def test_coefficients_of_inputs_with_a_unit_say_so(term: str, unit: str) -> None:
    names = ("phi", "speed")
    parts = EquationParts((term,), (2,), (0.1,), 0.018, 1e-4, input_names=names)
    assert summary_tables(replace(STATIC, parts=parts))[0].rows[0][4] == unit


def test_long_labels_keep_clear_of_their_values() -> None:
    names = ("phi", "speed of the shaft in rpm")
    parts = replace(SUMMARY.parts, input_names=names)
    summary = replace(SUMMARY, parts=parts, input_ranges=None, noise=(0.0005, (0.002, 3.0)))
    lines = text_summary(summary).splitlines()
    assert "  noise of speed of the shaft in rpm (std)  3" in lines
    assert all(len(line) <= 100 for line in lines)


def test_path_shows_the_best_of_each_size_and_the_chosen_one() -> None:
    table = summary_tables(SUMMARY)[1]
    assert [(row[0], row[2]) for row in table.rows] == [
        ("1", "1"),
        ("2", "1, φ"),
        ("3", "1, φ, φ³"),
        ("3", "1, φ, φ²[φ<0]"),
    ]
    assert table.marked == 3
    assert [row[1] for row in table.rows] == ["", "", "", "yes"]
    chosen = [a for tag, a in Markup(html_summary(SUMMARY)).tags if a.get("class") == "chosen"]
    assert len(chosen) == 1


def test_where_cycles_were_left_out_they_rank_the_path() -> None:
    path = (
        replace(PATH[3], chosen=True, held_out_rms=0.021, score=math.nan),
        replace(PATH[4], chosen=False, held_out_rms=0.034),
        PATH[1],
    )
    table = summary_tables(replace(SUMMARY, path=path))[1]
    assert table.header[-1] == "held-out rms"
    assert [row[-1] for row in table.rows] == ["n/a", "0.021"]
    assert table.rows[1][3] == "n/a"
    assert table.marked == 1


def test_html_escapes_every_string_and_runs_nothing() -> None:
    bad = '<script>alert("x")</script>&'
    summary = replace(
        SUMMARY,
        name=bad,
        parts=EquationParts(("1", bad), (1, 2), (0.1, 0.1), 0.018, 1e-4, input_names=(bad,)),
        inclusion=None,
        rivals=((bad,),),
        aliases=((bad, "1"),),
        path=(replace(PATH[0], terms=(bad,)),),
    )
    text = html_summary(summary)
    assert "<script" not in text
    assert html.escape(bad) in text
    assert {tag for tag, _ in Markup(text).tags}.isdisjoint({"script", "link", "img", "a"})
    assert "url(" not in text


def test_html_tables_have_headers_for_rows_and_columns() -> None:
    markup = Markup(html_summary(SUMMARY))
    scopes = [attrs.get("scope") for tag, attrs in markup.tags if tag == "th"]
    tables = summary_tables(SUMMARY)
    assert scopes.count("col") == sum(len(table.header) for table in tables)
    assert scopes.count("row") == len(summary_fields(SUMMARY)) + sum(len(t.rows) for t in tables)
    assert None not in scopes


def test_interval_covers_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    draws = 0.018 * np.exp(0.1 * rng.standard_normal(4000))
    inside = [
        low <= 0.018 <= high for low, high in (interval95(d, 0.1 * d, positive=True) for d in draws)
    ]
    assert abs(np.mean(inside) - 0.95) < 4 * math.sqrt(0.95 * 0.05 / 4000)


def test_interval_of_what_is_positive() -> None:
    low, high = interval95(0.018, 0.003, positive=True)
    assert low * high == pytest.approx(0.018**2)
    assert interval95(0.018, 0.02, positive=True)[0] == 0.0
    assert interval95(2.0, 0.5, quantile=2.0) == (1.0, 3.0)
    assert all(map(math.isnan, interval95(1.0, math.nan)))


class Model(FittedDisplay, BaseEstimator):
    """An estimator with nothing but a display."""

    def __init__(self, degree: int = 2) -> None:
        self.degree = degree

    def fit(self, X: object, y: object = None) -> Model:
        self.fitted_ = True
        return self

    def predict(self, X: object) -> object:
        return X

    def _summary(self) -> ModelSummary | None:
        return SUMMARY if hasattr(self, "fitted_") else None


def test_before_a_fit_scikit_learn_shows_its_diagram() -> None:
    model = Model(degree=3)
    assert str(model) == repr(model) == "Model(degree=3)"
    bundle = model._repr_mimebundle_()
    assert bundle["text/plain"] == "Model(degree=3)"
    assert "sk-container" in bundle["text/html"]
    assert "sk-container" in model._repr_html_()


def test_after_a_fit_the_summary_is_shown() -> None:
    model = Model(degree=3).fit(None)
    assert repr(model) == "Model(degree=3)"
    assert repr(clone(model)) == "Model(degree=3)"
    assert str(model) == text_summary(SUMMARY)
    bundle = model._repr_mimebundle_()
    assert bundle == {"text/plain": text_summary(SUMMARY), "text/html": html_summary(SUMMARY)}
    assert model._repr_html_() == html_summary(SUMMARY)


def test_scikit_learns_display_option_is_kept() -> None:
    for model in (Model(), Model().fit(None)):
        with config_context(display="text"):
            assert list(model._repr_mimebundle_()) == ["text/plain"]
            assert not hasattr(model, "_repr_html_")
        assert hasattr(model, "_repr_html_")


def test_a_pipeline_shows_it_as_a_step() -> None:
    pipeline = make_pipeline(StandardScaler(), Model()).fit(np.arange(6.0).reshape(-1, 1))
    bundle = pipeline._repr_mimebundle_()
    assert "Model()" in bundle["text/plain"]
    assert "sk-container" in bundle["text/html"]
