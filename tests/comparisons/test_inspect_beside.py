"""What `sindy-surge inspect` tells of what is beside the record, and files it writes."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from nptdms import ChannelObject, TdmsWriter
from raw_data import RawTest, make_test

from classic_ml.inspection import inspect_file
from classic_ml.readers import read_raw
from comparisons.cli import main
from surge_core.errors import InputError


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.5)


@pytest.fixture
def two_groups(made: RawTest, tmp_path: Path) -> Path:
    """Pressures at 1 kHz, thermocouples at 100 Hz."""

    def channels(group: str, kind: str, every: int) -> list[Any]:
        return [
            ChannelObject(group, name, values[::every], {"wf_increment": every * 1e-3})
            for name, values in made.columns.items()
            if name.startswith(kind)
        ]

    path = tmp_path / "two.tdms"
    with TdmsWriter(path) as writer:
        writer.write_segment([*channels("fast", "P", 1), *channels("slow", "T", 10)])
    made.write(tmp_path)
    return path


def test_groups_that_are_left_out_are_named_with_what_to_do(
    two_groups: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = two_groups.parent
    out, draft = folder / "found.json", folder / "draft.toml"
    assert main(["inspect", str(two_groups), "--json", str(out), "--draft", str(draft)]) == 0
    text = capsys.readouterr().out
    held = "4 channels of 51 values, 100 a second"
    assert f"  slow: {held}" in text
    for word in ("resample", "--group NAME", "[file]"):
        assert word in text
    found = json.loads(out.read_text("utf-8"))
    assert found["other_groups"] == {"slow": held}
    assert found["left_aside"]["slow/T25_A"].startswith("in the group 'slow', 51 values")
    assert f"# slow: {held}" in draft.read_text("utf-8")
    tomllib.loads(draft.read_text("utf-8"))


def test_a_channel_of_another_group_is_not_taken_for_a_dead_probe(
    two_groups: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    test = two_groups.with_name("test.toml")
    with pytest.raises(InputError, match=r"T25_A: .* in the group 'slow', 51 values.* resample"):
        read_raw(two_groups, test)
    assert main(["inspect", str(two_groups), "--test", str(test)]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("T25_A")]
    assert "no such column: in the group 'slow', 51 values where the record has 501" in rows[0]


def test_a_group_that_is_named_is_shown_without_the_others(two_groups: Path) -> None:
    found = inspect_file(two_groups, group="slow")
    assert (found.rows, found.other_groups) == (51, {})
    assert {c.name for c in found.channels} == {"time_s", "T25_A", "T25_B", "T31_A", "T31_B"}


@pytest.mark.parametrize("part", [0.1, 0.66])
def test_a_file_that_was_cut_before_its_first_row_is_not_said_to_be_shown(
    two_groups: Path, part: float, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = two_groups.read_bytes()
    two_groups.write_bytes(whole[: int(len(whole) * part)])
    test = str(two_groups.with_name("test.toml"))
    for command in (["inspect"], ["reduce", "--test", test, "-o", str(two_groups) + ".csv"]):
        assert main([command[0], str(two_groups), *command[1:]]) == 2
        said = capsys.readouterr().err
        assert "cut short" in said
        assert "copy it again" in said
        assert "inspect`" not in said
