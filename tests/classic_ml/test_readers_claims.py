"""Files that claim what is not there: the libraries in C that read them must not die of it."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from classic_ml.readers.hdf5_claims import MOST_TEXTS
from classic_ml.readers.raw_formats import open_stored

ROWS = 150
GOOD = {"time_s": np.arange(ROWS) * 1e-3, "P": np.linspace(-1.0, 1.0, ROWS)}
# A reader that stands still is none that takes its time.
STANDS_STILL_S = 60.0
READ = """
import json, sys
from pathlib import Path
from surge_core.errors import InputError
from classic_ml.readers.raw_formats import open_stored
for file in sys.argv[1:]:
    try:
        raw = open_stored(Path(file))
        rows = sum(len(part) for part in raw.chunks(100))
        print(json.dumps([rows, sorted(raw.names), "", raw.unusable]), flush=True)
    except InputError as error:
        print(json.dumps([0, [], str(error), {}]), flush=True)
"""


def read_apart(*files: Path) -> list[tuple[int, list[str], str, dict[str, str]]]:
    """Read files in another process: rows, names, the refusal, and what cannot be read."""
    done = subprocess.run(
        [sys.executable, "-c", READ, *map(str, files)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
        timeout=STANDS_STILL_S,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0, f"died of {files[len(answers)].name}: {done.stderr[-600:]}"
    return [tuple(answer) for answer in answers]


def element(kind: int, content: bytes) -> bytes:
    padded = content.ljust(-(-len(content) // 8) * 8, b"\0")
    return struct.pack("<2I", kind, len(content)) + padded


def array(kind: int, shape: tuple[int, ...], content: bytes, name: bytes = b"odd") -> bytes:
    """Return an array of a MAT file of version 5."""
    return element(
        14,
        element(6, struct.pack("<2I", kind, 0))
        + element(5, struct.pack(f"<{len(shape)}i", *shape))
        + element(1, name)
        + content,
    )


def nested(depth: int) -> bytes:
    """Return a cell in a cell, each as long as it says that it is not."""
    return array(1, (1, 1), array(1, (1, 1), b"", b"") * depth)


HUGE = 2**31 - 1
NUMBER = element(9, bytes(8))
NAMES = element(5, struct.pack("<i", 32))
ODD_ARRAYS = {
    **{f"numbers of type {n}": array(6, (1, 1), element(n, bytes(8))) for n in (0, 8, 14, 19, 77)},
    "letters of type 10": array(4, (1, 4), element(10, b"text")),
    "an element of no type in a cell": array(1, (1, 1), array(6, (1, 1), element(8, bytes(8)))),
    "class 0": array(0, (1, 1), NUMBER),
    "no axes": array(4, (), element(16, b"t")),
    "more cells than bytes": array(1, (HUGE, HUGE), NUMBER),
    "a negative size": array(1, (-1, 1), NUMBER),
    "a text of blanks without end": array(4, (1, HUGE), element(16, b"")),
    "structs without fields": array(2, (1, HUGE), NAMES + element(1, b"")),
    "fields without letters": array(2, (1, 1), element(5, bytes(4)) + element(1, bytes(64))),
    "more fields than anybody names": array(
        2, (1, 1), element(5, struct.pack("<i", 1)) + element(1, b"a\0" * 400_000)
    ),
    "cells in one another": nested(1_500),
}


@pytest.mark.parametrize("packed", [False, True], ids=["plain", "compressed"])
def test_a_mat_file_with_an_array_that_is_none_is_refused(tmp_path: Path, packed: bool) -> None:
    savemat(tmp_path / "good.mat", GOOD)
    good = (tmp_path / "good.mat").read_bytes()
    files = []
    for number, odd in enumerate(ODD_ARRAYS.values()):
        files.append(tmp_path / f"{number}.mat")
        packing = zlib.compress(odd)
        stored = struct.pack("<2I", 15, len(packing)) + packing if packed else odd
        files[-1].write_bytes(good + stored)
    for case, (_, _, refusal, _) in zip(ODD_ARRAYS, read_apart(*files), strict=True):
        assert "expected a MAT file, found what cannot be read" in refusal, case
        assert "copy it again" in refusal


def test_arrays_of_every_class_in_one_another_are_passed_over(tmp_path: Path) -> None:
    cells = np.empty((2, 3), dtype=object)
    cells[:] = "a text"
    cells[0, 0] = {"deep": np.arange(5) * 1j, "empty": np.zeros((0, 3)), "texts": ["a", "bcd"]}
    cells[1, 2] = np.zeros(4, dtype=bool)
    for packed in (False, True):
        savemat(
            tmp_path / "odd.mat",
            {"cells": cells, "struct": {"inner": cells}, **GOOD, "blank": ""},
            do_compression=packed,
        )
        raw = open_stored(tmp_path / "odd.mat")
        np.testing.assert_array_equal(
            np.concatenate(list(raw.chunks(50))), np.column_stack(list(GOOD.values()))
        )


def written(path: Path, library: str = "earliest") -> Path:
    """Write a record whose units are texts of any length, and which holds others."""
    with h5py.File(path, "w", libver=(library, "latest")) as file:
        for name, values in GOOD.items():
            file[name] = values
            file[name].attrs["units"] = "s" if name == "time_s" else "Pa"
        file["notes"] = ["one", "another"]
    return path


def spoiled(path: Path, good: bytes, place: int, value: bytes) -> Path:
    data = bytearray(good)
    data[place : place + len(value)] = value
    path.write_bytes(data)
    return path


def text_of_length(good: bytes, length: int) -> int:
    """Return where the first text of a length is referred to."""
    return good.index(struct.pack("<IQ", length, good.index(b"GCOL")))


def test_texts_in_a_heap_that_has_no_end_are_left_aside(tmp_path: Path) -> None:
    good = written(tmp_path / "good.h5").read_bytes()
    heap = good.index(b"GCOL")
    free = heap + 16
    while struct.unpack_from("<H", good, free)[0]:
        free += 16 + -(-struct.unpack_from("<Q", good, free + 8)[0] // 8) * 8
    files = [
        spoiled(tmp_path / f"{number}.h5", good, place, struct.pack("<Q", size))
        for number, (place, size) in enumerate(
            [(free + 8, 0), (free + 8, 2**64 - 8), (heap + 24, 2**64 - 16), (heap + 8, 2**40)]
        )
    ]
    for _, names, refusal, _ in read_apart(*files):
        assert names == []
        assert "no vector of numbers in it" in refusal


@pytest.mark.parametrize(
    ("length", "spoilt", "names"), [(2, "P", ["time_s"]), (3, "notes", ["P", "time_s"])]
)
def test_a_text_of_four_gigabytes_is_left_aside(
    tmp_path: Path, length: int, spoilt: str, names: list[str]
) -> None:
    good = written(tmp_path / "good.h5").read_bytes()
    file = spoiled(tmp_path / "bad.h5", good, text_of_length(good, length) + 3, b"\xff")
    (answer,) = read_apart(file)
    assert answer[:3] == (ROWS, names, "")
    assert f"a text of 4,278,190,0{80 + length} bytes" in answer[3][spoilt]


def test_texts_that_are_of_no_type_are_left_aside(tmp_path: Path) -> None:
    good = written(tmp_path / "good.h5").read_bytes()
    # The type of the unit behind its name: class 9 in version 1, and which kind of that it is.
    place = good.index(b"units\0\0\0\x19\x01") + 9
    ((rows, names, _, _),) = read_apart(spoiled(tmp_path / "bad.h5", good, place, b"\x2c"))
    assert (rows, names) == (ROWS, sorted(GOOD))


def test_rows_with_a_text_that_is_none_are_refused(tmp_path: Path) -> None:
    text = h5py.string_dtype()
    table = np.zeros(ROWS, dtype=[("note", text), ("time_s", "f8"), ("P", "f8")])
    table["note"] = "fine"
    for name, values in GOOD.items():
        table[name] = values
    with h5py.File(tmp_path / "good.h5", "w") as file:
        file["table"] = table
    good = (tmp_path / "good.h5").read_bytes()
    longer = spoiled(tmp_path / "long.h5", good, text_of_length(good, 4) + 3, b"\xff")
    of_no_type = spoiled(tmp_path / "type.h5", good, good.index(b"\x19\x01\x01\0\x10") + 1, b"\x2c")
    sound, *bad = read_apart(tmp_path / "good.h5", longer, of_no_type)
    assert (sound[0], sound[1]) == (ROWS, sorted(GOOD))
    for rows, _, refusal, _ in bad:
        assert rows == 0
        assert "no vector of numbers in it" in refusal


@pytest.mark.parametrize("library", ["earliest", "latest"])
@pytest.mark.parametrize("user_block", [0, 512])
def test_sound_texts_are_read_wherever_they_lie(
    tmp_path: Path, library: str, user_block: int
) -> None:
    file = tmp_path / "many.h5"
    with h5py.File(
        file, "w", libver=(library, "latest"), userblock_size=user_block, track_order=True
    ) as opened:
        for number in range(40):
            data = opened.create_dataset(f"P{number}", data=GOOD["P"] + number, chunks=(50,))
            # So many that they go on in other blocks of the header.
            for other in range(12):
                data.attrs[f"note {other}"] = "x" * (other * number)
            data.attrs["units"] = "Pa" + number * "-"
        opened.create_dataset(
            "names", data=[f"n{n}" for n in range(7)], dtype=h5py.string_dtype(), chunks=(3,)
        )
        opened["long"] = ["y" * 70_000] * 3
        opened["more"] = ["z"] * (MOST_TEXTS + 1)
    raw = open_stored(file)
    assert list(raw.names) == [f"P{number}" for number in range(40)]
    assert dict(raw.units) == {f"P{number}": "Pa" + number * "-" for number in range(40)}
    assert not any("cannot be read" in why for why in raw.unusable.values())
