"""Mistakes in series files, in their ledgers, and in records that do not go together."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mistake import FLAGGED, HARMLESS, REFUSED, Mistake, Spoil
from mistakes_raw_files import NOISE, png
from spoiling import as_bytes, as_lines, as_text, at_rows, cell, channel, table, written

__all__ = ["LEDGERS", "NETCDF", "SERIES"]

FILE = "series.csv"
COMPARE = "compare series.csv --json numbers.json"
RUN = "reconstruct model.json series.csv -o again.csv"
NET = "compare series.nc --json numbers.json"
LEDGER = "series.ledger.json"


def _one(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    return channel(name, change, FILE)


def _refused(id_: str, did: str, says: tuple[str, ...], spoil: Spoil) -> Mistake:
    return Mistake(f"series-{id_}", did, REFUSED, ("series.csv", *says), COMPARE, spoil=spoil)


def _cut(text: str) -> str:
    end = -1
    for _ in range(1001):
        end = text.index("\n", end + 1)
    return text[: end - 30]


def _words(rows: list[str]) -> list[str]:
    at = rows[0].split(",").index("in_stall")
    cells = [row.split(",") for row in rows[1:]]
    for row in cells:
        row[at] = "TRUE" if row[at] == "1" else "FALSE"
    return [rows[0], *(",".join(row) for row in cells)]


def _european(text: str) -> str:
    return text.replace(",", ";").replace(".", ",")


def _thousands(text: str) -> str:
    rows = text.splitlines()
    at = rows[0].split(",").index("psi_p")
    rows = _european(text).splitlines()
    cells = rows[500].split(";")
    cells[at] = "1.234,5"
    return "\n".join([*rows[:500], ";".join(cells), *rows[501:]]) + "\n"


def _copied(folder: Path) -> None:
    (folder / "again.csv").write_bytes((folder / "series.csv").read_bytes())


def _slower(folder: Path) -> None:
    rows = (folder / FILE).read_text("utf-8").splitlines()
    (folder / "slow.csv").write_text("\n".join([rows[0], *rows[1::2]]) + "\n", "utf-8")


SERIES = (
    Mistake(
        "series-missing",
        "names a series that is not there",
        REFUSED,
        ("none.csv", "no such file"),
        "compare none.csv",
    ),
    Mistake(
        "series-suffix",
        "gives a series in a format that nobody reads",
        REFUSED,
        ("series.xlsx", "suffix", ".csv"),
        "compare series.xlsx",
        spoil=written("series.xlsx", b"PK\3\4"),
    ),
    Mistake(
        "series-is-raw",
        "gives the raw record for the series",
        REFUSED,
        ("raw.csv", "phi", "reduce"),
        "compare raw.csv",
    ),
    Mistake(
        "series-is-report",
        "gives a folder for the series",
        REFUSED,
        ("folder",),
        "compare .",
    ),
    _refused("empty", "the file is empty", ("empty",), written(FILE, "")),
    _refused("header-only", "there is no row", ("100 rows", "0"), as_lines(lambda r: r[:1], FILE)),
    _refused("99-rows", "there are 99 rows", ("100 rows", "99"), as_lines(lambda r: r[:100], FILE)),
    _refused("noise", "the file is binary noise", ("CSV",), written(FILE, NOISE)),
    _refused("png", "a picture is named .csv", ("CSV",), written(FILE, png())),
    _refused(
        "utf16",
        "the table is saved as UTF-16",
        ("UTF-8",),
        as_bytes(lambda data: data.decode().encode("utf-16"), FILE),
    ),
    _refused(
        "cut",
        "the file ends in the middle of a row",
        ("row 1000",),
        as_text(_cut, FILE),
    ),
    _refused(
        "short-row",
        "a row in the middle lacks its last values",
        ("row 700",),
        as_lines(lambda r: [*r[:700], r[700].rsplit(",", 3)[0], *r[701:]], FILE),
    ),
    _refused(
        "long-row",
        "a row has a value too many",
        ("row 700",),
        as_lines(lambda r: [*r[:700], r[700] + ",1.0", *r[701:]], FILE),
    ),
    _refused(
        "column-missing",
        "there is no ψ'",
        ("psi_p",),
        table(lambda t: t.drop(columns="psi_p"), FILE),
    ),
    _refused(
        "time",
        "the clock is called time",
        ("time_s", "rename"),
        as_lines(lambda r: [r[0].replace("time_s", "time"), *r[1:]], FILE),
    ),
    _refused(
        "ms",
        "the clock is in milliseconds",
        ("time_s", "0.05 s", "in ms?", "1000"),
        _one("time_s", lambda t: 1e3 * t),
    ),
    _refused(
        "column-twice",
        "φ is there twice",
        ("phi", "2 times"),
        as_lines(lambda r: [r[0].replace("psi,", "phi,"), *r[1:]], FILE),
    ),
    _refused(
        "two-decimal-signs",
        "semicolons between, commas in the numbers, and a point between the thousands of one",
        ("psi_p", "'1.234,5'", "row 500", "thousands"),
        as_text(_thousands, FILE),
    ),
    _refused(
        "text", "a cell holds a word", ("phi", "'n/a!'", "row 500"), cell("phi", 500, "n/a!", FILE)
    ),
    _refused(
        "nan", "a value is NaN", ("psi_p", "finite", "row 500"), cell("psi_p", 500, "NaN", FILE)
    ),
    _refused(
        "inf", "a value is infinite", ("phi", "finite", "row 500"), cell("phi", 500, "inf", FILE)
    ),
    _refused("huge", "a value is 1e999", ("phi", "row 500"), cell("phi", 500, "1e999", FILE)),
    _refused("empty-cell", "a cell is empty", ("phi", "row 500"), cell("phi", 500, "", FILE)),
    _refused(
        "gap",
        "rows are missing",
        ("time_s", "uniform step"),
        table(lambda t: t.drop(index=range(500, 520)), FILE),
    ),
    _refused(
        "repeats",
        "the clock repeats",
        ("time_s", "repeats", "row 501"),
        _one("time_s", at_rows(slice(500, 501), 0.499)),
    ),
    _refused(
        "back",
        "the clock runs back",
        ("time_s", "back", "row 501"),
        _one("time_s", at_rows(slice(500, 501), 0.1)),
    ),
    _refused(
        "phi-constant",
        "φ is constant",
        ("phi", "constant"),
        _one("phi", lambda v: np.full(v.size, 0.2)),
    ),
    _refused(
        "psi-constant",
        "ψ' is constant",
        ("psi_p", "constant"),
        _one("psi_p", lambda v: np.full(v.size, 2.0)),
    ),
    _refused(
        "psi-per-cent",
        "ψ' is in per cent",
        ("psi_p", "between"),
        _one("psi_p", lambda v: 100.0 * v),
    ),
    _refused(
        "phi-per-cent", "φ is in per cent", ("phi", "between"), _one("phi", lambda v: 100.0 * v)
    ),
    _refused(
        "exchanged",
        "φ and ψ' are exchanged",
        ("phi", "between"),
        as_lines(lambda r: [r[0].replace("phi,psi_p,", "psi_p,phi,"), *r[1:]], FILE),
    ),
    _refused("celsius", "T25 is in °C", ("T25_K", "between"), _one("T25_K", lambda v: v - 273.15)),
    _refused(
        "speed-rpm",
        "the corrected speed is in rpm",
        ("Nc_frac", "between"),
        _one("Nc_frac", lambda v: 12303.0 * v),
    ),
    _refused(
        "in-stall-2",
        "in_stall holds a 2",
        ("in_stall", "0 or 1", "2"),
        _one("in_stall", at_rows(slice(500, 501), 2.0)),
    ),
    _refused(
        "segment-fraction",
        "a label of a segment is a fraction",
        ("segment", "whole", "1.5"),
        _one("segment", at_rows(slice(900, 901), 1.5)),
    ),
    _refused(
        "segment-negative",
        "a label of a segment is negative",
        ("segment", "-1"),
        _one("segment", at_rows(slice(900, 901), -1.0)),
    ),
    _refused(
        "segment-none",
        "no row is in a segment",
        ("segment", "fitted"),
        _one("segment", np.zeros_like),
    ),
    _refused(
        "free-run-3",
        "free_run holds a 3",
        ("free_run", "between", "3"),
        _one("free_run", at_rows(slice(900, 901), 3.0)),
    ),
    Mistake(
        "series-labels-jump",
        "the labels of the segments jump (10, 30, 20)",
        HARMLESS,
        (),
        RUN,
        why="labels name intervals; their order does not count",
        spoil=_one("segment", lambda v: np.where(v > 0, 10 * (v * 7 % 11), 0)),
    ),
    Mistake(
        "series-bom",
        "the table begins with a byte-order mark",
        HARMLESS,
        (),
        RUN,
        why="the mark is skipped",
        spoil=as_bytes(lambda data: b"\xef\xbb\xbf" + data, FILE),
    ),
    Mistake(
        "series-semicolons",
        "semicolons between, commas in the numbers (European spreadsheet)",
        HARMLESS,
        (),
        RUN,
        why="beside semicolons or tabs a comma is the decimal sign",
        spoil=as_text(_european, FILE),
    ),
    Mistake(
        "series-crlf",
        "the lines end as on Windows",
        HARMLESS,
        (),
        RUN,
        why="both ends of line are read",
        spoil=as_text(lambda text: text.replace("\n", "\r\n"), FILE),
    ),
    Mistake(
        "series-true-false",
        "in_stall holds TRUE and FALSE",
        HARMLESS,
        (),
        RUN,
        why="a spreadsheet writes them so",
        spoil=as_lines(_words, FILE),
    ),
    Mistake(
        "series-twice",
        "the same series is given twice",
        REFUSED,
        ("series.csv", "twice"),
        "compare series.csv ./series.csv",
    ),
    *(
        Mistake(
            f"series-twice-{command}",
            f"the same series is given twice to {command}",
            REFUSED,
            ("again.csv", "twice", "series.csv", "leave one of them out"),
            f"{command} series.csv again.csv --json out.json",
            spoil=_copied,
        )
        for command in ("orders", "structure", "diagnose")
    ),
    Mistake(
        "series-rates",
        "two series have different sample rates",
        REFUSED,
        ("slow.csv", "sample"),
        "compare series.csv slow.csv",
        spoil=_slower,
    ),
)


def _ledger(change: Callable[[list[dict[str, object]]], object]) -> Spoil:
    return as_text(lambda text: json.dumps(change(json.loads(text))), LEDGER)


LEDGERS = (
    Mistake(
        "ledger-broken",
        "the ledger is cut short",
        REFUSED,
        (LEDGER, "ledger", "delete it or reduce"),
        RUN,
        spoil=as_text(lambda text: text[: len(text) // 2], LEDGER),
    ),
    Mistake(
        "ledger-noise",
        "the ledger is binary noise",
        REFUSED,
        (LEDGER, "ledger"),
        RUN,
        spoil=written(LEDGER, NOISE),
    ),
    Mistake(
        "ledger-other-json",
        "the ledger is another JSON file",
        REFUSED,
        (LEDGER, "ledger"),
        RUN,
        spoil=written(LEDGER, '{"schema": "sindy-surge/model/1"}'),
    ),
    Mistake(
        "ledger-types",
        "the ledger has other types",
        REFUSED,
        (LEDGER, "ledger"),
        RUN,
        spoil=_ledger(lambda entries: [{**e, "parameters": 3, "flags": None} for e in entries]),
    ),
    Mistake(
        "ledger-nested",
        "the ledger is nested a hundred thousand deep",
        REFUSED,
        (LEDGER, "ledger"),
        RUN,
        spoil=written(LEDGER, "[" * 100_000 + "]" * 100_000),
    ),
    Mistake(
        "ledger-other",
        "the ledger belongs to another record",
        FLAGGED,
        (LEDGER, "another record"),
        "compare series.csv",
        spoil=as_lines(lambda rows: rows[:1500], FILE),
    ),
)


def _netcdf(change: Callable[[Any], Any]) -> Spoil:
    """Write the series as netCDF after a change of its data set."""

    def spoil(folder: Path) -> None:
        import pandas as pd
        import xarray as xr

        read = pd.read_csv(folder / FILE)
        made = xr.Dataset(
            {n: ("time_s", read[n].to_numpy()) for n in read.columns if n != "time_s"}
        )
        data = made.assign_coords(time_s=read["time_s"].to_numpy())
        change(data).to_netcdf(folder / "series.nc", engine="h5netcdf")

    return spoil


def _cut_netcdf(folder: Path) -> None:
    _netcdf(lambda data: data)(folder)
    whole = (folder / "series.nc").read_bytes()
    (folder / "series.nc").write_bytes(whole[: len(whole) // 2])


def _endless(folder: Path) -> None:
    """Write a file of some kilobytes whose columns claim ten milliard rows."""
    import h5py

    with h5py.File(folder / "series.nc", "w") as file:
        for name in ("time_s", "phi", "psi_p"):
            made = file.create_dataset(name, shape=(10**10,), dtype="f8", chunks=(10**6,))
            made.make_scale(name) if name == "time_s" else made.dims[0].attach_scale(file["time_s"])


NETCDF = (
    Mistake(
        "netcdf-noise",
        "the file is no netCDF",
        REFUSED,
        ("series.nc", "netCDF"),
        NET,
        spoil=written("series.nc", NOISE),
    ),
    Mistake(
        "netcdf-csv",
        "a CSV file is named .nc",
        REFUSED,
        ("series.nc", "netCDF"),
        NET,
        spoil=written("series.nc", "time_s,phi\n0,1\n"),
    ),
    Mistake(
        "netcdf-empty",
        "the file is empty",
        REFUSED,
        ("series.nc",),
        NET,
        spoil=written("series.nc", b""),
    ),
    Mistake(
        "netcdf-cut",
        "the file is cut in half",
        REFUSED,
        ("series.nc", "netCDF"),
        NET,
        spoil=_cut_netcdf,
    ),
    Mistake(
        "netcdf-two-dimensional",
        "φ is a matrix",
        REFUSED,
        ("series.nc", "phi"),
        NET,
        spoil=_netcdf(lambda d: d.assign(phi=d["phi"].expand_dims(rake=2))),
    ),
    Mistake(
        "netcdf-text",
        "φ is text",
        REFUSED,
        ("series.nc", "phi"),
        NET,
        spoil=_netcdf(lambda d: d.assign(phi=d["phi"].astype(str).str.replace(".", "_"))),
    ),
    Mistake(
        "netcdf-complex",
        "φ is complex",
        REFUSED,
        ("series.nc", "phi"),
        NET,
        spoil=_netcdf(lambda d: d.assign(phi=d["phi"] + 1j)),
    ),
    Mistake(
        "netcdf-nan",
        "φ has a fill value",
        REFUSED,
        ("series.nc", "phi", "finite"),
        NET,
        spoil=_netcdf(lambda d: d.where(d["phi"] < 0.3)),
    ),
    Mistake(
        "netcdf-endless",
        "a small file claims ten milliard rows",
        REFUSED,
        ("series.nc", "memory"),
        NET,
        spoil=_endless,
    ),
)
