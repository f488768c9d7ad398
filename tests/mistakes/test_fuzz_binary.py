"""Binary files that are damaged: shown, refused in one sentence, or read; never a traceback."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mistake_checks import check_sentence
from mistake_desk import Answer, run_in
from stored_records import write_stored

SEEDS = 8
# A library in C that dies of damaged bytes takes this process with it, and not the tests.
LOOK = """
import json, sys
from pathlib import Path
from mistake_desk import run_in
for file in map(Path, sys.argv[1:]):
    answer = run_in(file.parent, f"inspect {file.name}")
    print(json.dumps([answer.code, answer.out, answer.err]), flush=True)
"""


def damaged(data: bytes, seed: int) -> bytes:
    """Return bytes after one kind of damage; most of it near the front, where the headers are."""
    rng = np.random.default_rng(seed)
    out = bytearray(data)
    reach = len(data) if rng.random() < 0.4 else min(len(data), 4096)
    at = int(rng.integers(reach))
    kind = int(rng.integers(4))
    if kind == 0:
        out[at] ^= int(rng.integers(1, 256))
    elif kind == 1:
        del out[at : at + int(rng.integers(1, 64))]
    elif kind == 2:
        del out[int(rng.integers(len(out))) :]
    else:
        out[at:at] = rng.bytes(int(rng.integers(1, 32)))
    return bytes(out)


@pytest.mark.parametrize("suffix", [".mat", ".h5", ".nc", ".tdms", ".parquet"])
def test_a_damaged_binary_record(clean: Path, tmp_path: Path, suffix: str) -> None:
    shutil.copy(clean / "raw.csv", tmp_path)
    good = write_stored(tmp_path, suffix).read_bytes()
    files = [tmp_path / f"bad_{seed}{suffix}" for seed in range(SEEDS)]
    for seed, file in enumerate(files):
        file.write_bytes(damaged(good, seed))
    done = subprocess.run(
        [sys.executable, "-c", LOOK, *map(str, files)],
        cwd=Path(run_in.__code__.co_filename).parent,
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0, f"it ended after {len(answers)}: {done.stderr[-600:]}"
    assert len(answers) == SEEDS
    for code, out, err in answers:
        if code == 0:
            assert (bool(out), err) == (True, "")
        else:
            check_sentence(Answer(code, out, err, (), ()))
    assert any(code == 2 for code, _, _ in answers)
