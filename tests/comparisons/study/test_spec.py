"""Declarations of studies: what they say is what is run, and every mistake is named."""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from comparisons.study.design import CELLS_A_TASK, count_cells, points_of, tasks_of
from comparisons.study.spec import Range, StudySpec, read_spec, spec_from
from surge_core.errors import InputError

EXAMPLE = Path(__file__).parents[3] / "examples" / "study.toml"


def spec(**given: Any) -> StudySpec:
    """A study of coefficient records with changes."""
    return spec_from({"record": {"duration_s": 5.0}, **given})


def test_the_example_is_about_sixty_cells() -> None:
    assert 50 <= count_cells(read_spec(EXAMPLE)) <= 80


def test_a_grid_has_every_combination_once() -> None:
    made = spec(
        record={"noise_percent": [1.0, 2.0, 5.0], "hide": ["none", "sensitivity_drift"]},
        series={"keep_every": [1, 2]},
        seeds=2,
    )
    points = list(points_of(made))
    assert len(points) == 3 * 2 * 2 * 2
    assert len({(point.settings, point.seed) for point in points}) == len(points)
    assert [point.number for point in points] == list(range(len(points)))
    assert made.axes == ("record.noise_percent", "record.hide", "series.keep_every")
    assert {dict(p.settings)["record.hide"] for p in points} == {None, "sensitivity_drift"}


def test_points_that_share_a_record_share_its_key_and_no_others_do() -> None:
    made = spec(
        record={"noise_percent": [1.0, 2.0]},
        series={"keep_every": [1, 2]},
        fit={"degree": [2, 3]},
        seeds=3,
    )
    points = list(points_of(made))
    keys = {p.record for p in points}
    assert len(keys) == 2 * 3
    for key in keys:
        same = [p for p in points if p.record == key]
        assert len({(p.seed, tuple(p.table("record").items())) for p in same}) == 1
        assert len(same) == 4
        assert len({p.reduction for p in same}) == 2


