"""Mistakes in raw records that are no text: MAT, HDF5, netCDF, TDMS and Parquet files."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mistake import REDUCE, REFUSED, Mistake, Spoil
from mistakes_models import Trap
from mistakes_raw_files import NOISE
from spoiling import written
from stored_records import WRITERS, columns_of, write_stored

__all__ = ["FORMATS"]

PROBE = "P31_B_hub_aft"
TDMS, HDF5, MAT, PARQUET = ".tdms", ".h5", ".mat", ".parquet"


def _reduce(suffix: str) -> str:
    return REDUCE.replace("raw.csv", f"raw{suffix}")


def _row(suffix: str, id_: str, did: str, says: tuple[str, ...], spoil: Spoil) -> Mistake:
    name = f"raw{suffix}"
    return Mistake(
        f"{suffix[1:]}-raw-{id_}", did, REFUSED, (name, *says), _reduce(suffix), spoil=spoil
    )


def _renamed(suffix: str) -> Spoil:
    def spoil(folder: Path) -> None:
        (folder / "raw.csv").rename(folder / f"raw{suffix}")

    return spoil


def _cut(suffix: str) -> Spoil:
    def spoil(folder: Path) -> None:
        path = write_stored(folder, suffix)
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) * 2 // 3])

    return spoil


def _with(suffix: str, change: Callable[[dict[str, np.ndarray]], dict[str, Any]]) -> Spoil:
    return lambda folder: WRITERS[suffix](folder / f"raw{suffix}", change(columns_of(folder)))


def _without_clock(columns: dict[str, np.ndarray]) -> dict[str, Any]:
    return {name: values for name, values in columns.items() if name != "time_s"}


def _shorter(columns: dict[str, np.ndarray]) -> dict[str, Any]:
    return {**columns, PROBE: columns[PROBE][:-100]}


def _gap(columns: dict[str, np.ndarray]) -> dict[str, Any]:
    return {name: np.delete(values, np.s_[500:520]) for name, values in columns.items()}


def _not_a_number(columns: dict[str, np.ndarray]) -> dict[str, Any]:
    values = columns[PROBE].astype(float)
    values[811] = np.nan
    return {**columns, PROBE: values}


def _hdf5(change: Callable[[Any], None]) -> Spoil:
    def spoil(folder: Path) -> None:
        import h5py

        with h5py.File(write_stored(folder, HDF5), "a") as file:
            change(file)

    return spoil


def _loop(file: Any) -> None:
    group = file.create_group("again")
    group["again"] = group
    del file[PROBE]


def _elsewhere(file: Any) -> None:
    import h5py

    del file[PROBE]
    file[PROBE] = h5py.ExternalLink("secret.h5", "/x")


def _deep(file: Any) -> None:
    del file[PROBE]
    group = file
    for _ in range(2000):
        group = group.create_group("g")


def _endless(file: Any) -> None:
    for name in list(file):
        kind = file[name].dtype
        del file[name]
        file.create_dataset(name, shape=(10**12,), dtype=kind, chunks=(10**5,))


def _objects(folder: Path) -> None:
    from scipy.io import savemat

    columns: dict[str, Any] = dict(columns_of(folder))
    columns[PROBE] = np.array(["x"] * 2001, dtype=object)
    savemat(folder / "raw.mat", columns)


def _nested(folder: Path) -> None:
    from scipy.io import savemat

    inner: dict[str, Any] = {"x": 1.0}
    for _ in range(300):
        inner = {"g": inner}
    savemat(folder / "raw.mat", {"g": inner}, long_field_names=True)


def _texts(columns: dict[str, np.ndarray]) -> dict[str, Any]:
    return {**columns, PROBE: np.array([f"{v} counts" for v in columns[PROBE]])}


def _listed(columns: dict[str, np.ndarray]) -> dict[str, Any]:
    return {**columns, PROBE: [[int(v), int(v)] for v in columns[PROBE]]}


def _archive() -> bytes:
    out = io.BytesIO()
    np.savez(out, time_s=np.array([Trap()], dtype=object))
    return out.getvalue()


FORMATS = (
    *(
        _row(s, "noise", f"binary noise is named {s}", (), written(f"raw{s}", NOISE))
        for s in WRITERS
    ),
    *(
        _row(s, "empty", f"an empty file is named {s}", ("empty",), written(f"raw{s}", b""))
        for s in WRITERS
    ),
    *(
        _row(
            s,
            "csv",
            f"a CSV table is named {s}",
            (),
            _renamed(s),
        )
        for s in WRITERS
    ),
    *(
        _row(s, "pickle", f"a pickle is named {s}", (), written(f"raw{s}", pickle.dumps(Trap())))
        for s in WRITERS
    ),
    *(_row(s, "cut", f"a file {s} ends after two thirds", (), _cut(s)) for s in WRITERS),
    *(
        _row(s, "clock", f"a file {s} has no clock", ("time_s",), _with(s, _without_clock))
        for s in WRITERS
    ),
    *(
        _row(s, "gap", f"rows are missing in a file {s}", ("uniform step", "0.499"), _with(s, _gap))
        for s in WRITERS
    ),
    *(
        _row(
            s,
            "nan",
            f"a reading is NaN in a file {s}",
            (PROBE, "finite", "row 812"),
            _with(s, _not_a_number),
        )
        for s in WRITERS
    ),
    *(
        _row(
            s,
            "shorter",
            f"a channel is shorter than the clock in a file {s}",
            (PROBE,),
            _with(s, _shorter),
        )
        for s in (MAT, HDF5, TDMS)
    ),
    _row(HDF5, "loop", "an HDF5 group holds itself", (PROBE,), _hdf5(_loop)),
    _row(HDF5, "link", "an HDF5 dataset is a link to another file", (PROBE,), _hdf5(_elsewhere)),
    _row(HDF5, "deep", "HDF5 groups lie in one another two thousand deep", (), _hdf5(_deep)),
    _row(
        HDF5,
        "endless",
        "a small HDF5 file claims a billion rows",
        ("no vector of numbers",),
        _hdf5(_endless),
    ),
    _row(MAT, "objects", "a channel of a MAT file is a cell array", (PROBE,), _objects),
    _row(MAT, "nested", "structs of a MAT file lie in one another three hundred deep", (), _nested),
    _row(PARQUET, "texts", "a channel of a Parquet file is text", (PROBE,), _with(PARQUET, _texts)),
    _row(
        PARQUET,
        "lists",
        "a channel of a Parquet file holds lists",
        (PROBE,),
        _with(PARQUET, _listed),
    ),
    Mistake(
        "npz-raw",
        "an archive of pickled objects is given for a raw record",
        REFUSED,
        ("raw.npz", "suffix"),
        _reduce(".npz"),
        spoil=written("raw.npz", _archive()),
    ),
)
