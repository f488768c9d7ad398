"""The page of test.toml names every key that the reader takes, and no other."""

from __future__ import annotations

import re
import tomllib
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from raw_data import to_toml

from classic_ml.readers import read_test_description, toml_tables
from classic_ml.readers.toml_tables import Table

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "test_toml.md").read_text("utf-8")
# Tables that may be left out, and are in no example that is small.
OPTIONAL = {
    "near_stall_shifts": {"T25_A": 0.1},
    "limits": {"T25_A": [200.0, 600.0]},
    "segmentation": {"threshold_lbm_s": 40.0},
    "window": {"from_s": 1.0, "to_s": 2.0},
}
# The keys of these are names of channels.
NAMED_BY_CHANNEL = {"channels", "limits", "near_stall_shifts"}


def example() -> str:
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    return str(text)


def known_keys(folder: Path, patch: pytest.MonkeyPatch) -> dict[str, set[str]]:
    """Return what the reader asks each table for, by the heading of the table on the page."""
    made: list[Table] = []

    class Watched(Table):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            made.append(self)

    for module in (toml_tables, __import__("classic_ml.readers.test_toml", fromlist=["Table"])):
        patch.setattr(module, "Table", Watched)
    path = folder / "test.toml"
    path.write_text(to_toml({**tomllib.loads(example()), **OPTIONAL}), "utf-8")
    description = read_test_description(path)
    temperatures = {channel.name for channel in description.temperatures}
    keys: dict[str, set[str]] = defaultdict(set)
    for table in made:
        head, _, name = table.path.partition(".")
        if head == "channels" and name:
            head = "Temperatures" if name in temperatures else "Pressures"
        elif name:
            head = f"{head}.*"
        if head not in NAMED_BY_CHANNEL and table.path != "planes":
            keys[head] |= table._asked | table._keys
    return dict(keys)


def keys_on_page() -> dict[str, set[str]]:
    """Return the keys in the first cells of the tables, by the heading above them."""
    keys: dict[str, set[str]] = defaultdict(set)
    head = ""
    for line in PAGE.splitlines():
        if line.startswith("#"):
            found = re.search(r"`\[([\w.]+)\]`", line)
            head = found[1] if found else line.strip("# ")
            head = re.sub(r"^planes\.\d+$", "planes.*", head)
        if line.startswith("|"):
            keys[head] |= set(re.findall(r"`(\w+)`", line.split("|")[1]))
    return {head: found for head, found in keys.items() if found}


def test_the_page_has_every_key_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = known_keys(tmp_path, monkeypatch)
    tables = known.pop("")
    assert keys_on_page() == known
    for table in tables:
        assert re.search(rf"^#+ `\[{table}[\].]", PAGE, re.MULTILINE), table


def test_each_row_says_type_default_and_what_for() -> None:
    rows = [line for line in PAGE.splitlines() if re.match(r"\| [`*]", line)]
    assert len(rows) > 40
    for row in rows:
        key, kind, _, default, what = (cell.strip() for cell in row.strip("|").split("|"))
        assert all((key, kind, default, len(what) > 10)), row


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
