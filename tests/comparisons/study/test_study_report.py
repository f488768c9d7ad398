"""The report of a study: numbers in every text alternative, dots at their places."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pandas as pd
import pytest

from comparisons.study.comparison import compare_methods, methods_in
from comparisons.study.plots import draw_differences, draw_over_axis
from comparisons.study.report import render_study_report
from comparisons.study.spec import StudySpec, spec_from


def made_results(methods: tuple[str, ...] = ("classic_ml", "sindy", "paper")) -> pd.DataFrame:
    """Return a study of 12 records in which each method is 0.5 ms worse than the one before."""
    rng = np.random.default_rng(2)
    rows = []
    for k in range(12):
        hard = 5.0 + rng.normal()
        for place, name in enumerate(methods):
            rows.append(
                {
                    "cell": len(rows),
                    "record": f"r-{k}",
                    "reduction": f"d-{k}",
                    "method": name,
                    "seed": k,
                    "record.noise_percent": (0.0, 1.0, 5.0)[k % 3],
                    "record.hide": ("none", "sensitivity_drift")[k % 2],
                    "state": "ok",
                    "reason": "",
                    "tau_error_ms": hard + 0.5 * place + 0.05 * rng.normal(),
                    "seconds_fit": 0.1 * 4.0**place * rng.uniform(0.9, 1.1),
                    "seconds_record": 2.0,
                    "seconds_reduction": 0.5,
                }
            )
    return pd.DataFrame(rows)


def spec(methods: tuple[str, ...] = ("classic_ml", "sindy", "paper")) -> StudySpec:
    given: dict[str, Any] = {
        "title": "noise & drift",
        "scores": ["tau_error_ms"],
        "by": ["record.hide"],
        "record": {"noise_percent": [0.0, 1.0, 5.0], "hide": ["none", "sensitivity_drift"]},
        "method": [{"name": name} for name in methods],
    }
    return spec_from(given)


class Page(HTMLParser):
    """Text and pictures of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.alternatives: list[str] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "img":
            self.alternatives.append(dict(attrs)["alt"] or "")

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.texts).split())


def test_the_report_leads_with_the_answer_and_every_picture_says_its_numbers() -> None:
    table = made_results()
    table.loc[[4, 7, 10], ["state", "reason"]] = ["failed", "singular <matrix>"]
    page = Page(render_study_report(table, spec()))
    best = page.words.index("classic_ml has the smallest |error of τ|")
    # Once in the contents and once above the tables.
    assert best < page.words.rindex("Methods")
    assert "36 cells of 3 methods on 12 records; 3 failed." in page.words
    assert "record.noise_percent 0, 1, 5" in page.words
    # All three failures of one method for one reason are one line.
    assert "sindy failed 3 singular <matrix>" in page.words
    assert "survivors only" in page.words
    assert len(page.alternatives) == 3
    for text in page.alternatives:
        assert all(name in text for name in ("classic_ml", "sindy", "paper"))
        assert len(re.findall(r"\d\.\d", text)) >= 3


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("single", "no other method was run"),
        ("all failed", "no method has a value"),
        ("one record", "one record alone"),
    ],
)
def test_thin_studies_have_a_report_all_the_same(kind: str, expected: str) -> None:
    methods = ("classic_ml",) if kind == "single" else ("classic_ml", "sindy")
    table = made_results(methods)
    if kind == "all failed":
        table[["state", "tau_error_ms"]] = ["failed", np.nan]
    if kind == "one record":
        table = table[table["record"] == "r-0"]
    assert expected in Page(render_study_report(table, spec(methods))).words


def test_dots_stand_at_the_paired_differences() -> None:
    table = made_results()
    groups = compare_methods(table, "tau_error_ms", "classic_ml")
    ax = draw_differences(groups, methods_in(table)).figure.axes[0]
    labels = [tick.get_text() for tick in ax.get_yticklabels()]
    assert labels == ["sindy", "paper"]
    for container, name in zip(ax.containers, labels, strict=True):
        line, _, (bars,) = container.lines  # type: ignore[attr-defined]
        pair = groups[0].row(name).against
        assert line.get_xdata()[0] == pytest.approx(pair.difference)
        (low, _), (high, _) = bars.get_segments()[0]
        assert high - low == pytest.approx(4.0 * pair.stderr)


def test_a_line_over_an_axis_is_no_better_for_failing_on_hard_records() -> None:
    table = made_results(("classic_ml", "sindy"))
    level = table.groupby("record")["tau_error_ms"].transform("mean")
    hard = level > level.groupby(table["record.hide"]).transform("median")
    table.loc[hard & (table["method"] == "sindy"), "state"] = "failed"
    drawn = draw_over_axis(table, "tau_error_ms", "record.hide", "classic_ml")
    means = {str(line.get_label()): line.get_ydata() for line in drawn.figure.axes[0].lines}
    # 0.5 ms worse on every record: so it stays, though its own mean is of easy records alone.
    np.testing.assert_allclose(np.subtract(means["sindy"], means["classic_ml"]), 0.5, atol=0.15)
    own = table[(table["method"] == "sindy") & (table["state"] == "ok")]["tau_error_ms"].mean()
    assert own < np.mean(means["sindy"]) - 0.2


def test_many_values_of_an_axis_are_gathered_in_bins() -> None:
    table = made_results()
    many = pd.concat([table.assign(record=table["record"] + f"/{i}") for i in range(4)])
    many["record.noise_percent"] = many.groupby("record").ngroup() * 0.1
    drawn = draw_over_axis(many, "tau_error_ms", "record.noise_percent")
    lines = {str(line.get_label()): line for line in drawn.figure.axes[0].lines}
    assert len(np.asarray(lines["sindy"].get_xdata())) == 8
