"""Damage copies of a file, run a command on each in this process, and print what it answered.

Run as ``python damaged_files.py FOLDER FILE SEEDS COMMAND…``: a library in C that dies of garbage
takes this process with it and not the tests. What each copy was answered stays in
``FOLDER/answers``, and what the sound file is answered in ``FOLDER/answers/sound``.
"""

from __future__ import annotations

import json
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd

__all__ = ["damaged", "wrong_readings"]


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


def wrong_readings(sound: Path, spoiled: Path) -> int:
    """Return how many readings of a file are not those of another; all, if its table is another."""
    one, other = _table(sound), _table(spoiled)
    if one.shape != other.shape or list(one) != list(other):
        return one.size
    return int((one.ne(other) & ~(one.isna() & other.isna())).to_numpy().sum())


def _table(file: Path) -> pd.DataFrame:
    from classic_ml.io.formats import open_stored

    stored = open_stored(file)
    return pd.DataFrame(np.concatenate(list(stored.chunks(1 << 16))), columns=list(stored.names))


def _main(folder: Path, name: str, seeds: int, command: str) -> None:
    from mistake_desk import run_in

    data = (folder / name).read_bytes()
    run_in(_copied(folder, folder / "answers" / "sound"), command)
    for seed in range(seeds):
        copy = _copied(folder, folder / "answers" / str(seed))
        spoiled = damaged(data, seed)
        (copy / name).write_bytes(spoiled)
        _tell({"seed": seed})
        answer = run_in(copy, command)
        told = {"code": answer.code, "out": answer.out, "err": answer.err, "made": answer.made}
        if answer.code == 0:
            told["wrong"] = wrong_readings(folder / name, copy / name)
            told["resized"] = len(spoiled) != len(data)
        _tell({"folder": str(copy), **told})


def _copied(folder: Path, copy: Path) -> Path:
    copy.mkdir(parents=True)
    for file in folder.iterdir():
        if file.is_file():
            shutil.copy(file, copy)
    return copy


def _tell(what: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), shlex.join(sys.argv[4:]))