def test_tasks_cover_what_is_not_finished_and_keep_records_together() -> None:
    made = spec(
        record={"noise_percent": [1.0, 2.0]}, series={"keep_every": list(range(1, 20))}, seeds=3
    )
    total = count_cells(made)
    finished = frozenset(range(0, total, 3))
    tasks = list(tasks_of(made, finished))
    cells = [number for task in tasks for number, _, _ in task.cells]
    assert sorted(cells) == sorted(set(range(total)) - finished)
    for task in tasks:
        assert len({point.record for _, point, _ in task.cells}) == 1
        assert len(task.cells) <= CELLS_A_TASK
    # As few tasks as records and the size of a task allow.
    left = Counter(
        point.record
        for point in points_of(made)
        for m in (0, 1)
        if point.number * 2 + m not in finished
    )
    assert len(left) == 6
    assert len(tasks) == sum(-(-count // CELLS_A_TASK) for count in left.values())


def test_one_record_keeps_several_workers_busy_and_many_are_made_once() -> None:
    one = spec(fit={"degree": list(range(1, 11))}, seeds=1)
    assert len(list(tasks_of(one, workers=4))) >= 4
    many = spec(fit={"degree": [1, 2, 3]}, seeds=20)
    assert len(list(tasks_of(many, workers=4))) == 20


def test_a_random_design_draws_the_same_points_for_its_seed_alone() -> None:
    def drawn(seed: int) -> list[Any]:
        made = spec(
            design={"random": 200, "seed": seed},
            record={"noise_percent": {"from": 0.1, "to": 10.0, "log": True}, "degree": [2, 3]},
        )
        return [point.settings for point in points_of(made)]

    one = drawn(1)
    assert one == drawn(1)
    assert one != drawn(2)
    noise = sorted(dict(settings)["record.noise_percent"] for settings in one)
    assert 0.1 <= noise[0] < 0.2
    assert 5.0 < noise[-1] <= 10.0
    # Evenly on the logarithm: the median of 200 lies within three standard errors of 1.
    assert 0.1**0.32 < noise[100] < 10.0**0.32
    assert {dict(settings)["record.degree"] for settings in one} == {2, 3}


def test_a_range_in_a_grid_is_laid_in_steps() -> None:
    made = spec(record={"noise_percent": {"from": 1.0, "to": 100.0, "log": True, "steps": 3}})
    assert isinstance(made.settings["record.noise_percent"], Range)
    values = [dict(p.settings)["record.noise_percent"] for p in points_of(made)]
    assert values == pytest.approx([1.0, 10.0, 100.0])


def test_points_drawn_twice_are_one_and_records_lie_together() -> None:
    made = spec(
        design={"random": 60, "seed": 3},
        record={"noise_percent": [1.0, 2.0, 3.0]},
        fit={"degree": [1, 2, 3, 4]},
    )
    points = list(points_of(made))
    assert len({point.settings for point in points}) == len(points) == 12
    records = [point.record for point in points]
    assert len([k for k, _ in itertools.groupby(records)]) == len(set(records)) == 3
    assert {point.draw for point in points} == {"s-0"}


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "unknown key": ({"seed": 3}, "the key 'seed'"),
    "unknown schema": ({"schema": "other/2"}, "other/2"),
    "unknown source": ({"record": {"source": "bench"}}, "bench"),
    "unknown setting": ({"record": {"noise_pct": 1.0}}, "noise_pct"),
    "setting of another source": ({"record": {"case": "985"}}, "case"),
    "text for a number": ({"record": {"noise_percent": "high"}}, "high"),
    "bool for a number": ({"record": {"noise_percent": True}}, "True"),
    "infinite": ({"record": {"noise_percent": float("inf")}}, "inf"),
    "fraction for a count": ({"record": {"n_records": 1.5}}, "1.5"),
    "empty axis": ({"record": {"noise_percent": []}}, "an empty list"),
    "value twice": ({"record": {"noise_percent": [1.0, 1]}}, "[1.0, 1]"),
    "range in a grid": ({"record": {"noise_percent": {"from": 1.0, "to": 2.0}}}, "steps"),
    "range upside down": (
        {"record": {"noise_percent": {"from": 2.0, "to": 1.0, "steps": 2}}},
        "'from' below 'to'",
    ),
    "log of zero": (
        {"record": {"noise_percent": {"from": 0.0, "to": 1.0, "log": True, "steps": 2}}},
        "above 0",
    ),
    "range of texts": ({"record": {"hide": {"from": 1, "to": 2, "steps": 2}}}, "numbers alone"),
    "reduction of coefficients": ({"reduction": {"cutoff_hz": 20.0}}, "no counts to reduce"),
    "no seeds": ({"seeds": 0}, "from 1 on"),
    "seed twice": ({"seeds": [1, 1]}, "each once"),
    "negative seed": ({"seeds": [-1]}, "-1"),
    "first seed beside a list": ({"seeds": [1], "first_seed": 2}, "a list of seeds"),
    "unknown score": ({"scores": ["beauty"]}, "beauty"),
    "unknown reference": ({"reference": "nobody"}, "nobody"),
    "unknown axis": ({"by": ["record.noise_percent"]}, "of which there are none"),
    "unknown design": ({"design": "latin"}, "latin"),
    "random without points": ({"design": {"seed": 1}}, "random"),
    "unknown method": ({"method": [{"name": "magic"}]}, "magic"),
    "method without a name": ({"method": [{"class": "a:B"}]}, "None"),
    "method twice": ({"method": [{"name": "sindy"}, {"name": "sindy"}]}, "sindy"),
    "built-in with parameters": (
        {"method": [{"name": "sindy", "parameters": {"a": 1}}]},
        "with parameters",
    ),
    "path without a class": ({"method": [{"name": "m", "class": "package.module"}]}, "module"),
    "path with code": ({"method": [{"name": "m", "class": "os:system('x')"}]}, "os:system"),
    "table for a list": ({"method": {"name": "sindy"}}, "[[method]]"),
    "negative noise": ({"record": {"noise_percent": -1.0}}, "-1.0"),
    "no length": ({"record": {"duration_s": 0}}, "above 0"),
    "keep none": ({"series": {"keep_every": 0}}, "from 1 on"),
    "unknown effect": ({"record": {"hide": "gremlins"}}, "gremlins"),
    "unknown case": ({"record": {"source": "rig", "case": "50"}}, "'50'"),
    "unknown hold": ({"fit": {"hold": "second"}}, "zero, first"),
    "list of sources": ({"record": {"source": ["rig", "files"]}}, "['rig', 'files']"),
    "no scores": ({"scores": []}, "found none"),
    "far too many seeds": ({"seeds": 10**11}, "100000000000"),
    "a seed beyond 64 bits": ({"seeds": [2**70]}, "below"),
    "title of two lines": ({"title": "one\ntwo"}, "one line"),
    "files have no seeds": ({"record": {"source": "files", "path": "a"}, "seeds": 2}, "files"),
    "nothing": ({}, "an empty file"),
    "files without a path": ({"record": {"source": "files"}}, "nothing"),
    "too many": ({"record": {"degree": [2, 3]}, "seeds": 10**6}, "1000000"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_mistake_is_named_before_anything_is_computed(case: str) -> None:
    given, told = BAD[case]
    with pytest.raises(InputError, match="expected") as caught:
        spec_from(given)
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("content", "told"),
    [(b"title = ", "a TOML file"), (b"\xff\xfe\x00", "UTF-8"), (None, "no such file")],
)
def test_a_file_that_is_no_declaration_is_named(
    tmp_path: Path, content: bytes | None, told: str
) -> None:
    path = tmp_path / "study.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=told):
        read_spec(path)
    with pytest.raises(InputError, match="a folder"):
        read_spec(tmp_path)
