"""Binary files that are damaged: libraries in C may die of them, and must not."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import damaged_files
import pytest
from mistake import REDUCE
from mistake_checks import check_sentence
from mistake_desk import Answer, ledger_of, rms_errors, run_in
from stored_records import WRITERS, write_stored

SEEDS = 30


def answers(folder: Path, name: str, command: str) -> list[Answer]:
    """Run a command on damaged copies of a file in another process, and return its answers."""
    script = Path(damaged_files.__file__)
    done = subprocess.run(
        [sys.executable, str(script), str(folder), name, str(SEEDS), *shlex.split(command)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
    )
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    told = [line for line in lines if "code" in line]
    last = lines[-1] if lines else {}
    assert done.returncode == 0, f"the process ended at {last}: {done.stderr[-600:]}"
    assert done.stderr == ""
    assert len(told) == SEEDS
    return [Answer(a["code"], a["out"], a["err"], tuple(a["made"]), ()) for a in told]


@pytest.mark.parametrize("suffix", list(WRITERS))
def test_a_sound_file_of_each_format_gives_what_the_table_gives(
    clean: Path, tmp_path: Path, suffix: str
) -> None:
    for name in ("raw.csv", "test.toml"):
        shutil.copy(clean / name, tmp_path)
    write_stored(tmp_path, suffix)
    answer = run_in(tmp_path, REDUCE.replace("raw.csv", f"raw{suffix}"))
    assert answer.code == 0, answer.err
    assert max(rms_errors(clean / "reduced.csv", tmp_path / "reduced.csv")) < 1e-12
    assert ledger_of(tmp_path) == ledger_of(clean)


@pytest.mark.parametrize("suffix", list(WRITERS))
def test_a_damaged_binary_record(clean: Path, tmp_path: Path, suffix: str) -> None:
    for name in ("raw.csv", "test.toml"):
        shutil.copy(clean / name, tmp_path)
    write_stored(tmp_path, suffix)
    (tmp_path / "raw.csv").unlink()
    refused = 0
    for answer in answers(tmp_path, f"raw{suffix}", REDUCE.replace("raw.csv", f"raw{suffix}")):
        if answer.code == 0:
            assert set(answer.made) == {"reduced.csv", "reduced.ledger.json"}
        else:
            check_sentence(answer)
            assert answer.made == ()
            refused += 1
    assert refused > SEEDS // 4


def test_a_damaged_netcdf_series(clean: Path, tmp_path: Path) -> None:
    from classic_ml.series import read_series, write_series

    write_series(read_series(clean / "series.csv"), tmp_path / "series.nc")
    shutil.copy(clean / "model.json", tmp_path)
    command = "reconstruct model.json series.nc -o again.csv"
    for answer in answers(tmp_path, "series.nc", command):
        if answer.code != 0:
            check_sentence(answer)
            assert answer.made == ()
