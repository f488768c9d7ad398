"""The table itself: long enough, each row once, each with what a reader of it needs."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from mistake import HARMLESS, UNNOTICED
from mistake_desk import hand_in, run_in
from mistakes import MISTAKES


def test_the_table_is_long_and_names_each_mistake_once() -> None:
    assert len(MISTAKES) >= 60
    assert not [name for name, count in Counter(m.id for m in MISTAKES).items() if count > 1]


def test_each_row_says_what_is_owed_and_why_nothing_is() -> None:
    for row in MISTAKES:
        assert row.says or row.outcome in (HARMLESS, UNNOTICED), row.id
        assert row.why or row.outcome not in (HARMLESS, UNNOTICED), row.id


@pytest.mark.parametrize(
    "row",
    [
        next(m for m in MISTAKES if m.id == name)
        for name in ("raw-nan", "toml-nested", "series-gap", "netcdf-noise")
    ],
    ids=lambda row: row.id,
)
def test_the_installed_command_refuses_as_the_function_does(
    row: object, clean: Path, tmp_path: Path
) -> None:
    here = hand_in(row, clean, tmp_path)  # type: ignore[arg-type]
    code = "import sys; from comparisons.cli.parser import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, *row.command.split()],  # type: ignore[attr-defined]
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert (done.returncode, done.stdout, done.stderr) == (2, "", here.err)


def test_the_clean_files_are_clean(clean: Path) -> None:
    again = run_in(clean, "reconstruct model.json series.csv")
    assert again.code == 0, again.err
