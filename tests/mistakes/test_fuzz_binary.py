"""Binary files that are damaged: libraries in C may die of them, and must not."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import damaged_files
import numpy as np
import pandas as pd
import pytest
from mistake import REDUCE
from mistake_checks import check_sentence
from mistake_desk import Answer, ledger_of, rms_errors, run_in
from stored_records import WRITERS, write_stored

SEEDS = 30
# At most 12 bytes are overwritten. A byte is in one reading; in a page that is compressed, or holds
# each value once, in a few.
MOST_WRONG = 24
# What wrong readings that nobody marks may do to φ and ψ' where both are fitted, rms: a tenth of
# what noise of one count does.
UNMARKED = (6e-4, 2.7e-3)
# Damage of which a library in C died or stood still.
FOUND = {".mat": (1607, 1845), ".nc": (354, 897, 994, 2121), ".h5": (2121, 2953)}
STANDS_STILL_S = 60.0
INSPECT = """
import sys
from pathlib import Path
from mistake_desk import run_in
for file in sys.argv[1:]:
    print(run_in(Path(file).parent, f"inspect {Path(file).name}").code, flush=True)
"""


@dataclass(frozen=True)
class Damaged:
    """What a command answered on a damaged file.

    Parameters
    ----------
    answer : Answer
        What it said and made.
    folder : path
        Where that is.
    wrong : int
        Readings that are not those of the sound file, as they were read; 0 for a refused file.
    resized : bool
        Whether bytes were lost or slipped in.
    """

    answer: Answer
    folder: Path
    wrong: int
    resized: bool


def answers(folder: Path, name: str, command: str) -> list[Damaged]:
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
    return [
        Damaged(
            Answer(a["code"], a["out"], a["err"], tuple(a["made"]), ()),
            Path(a["folder"]),
            a.get("wrong", 0),
            a.get("resized", False),
        )
        for a in told
    ]


def check_numbers(found: Damaged, written: str) -> bool:
    """Fail unless a table is the one of the sound file, but for what single wrong readings explain.

    None of these formats has a sum that is checked, unless its writer asks for one: a byte of a
    reading that is another is another reading. But no row may be lost or moved, and no column
    taken for another.

    Returns
    -------
    bool
        Whether it is that of the sound file to the last bit.
    """
    sound = found.folder.with_name("sound")
    if (found.folder / written).read_bytes() == (sound / written).read_bytes():
        return True
    assert not found.resized, "the readings behind the place were moved"
    assert 0 < found.wrong <= MOST_WRONG
    return False


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


def test_rows_that_are_moved_and_columns_that_are_exchanged_are_seen(
    clean: Path, tmp_path: Path
) -> None:
    sound = pd.read_csv(clean / "raw.csv")
    first, second = [name for name in sound if name.startswith("P")][:2]
    moved, exchanged, spoiled = sound.copy(), sound.copy(), sound.copy()
    moved[first] = np.roll(sound[first], 1)
    exchanged[[first, second]] = sound[[second, first]].to_numpy()
    spoiled.loc[[70, 900], first] += 1
    counts = []
    for table in (sound, spoiled, moved, exchanged, sound[:-1], sound.drop(columns=first)):
        table.to_csv(tmp_path / "raw.csv", index=False)
        counts.append(damaged_files.wrong_readings(clean / "raw.csv", tmp_path / "raw.csv"))
    assert counts[:2] == [0, 2]
    assert min(counts[2:]) > MOST_WRONG


@pytest.mark.parametrize("suffix", list(WRITERS))
def test_a_damaged_binary_record(clean: Path, tmp_path: Path, suffix: str) -> None:
    for name in ("raw.csv", "test.toml"):
        shutil.copy(clean / name, tmp_path)
    write_stored(tmp_path, suffix)
    (tmp_path / "raw.csv").unlink()
    refused = 0
    for found in answers(tmp_path, f"raw{suffix}", REDUCE.replace("raw.csv", f"raw{suffix}")):
        answer = found.answer
        if answer.code == 0:
            assert set(answer.made) == {"reduced.csv", "reduced.ledger.json"}
            sound = tmp_path / "answers" / "sound"
            if not check_numbers(found, "reduced.csv") and not (
                set(ledger_of(found.folder)) - set(ledger_of(sound))
            ):
                off = rms_errors(sound / "reduced.csv", found.folder / "reduced.csv")
                assert off[0] <= UNMARKED[0], f"φ is off by {off[0]:.3g}, and nothing says so"
                assert off[1] <= UNMARKED[1], f"ψ' is off by {off[1]:.3g}, and nothing says so"
        else:
            check_sentence(answer)
            assert answer.made == ()
            refused += 1
    assert refused > SEEDS // 4


@pytest.mark.parametrize("suffix", list(FOUND))
def test_damage_that_was_once_the_end_of_the_process(
    clean: Path, tmp_path: Path, suffix: str
) -> None:
    shutil.copy(clean / "raw.csv", tmp_path)
    good = write_stored(tmp_path, suffix).read_bytes()
    files = [tmp_path / f"bad_{seed}{suffix}" for seed in FOUND[suffix]]
    for file, seed in zip(files, FOUND[suffix], strict=True):
        file.write_bytes(damaged_files.damaged(good, seed))
    done = subprocess.run(
        [sys.executable, "-c", INSPECT, *map(str, files)],
        cwd=Path(damaged_files.__file__).parent,
        capture_output=True,
        text=True,
        check=False,
        timeout=STANDS_STILL_S,
    )
    assert done.returncode == 0, f"the process ended: {done.stderr[-600:]}"
    codes = [int(line) for line in done.stdout.splitlines()]
    assert len(codes) == len(files)
    assert set(codes) <= {0, 2}


def test_a_damaged_netcdf_series(clean: Path, tmp_path: Path) -> None:
    from classic_ml.readers.series_files import read_series, write_series

    write_series(read_series(clean / "series.csv"), tmp_path / "series.nc")
    shutil.copy(clean / "model.json", tmp_path)
    command = "reconstruct model.json series.nc -o again.csv"
    for found in answers(tmp_path, "series.nc", command):
        if found.answer.code == 0:
            assert set(found.answer.made) == {"again.csv"}
            check_numbers(found, "again.csv")
        else:
            check_sentence(found.answer)
            assert found.answer.made == ()
