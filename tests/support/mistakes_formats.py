"""Mistakes in raw records that are no text: MAT, HDF5, netCDF, TDMS and Parquet files."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mistake import REDUCE, REFUSED, Mistake, Spoil
from mistakes_models import Trap
from mistakes_raw_files import NOISE
from spoiling import toml, written
from stored_records import WRITERS, columns_of, write_stored

__all__ = ["FORMATS"]

PROBE = "P31_B_hub_aft"
START = np.datetime64("2026-01-01T12:00:00.000000")
SKEW = ("P25_A_tip_forward and P31_A_tip_forward", "starts 0.02 s later", "resample")
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


def _tdms(properties: Callable[[str], dict[str, Any]]) -> Spoil:
    """Write channels that state when they were sampled, without a column of times."""

    def spoil(folder: Path) -> None:
        from nptdms import ChannelObject, TdmsWriter

        columns = _without_clock(columns_of(folder)).items()
        with TdmsWriter(folder / "raw.tdms") as file:
            file.write_segment([ChannelObject("run", n, v, properties(n)) for n, v in columns])

    return spoil


def _two_groups(folder: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    columns = _without_clock(columns_of(folder)).items()
    fast = [ChannelObject("fast", n, v, {"wf_increment": 1e-3}) for n, v in columns if n[0] == "P"]
    slow = [
        ChannelObject("slow", n, v[::10], {"wf_increment": 1e-2}) for n, v in columns if n[0] == "T"
    ]
    with TdmsWriter(folder / "raw.tdms") as file:
        file.write_segment([*fast, *slow])


def _from_rate(spoil: Spoil) -> Spoil:
    def both(folder: Path) -> None:
        spoil(folder)
        toml(("file/clock", "from rate"))(folder)

    return both


def _dated_with_gap(folder: Path) -> None:
    columns = columns_of(folder)
    ticks = np.round(columns["time_s"] * 1e6).astype("timedelta64[us]")
    frame = pd.DataFrame(_without_clock(columns), index=START + ticks)
    frame.drop(frame.index[500:647]).to_parquet(folder / "raw.parquet")


def _late(name: str) -> dict[str, Any]:
    late = np.timedelta64(20 if name.startswith("P31") else 0, "ms")
    return {"wf_increment": 1e-3, "wf_start_time": START + late}


def _offset(name: str) -> dict[str, Any]:
    return {"wf_increment": 1e-3, "wf_start_offset": 0.02 if name.startswith("P31") else 0.0}


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
    _row(TDMS, "skew", "plane 31 starts 20 ms later, as wf_start_time says", SKEW, _tdms(_late)),
    _row(
        TDMS,
        "skew-from-rate",
        'plane 31 starts 20 ms later by wf_start_offset, and test.toml says clock = "from rate"',
        SKEW,
        _from_rate(_tdms(_offset)),
    ),
    _row(
        TDMS,
        "half-rate",
        'wf_increment is that of half the rate, and test.toml says clock = "from rate"',
        ("1000 samples", "500", "wf_increment", "sample_rate_hz"),
        _from_rate(_tdms(lambda _: {"wf_increment": 2e-3})),
    ),
    _row(
        TDMS,
        "groups",
        "the thermocouples lie in another group, at a tenth of the rate",
        ("T25_A", "group 'slow'", "201 values", "2001", "resample", "[file]"),
        _two_groups,
    ),
    _row(
        PARQUET,
        "passed-over-gap",
        'the timestamps have a gap, and test.toml says clock = "from rate"',
        ("a step of 0.148", "row 501", "rows are missing"),
        _from_rate(_dated_with_gap),
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
