"""The page of test.toml names every key that the reader takes, and no other."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import get_args

import pytest

from classic_ml.description import PressureChannel, TemperatureChannel
from classic_ml.io import description_file as models
from classic_ml.io import read_test_description
from surge_core.models import Table

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "test_toml.md").read_text("utf-8")


def example() -> str:
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    return str(text)


def known_keys() -> dict[str, set[str]]:
    """Return the keys that each table may hold, by the heading of the table on the page."""
    tables = {
        "planes.*": [models.Plane],
        "Pressures": [PressureChannel],
        "Temperatures": [TemperatureChannel],
    }
    for name, field in models.Document.model_fields.items():
        kinds = [field.annotation, *get_args(field.annotation)]
        tables[name] = [k for k in kinds if isinstance(k, type) and issubclass(k, Table)]
    keys = {
        head: {key for one in some for key in one.model_fields} for head, some in tables.items()
    }
    # A channel is named by the head of its table.
    for head in ("Pressures", "Temperatures"):
        keys[head] -= {"name"}
    return {head: found for head, found in keys.items() if found and head != "planes"}


def keys_on_page() -> dict[str, set[str]]:
    """Return the keys in the first cells of the tables, by the heading above them."""
    keys: dict[str, set[str]] = defaultdict(set)
    head = ""
    for line in PAGE.splitlines():
        if line.startswith("#"):
            found = re.search(r"`\[([\w.]+)\]`", line)
            head = found[1] if found else line.strip("# ")
            head = re.sub(r"^planes\.NAME$", "planes.*", head)
        if line.startswith("|"):
            keys[head] |= set(re.findall(r"`(\w+)`", line.split("|")[1]))
    return {head: found for head, found in keys.items() if found}


def test_the_page_has_every_key_and_no_other() -> None:
    assert keys_on_page() == known_keys()
    for table in models.Document.model_fields:
        assert re.search(rf"^#+ `\[{table}[\].]", PAGE, re.MULTILINE), table


def test_the_example_is_taken_as_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "test.toml"
    path.write_text(example(), "utf-8")
    test = read_test_description(path)
    assert [c.file_column for c in test.pressures] == ["ch 01", "ch 02", "PT31A fwd", "PT31A aft"]
    assert test.near_stall.P25_Pa == pytest.approx(7.98 * 6894.757, rel=1e-6)
    assert test.pressures[0].calibrate_pressure_Pa == 41368.5
    # Each line of it is needed: without one it is refused, or means something else.
    lines = example().splitlines()
    for number, line in enumerate(lines):
        if " = " not in line:
            continue
        path.write_text("\n".join([*lines[:number], *lines[number + 1 :]]), "utf-8")
        try:
            assert read_test_description(path) != test, line
        except ValueError:
            continue
