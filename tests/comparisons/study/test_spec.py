"""Declarations of studies: what they say is what is run, and every mistake is named."""

from __future__ import annotations

from typing import Any

import pytest

from comparisons.study.design import CELLS_A_TASK, cells_of, points_of, tasks_of
from comparisons.study.spec import StudySpec, spec_from
from surge_core.errors import InputError


def spec(**given: Any) -> StudySpec:
    """A study of coefficient records with changes."""
    return spec_from({"record": {"duration_s": 5.0}, **given})


def test_a_grid_has_every_combination_once() -> None:
    made = spec(
        record={"noise_percent": [1.0, 2.0, 5.0], "hide": ["none", "sensitivity_drift"]},
        fit={"degree": [1, 2]},
        seeds=[7, 8],
    )
    points = list(points_of(made))
    assert len({(point.settings, point.seed) for point in points}) == len(points) == 3 * 2 * 2 * 2
    assert set(made.axes) == {"record.noise_percent", "record.hide", "fit.degree"}
    assert {dict(p.settings)["record.hide"] for p in points} == {None, "sensitivity_drift"}
    assert {point.seed for point in points} == {7, 8}


def test_points_that_share_a_record_share_its_key_and_no_others_do() -> None:
    made = spec(
        record={"source": "rig", "noise_percent": [1.0, 2.0]},
        reduction={"cutoff_hz": [30.0, 48.0]},
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


def test_tasks_hold_every_cell_once_and_keep_records_together() -> None:
    made = spec(record={"noise_percent": [1.0, 2.0]}, fit={"degree": list(range(1, 20))}, seeds=3)
    cells = cells_of(made)
    tasks = tasks_of(cells)
    assert [c.number for task in tasks for c in task] == list(range(len(cells)))
    assert all(len({c.point.record for c in task}) == 1 for task in tasks)
    assert max(map(len, tasks)) <= CELLS_A_TASK


def test_a_cell_has_the_same_key_in_every_study_and_no_other_has_it() -> None:
    few, more = (cells_of(spec(fit={"degree": d}, seeds=2)) for d in ([2], [2, 3]))
    keys = [cell.key for cell in more]
    assert len(set(keys)) == len(keys)
    assert {cell.key for cell in few} < set(keys)


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


def test_points_drawn_twice_are_one_and_records_lie_together() -> None:
    made = spec(
        design={"random": 60, "seed": 3},
        record={"noise_percent": [1.0, 2.0, 3.0]},
        fit={"degree": [1, 2, 3, 4]},
    )
    points = list(points_of(made))
    assert len({point.settings for point in points}) == len(points) == 12
    assert len({point.record for point in points}) == 3
    assert {point.draw for point in points} == {"s-0"}


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "unknown key": ({"seed": 3}, "the key 'seed'"),
    "unknown source": ({"record": {"source": "bench"}}, "bench"),
    "setting of another source": ({"record": {"case": "985"}}, "case"),
    "empty axis": ({"record": {"noise_percent": []}}, "each once, found []"),
    "range in a grid": ({"record": {"noise_percent": {"from": 1.0, "to": 2.0}}}, "a range"),
    "range upside down": ({"record": {"noise_percent": {"from": 2.0, "to": 1.0}}}, "below 'to'"),
    "range of texts": ({"record": {"hide": {"from": 1, "to": 2}}}, "found 1.0"),
    "reduction of coefficients": ({"reduction": {"cutoff_hz": 20.0}}, "no counts to reduce"),
    "no seeds": ({"seeds": 0}, "from 1 on"),
    "unknown score": ({"scores": ["beauty"]}, "beauty"),
    "unknown method": ({"method": [{"name": "magic"}]}, "magic"),
    "built-in with parameters": (
        {"method": [{"name": "sindy", "parameters": {"a": 1}}]},
        "with parameters",
    ),
    "degree too high": ({"fit": {"degree": 99}}, "99"),
    "unknown hold": ({"fit": {"hold": "second"}}, "'zero' or 'first'"),
    "files have no seeds": ({"record": {"source": "files", "path": "a"}, "seeds": 2}, "files"),
    "files without a path": ({"record": {"source": "files"}}, "nothing"),
    "too many": ({"record": {"degree": [2, 3]}, "seeds": 10**6}, "1000000"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_mistake_is_named_before_anything_is_computed(case: str) -> None:
    given, found = BAD[case]
    with pytest.raises(InputError, match="expected") as caught:
        spec_from(given)
    assert found in str(caught.value)
