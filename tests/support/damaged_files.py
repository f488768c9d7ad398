"""Damage copies of a file, run a command on each in this process, and print what it answered.

Run as ``python damaged_files.py FOLDER FILE SEEDS COMMAND…``: a library in C that dies of garbage
takes this process with it and not the tests.
"""

from __future__ import annotations

import json
import shlex
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

__all__ = ["damaged"]


def damaged(data: bytes, seed: int) -> bytes:
    """Return bytes after one kind of damage; most of it near the front, where the headers are."""
    rng = np.random.default_rng(seed)
    out = bytearray(data)
    reach = len(data) if rng.random() < 0.4 else min(len(data), 4096)
    at = int(rng.integers(reach))
    kind = int(rng.integers(6))
    if kind == 0:
        out[at] ^= int(rng.integers(1, 256))
    elif kind == 1:
        for place in rng.integers(reach, size=12):
            out[place] = int(rng.integers(256))
    elif kind == 2:
        out[at : at + 8] = rng.choice([b"\xff", b"\0", b"\x7f"]) * 8
    elif kind == 3:
        del out[at : at + int(rng.integers(1, 64))]
    elif kind == 4:
        del out[int(rng.integers(len(out))) :]
    else:
        out[at:at] = rng.bytes(int(rng.integers(1, 32)))
    return bytes(out)


def _main(folder: Path, name: str, seeds: int, command: str) -> None:
    from mistake_desk import run_in

    data = (folder / name).read_bytes()
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as scratch:
            for file in folder.iterdir():
                shutil.copy(file, scratch)
            (Path(scratch) / name).write_bytes(damaged(data, seed))
            _tell({"seed": seed})
            answer = run_in(Path(scratch), command)
            _tell({"code": answer.code, "out": answer.out, "err": answer.err, "made": answer.made})


def _tell(what: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), shlex.join(sys.argv[4:]))
