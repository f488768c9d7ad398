"""The report on a user's model: all of the diagnosis is in it, escaped, each picture in words."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from made_systems import made_diagnosis
from report_page import without_own_script

from comparisons.missing_effect.systems.report import system_parts, system_report
from comparisons.missing_effect.systems.results import SystemDiagnosis
from comparisons.missing_effect.systems.words import system_words
from comparisons.page import style as plots_style
from comparisons.page.blocks import Bullets, Part, Picture, Table, Words
from surge_core.rounding import log_units

HOSTILE = "<script>alert('x')</script><img src=x onerror=alert(1)>"


class Page(HTMLParser):
    """Tags of a page, and the texts that stand for pictures."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: set[str] = set()
        self.alts: list[str] = []
        self.text: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes |= {name for name, _ in attrs}
        if tag == "img":
            self.alts.append(dict(attrs).get("alt") or "")

    def handle_data(self, data: str) -> None:
        self.text.append(data)


@pytest.fixture(scope="module")
def found() -> SystemDiagnosis:
    return made_diagnosis()


@pytest.fixture(scope="module")
def parts(found: SystemDiagnosis) -> tuple[Part, ...]:
    return system_parts(found)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave pictures out, where a test looks at words alone: drawing takes the longest."""
    monkeypatch.setattr(plots_style, "figure_to_data_uri", lambda _: "data:image/png;base64,")


def part(parts: tuple[Part, ...], start: str) -> Part:
    (one,) = [p for p in parts if p.title.startswith(start)]
    return one


def table(parts: tuple[Part, ...], start: str) -> Table:
    return next(b for b in part(parts, start).blocks if isinstance(b, Table))


def column(shown: Table, head: str) -> list[str]:
    index = [h.text for h in shown.heads].index(head)
    cells = [row[index] for row in shown.rows]
    return [cell if isinstance(cell, str) else cell.text for cell in cells]


def test_names_of_others_are_data_and_no_page() -> None:
    d = made_diagnosis(name=HOSTILE, runs={HOSTILE: "training", f"{HOSTILE} 2": "check"})
    d = replace(d, remarks=(HOSTILE,), unavailable={HOSTILE: HOSTILE})
    html = without_own_script(system_report({HOSTILE: d}, HOSTILE, version=HOSTILE))
    page = Page(html)
    assert "script" not in page.tags
    assert "onerror" not in page.attributes
    assert HOSTILE not in html
    assert HOSTILE in "".join(page.text)


def test_every_picture_is_told_in_words() -> None:
    diagnoses = {"with": made_diagnosis(), "without": made_diagnosis(nothing=True)}
    page = Page(system_report(diagnoses, "sindy-surge diagnose", version="1"))
    assert len(page.alts) == 8
    assert len(set(page.alts)) == 8
    assert all(len(alt) > 30 for alt in page.alts)
    text = "".join(page.text)
    assert "with" in text
    assert "without" in text


@pytest.mark.usefixtures("undrawn")
def test_the_verdict_leads(found: SystemDiagnosis, parts: tuple[Part, ...]) -> None:
    first = parts[0]
    assert first.title == "What is missing: alias set"
    (words,) = [b for b in first.blocks if isinstance(b, Words)]
    assert words.text == system_words(found)
    assert words.tone == "plain"
    doubtful = system_parts(replace(found, verdict="provisional"))[0].blocks[0]
    assert isinstance(doubtful, Words)
    assert doubtful.tone == "caution"


def test_every_candidate_fitted_is_in_the_table_of_its_round(
    found: SystemDiagnosis, parts: tuple[Part, ...]
) -> None:
    tables = [b for b in part(parts, "Who").blocks if isinstance(b, Table)]
    assert len(tables) == len(found.rounds) == 3
    for shown, step in zip(tables, found.rounds, strict=True):
        fitted = [c for c in step.candidates if c.evidence is not None]
        assert column(shown, "candidate") == [c.placed.label(found.model) for c in fitted]
        assert column(shown, "score") == [log_units(c.score) for c in fitted]
    assert column(tables[1], "fate")[:2] == ["added", "cannot be told from the best"]
    assert column(tables[2], "fate")[0] == "best, but too little to add"
    quiet = [b.text for b in part(parts, "Who").blocks if isinstance(b, Words)]
    assert any("transport_delay(U) in U promised most" in text for text in quiet)


def test_what_was_added_has_its_numbers_place_and_confirmation(
    found: SystemDiagnosis, parts: tuple[Part, ...]
) -> None:
    shown = table(parts, "What was added")
    assert [name for name in column(shown, "effect") if name] == list(found.names)
    numbers = [number.name for item in found.missing for number in item.numbers]
    assert column(shown, "number") == numbers
    assert column(shown, "value")[0] == "(12.3 ± 0.4) N/m^3"
    lists = {
        b.heading: b.items for b in part(parts, "What was added").blocks if isinstance(b, Bullets)
    }
    assert len(lists["What would confirm it"]) == 3
    (alias,) = lists["What these records cannot tell apart"]
    assert "coulomb_friction" in alias
    assert "stribeck_friction" in alias


def test_parameters_stand_before_and_after(found: SystemDiagnosis, parts: tuple[Part, ...]) -> None:
    shown = table(parts, "Parameters")
    assert column(shown, "parameter") == list(found.model.param_names)
    m = found.parameter("m")
    assert column(shown, "before")[0] == "0.650 ± 0.010"
    change = (m.after - m.before) / m.before_stderr
    assert column(shown, "change")[0] == f"{change:+.1f}"
    assert column(shown, "note") == ["", "", "", "", "", "at its bound"]


def test_every_record_and_output_has_its_errors(
    found: SystemDiagnosis, parts: tuple[Part, ...]
) -> None:
    shown = table(parts, "Errors")
    assert len(shown.rows) == 4 * 3
    assert column(shown, "split")[::3] == ["training", "training", "check", "check"]
    last = found.checks[-1]
    told = dict(zip(column(shown, "output")[-3:], column(shown, "after")[-3:], strict=True))
    assert told["position"] == f"{1e3 * last.after_rms[0]:.4f} mm"
    ratio = float(column(shown, "times smaller")[-2])
    assert ratio == pytest.approx(last.before_rms[1] / last.after_rms[1], rel=0.005)
    swing = float(np.std(last.measured[last.settle :, 1]))
    share = float(column(shown, "of the swing")[-2].removesuffix(" %"))
    assert share == pytest.approx(100.0 * last.after_rms[1] / swing, rel=0.005)


def test_timing_and_floor_are_told(found: SystemDiagnosis, parts: tuple[Part, ...]) -> None:
    timing = part(parts, "Timing")
    (words,) = [b.text for b in timing.blocks if isinstance(b, Words)]
    assert "straight lines" in words
    shown = table(parts, "Timing")
    assert (column(shown, "offset"), column(shown, "in time")) == (["0.310 ± 0.020"], ["6.20 ms"])
    floor = table(parts, "What no model")
    assert column(floor, "new in each sample")[0] == "30.0 µm"
    errors = np.concatenate([run.measured - run.after for run in found.training])
    share = 100.0 * (np.array(found.floor) ** 2 / np.mean(errors**2, axis=0))
    assert column(floor, "share of the squared error") == [f"{value:.0f} %" for value in share]


def test_where_says_the_largest_residual(found: SystemDiagnosis, parts: tuple[Part, ...]) -> None:
    (told,) = [b for b in part(parts, "Where").blocks if isinstance(b, Bullets)]
    assert told.heading == "On arrow (check)"
    assert len(told.items) == 9
    run = found.checks[-1]
    worst = int(np.argmax(np.abs((run.measured - run.before)[run.settle :, 1]))) + run.settle
    at_s = worst * run.experiment.sample_period_s
    (words,) = [item for item in told.items if item.startswith("current in time")]
    first, last = (float(text) for text in words.split(" from ")[1].split(" s, ")[0].split(" to "))
    assert first <= at_s <= last


@pytest.mark.usefixtures("undrawn")
def test_parts_without_content_are_left_out() -> None:
    bare = replace(
        made_diagnosis(nothing=True), rounds=(), checks=(), floor=(), unavailable={}, offsets=()
    )
    told = system_parts(bare)
    titles = [p.title for p in told]
    assert titles[0] == "What is missing: nothing missing"
    assert not any(title.startswith(("Remarks", "What no model")) for title in titles)
    (words,) = part(told, "What was added").blocks
    assert words == Words("Nothing was added.")


def test_a_model_that_ran_away_is_still_reported() -> None:
    d = made_diagnosis()
    gone = tuple(replace(run, before=np.full_like(run.before, np.nan)) for run in d.checks)
    html = system_report({"x": replace(d, checks=gone)}, "diagnose", version="1")
    assert "nan" not in "".join(Page(html).text).lower().split()


def test_pictures_have_a_title_and_a_reading(parts: tuple[Part, ...]) -> None:
    pictures = [b for p in parts for b in p.blocks if isinstance(b, Picture)]
    assert len(pictures) == 4
    for picture in pictures:
        assert picture.title
        assert len(picture.reading) > 40
        assert picture.uri.startswith("data:image/png;base64,")
