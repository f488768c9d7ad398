"""Each mistake of the table is refused in one sentence, flagged, or harmless."""

from __future__ import annotations

import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from mistake import Mistake
from mistake_checks import check, check_printable, check_sentence
from mistake_desk import hand_in, run_in
from mistakes import CLOCKS, FORMATS, MISTAKES, RAW_FILES, READINGS


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda row: row.id)
def test_a_mistake_is_answered(mistake: Mistake, clean: Path, tmp_path: Path) -> None:
    check(mistake, hand_in(mistake, clean, tmp_path), clean, tmp_path)


@pytest.mark.parametrize("row", [*RAW_FILES, *FORMATS, *CLOCKS, *READINGS[:3]], ids=lambda r: r.id)
def test_inspect_shows_a_spoiled_file_or_refuses_it(
    row: Mistake, clean: Path, tmp_path: Path
) -> None:
    command = f"inspect {shlex.split(row.command)[1]} --test test.toml"
    answer = hand_in(replace(row, command=command), clean, tmp_path)
    check_printable(answer)
    assert not answer.made
    if answer.code == 0:
        assert answer.err == ""
        assert answer.out
    else:
        check_sentence(answer)


def test_the_installed_command_refuses_as_the_function_does(clean: Path, tmp_path: Path) -> None:
    row = next(m for m in MISTAKES if m.id == "raw-nan")
    here = hand_in(row, clean, tmp_path)
    code = "import sys; from comparisons.cli.parser import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, *row.command.split()],
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
