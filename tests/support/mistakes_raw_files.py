"""Mistakes in the file of a raw record: no table, another table, a table that was damaged."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
from mistake import HARMLESS, REDUCE, REFUSED, Mistake, Spoil
from spoiling import as_bytes, as_lines, as_text, cell, lines, named, table, toml, written
from stored_records import write_stored

__all__ = ["RAW_FILES"]

PROBE = "P31_B_hub_aft"
SAME = (1e-9, 1e-9)
NOISE = np.random.default_rng(7).bytes(20_000)


def png() -> bytes:
    """Return a picture of one pixel."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0)
    pixel = chunk(b"IDAT", zlib.compress(b"\0\0"))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + pixel + chunk(b"IEND", b"")


def workbook() -> bytes:
    """Return what a spreadsheet program saves: a zip of XML."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("xl/worksheets/sheet1.xml", "<worksheet/>")
    return out.getvalue()


def _decimal_commas(row: str) -> str:
    return row.replace(",", ";").replace(".", ",")


def _half_row(text: str) -> str:
    return text[: text.rindex("\n", 0, len(text) * 2 // 3) + 40]


def _short_row(rows: list[str]) -> list[str]:
    return [*rows[:812], rows[812].rsplit(",", 1)[0], *rows[813:]]


def _quoted(row: str) -> str:
    return ",".join(f'"{text}"' for text in row.split(","))


def _units_below(rows: list[str]) -> list[str]:
    return [rows[0], ",".join("count" for _ in rows[0].split(",")), *rows[1:]]


def _both(*spoils: Spoil) -> Spoil:
    def spoil(folder: Path) -> None:
        for one in spoils:
            one(folder)

    return spoil


def _ignoring(name: str) -> Spoil:
    header = as_lines(lambda rows: [f"{rows[0]},{name}", *rows[1:]])
    return _both(header, toml(("file/other_columns", "ignore")))


def _stamped(row: str) -> str:
    time_s, rest = row.split(",", 1)
    return (
        f"2026-01-01T23:59:{58.5 + float(time_s):06.3f},{rest}"
        if float(time_s) < 1.5
        else (f"2026-01-02T00:00:{float(time_s) - 1.5:06.3f},{rest}")
    )


def _hdf5_as_csv(folder: Path) -> None:
    write_stored(folder, ".h5").replace(folder / "raw.csv")


def _folder_for_file(folder: Path) -> None:
    (folder / "raw.csv").unlink()
    (folder / "raw.csv").mkdir()


def _hexadecimal(rows: list[str]) -> list[str]:
    at = rows[0].split(",").index(PROBE)

    def change(row: str) -> str:
        cells = row.split(",")
        cells[at] = "0x7ff"
        return ",".join(cells)

    return [rows[0], *map(change, rows[1:])]


RAW_FILES = (
    Mistake(
        "raw-missing",
        "names a raw record that is not there",
        REFUSED,
        ("none.csv", "no such file"),
        REDUCE.replace("raw.csv", "none.csv"),
    ),
    Mistake(
        "raw-hdf5-as-csv",
        "an HDF5 file is named .csv",
        REFUSED,
        ("raw.csv", "an HDF5 file", "rename", ".h5"),
        spoil=_hdf5_as_csv,
    ),
    Mistake(
        "raw-folder",
        "gives a folder for the raw record",
        REFUSED,
        ("raw.csv", "a folder"),
        spoil=_folder_for_file,
    ),
    Mistake(
        "raw-suffix",
        "gives a raw record in a format that nobody reads",
        REFUSED,
        ("raw.dat", "suffix", ".csv"),
        REDUCE.replace("raw.csv", "raw.dat"),
        spoil=written("raw.dat", "time_s\n0\n"),
    ),
    Mistake(
        "raw-empty",
        "the file is empty",
        REFUSED,
        ("raw.csv", "empty"),
        spoil=written("raw.csv", ""),
    ),
    Mistake(
        "raw-header-only",
        "the table has a header and no row",
        REFUSED,
        ("raw.csv", "rows", "none"),
        spoil=as_lines(lambda rows: rows[:1]),
    ),
    Mistake(
        "raw-50-rows",
        "the record has 50 rows",
        REFUSED,
        ("raw.csv", "100 rows", "50"),
        spoil=as_lines(lambda rows: rows[:51]),
    ),
    Mistake(
        "raw-no-header",
        "the table has no header",
        REFUSED,
        ("raw.csv", "header", "time_s"),
        spoil=as_lines(lambda rows: rows[1:]),
    ),
    Mistake(
        "raw-noise",
        "the file is binary noise",
        REFUSED,
        ("raw.csv", "binary"),
        spoil=written("raw.csv", NOISE),
    ),
    Mistake(
        "raw-noise-within",
        "a stretch of the table was overwritten with binary noise",
        REFUSED,
        ("raw.csv", "row"),
        spoil=as_bytes(lambda data: data[:90_000] + NOISE[:4000] + data[94_000:]),
    ),
    Mistake(
        "raw-zeros-within",
        "a block of the disk was lost: zeros in the middle of the table",
        REFUSED,
        ("raw.csv", "row"),
        spoil=as_bytes(lambda data: data[:90_112] + b"\0" * 4096 + data[94_208:]),
    ),
    Mistake(
        "raw-png", "a picture is named .csv", REFUSED, ("raw.csv",), spoil=written("raw.csv", png())
    ),
    Mistake(
        "raw-workbook",
        "a spreadsheet's own format (.xlsx) is named .csv",
        REFUSED,
        ("raw.csv",),
        spoil=written("raw.csv", workbook()),
    ),
    Mistake(
        "raw-utf16",
        "the table is saved as UTF-16 (“Unicode text”)",
        REFUSED,
        ("raw.csv", "UTF-16", "UTF-8"),
        spoil=as_bytes(lambda data: data.decode().encode("utf-16")),
    ),
    Mistake(
        "raw-latin1",
        "the header has a degree sign in another encoding than UTF-8",
        REFUSED,
        ("raw.csv", "T25_A", "[°K]"),
        spoil=as_bytes(lambda data: data.replace(b"T25_A", b"T25_A [\xb0K]", 1)),
    ),
    Mistake(
        "raw-bom",
        "the table begins with a byte-order mark, as Windows programs write it",
        HARMLESS,
        within=SAME,
        why="the mark is skipped",
        spoil=as_bytes(lambda data: b"\xef\xbb\xbf" + data),
    ),
    Mistake(
        "raw-crlf",
        "the lines end as on Windows",
        HARMLESS,
        within=SAME,
        why="both ends of line are read",
        spoil=as_text(lambda text: text.replace("\n", "\r\n")),
    ),
    Mistake(
        "raw-spaces",
        "there are spaces after the commas",
        HARMLESS,
        within=SAME,
        why="spaces around names and numbers do not count",
        spoil=as_text(lambda text: text.replace(",", ", ")),
    ),
    Mistake(
        "raw-quotes",
        "all cells are in quotation marks",
        HARMLESS,
        within=SAME,
        why="quotation marks around names and numbers do not count",
        spoil=as_lines(lambda rows: list(map(_quoted, rows))),
    ),
    Mistake(
        "raw-blank-end",
        "there are empty lines below the table",
        HARMLESS,
        within=SAME,
        why="empty lines do not count",
        spoil=as_text(lambda text: text + "\n\n"),
    ),
    Mistake(
        "raw-shuffled",
        "the columns are in another order than in test.toml",
        HARMLESS,
        within=SAME,
        why="columns go by their names",
        spoil=table(lambda t: t[list(t.columns[::-1])]),
    ),
    Mistake(
        "raw-semicolons",
        "the table has semicolons between and commas in its numbers (European spreadsheet)",
        HARMLESS,
        within=SAME,
        why="beside semicolons or tabs a comma is the decimal sign",
        spoil=as_lines(lambda rows: list(map(_decimal_commas, rows))),
    ),
    Mistake(
        "raw-two-decimal-signs",
        "the table has semicolons between, and commas in some of its numbers",
        REFUSED,
        ("raw.csv", "one decimal sign", "'0,0'"),
        spoil=_both(
            as_text(lambda text: text.replace(",", ";")),
            lines(lambda row: row.replace(".", ",", 1)),
        ),
    ),
    Mistake(
        "raw-tabs",
        "the table has tabs between its columns",
        HARMLESS,
        within=SAME,
        why="tabs are read as commas are",
        spoil=as_text(lambda text: text.replace(",", "\t")),
    ),
    Mistake(
        "raw-carriage-returns",
        "the lines end in carriage returns alone (old Macintosh)",
        HARMLESS,
        within=SAME,
        why="they are ends of lines too",
        spoil=as_bytes(lambda data: data.replace(b"\n", b"\r")),
    ),
    Mistake(
        "raw-remarks",
        'a column holds remarks, and test.toml says other_columns = "ignore"',
        HARMLESS,
        within=SAME,
        why="what nobody asks for is not looked at",
        spoil=_both(lines(lambda row: row + ',"warm, ok"'), _ignoring("Note")),
    ),
    Mistake(
        "raw-stamps",
        "the clock is a date and a time of day after ISO 8601, and test.toml names it",
        HARMLESS,
        within=SAME,
        why="dates count from the first row, in whole nanoseconds",
        spoil=_both(lines(_stamped), named({"time_s": "Stamp"}), toml(("file/time", "Stamp"))),
    ),
    Mistake(
        "raw-stamp-broken",
        "the clock is a date and a time of day, and one of them is none",
        REFUSED,
        ("raw.csv", "Stamp", "date", "row 500", "24:61"),
        spoil=_both(
            lines(_stamped),
            named({"time_s": "Stamp"}),
            toml(("file/time", "Stamp")),
            cell("Stamp", 500, "2026-01-01T24:61:00"),
        ),
    ),
    Mistake(
        "raw-decimal-commas",
        "the clock has decimal commas, the columns are separated by commas too",
        REFUSED,
        ("raw.csv", "21 values", "row 1"),
        spoil=lines(lambda row: row.replace(".", ",", 1)),
    ),
    Mistake(
        "raw-trailing-commas",
        "every row ends with a comma",
        REFUSED,
        ("raw.csv", "row 1"),
        spoil=lines(lambda row: row + ","),
    ),
    Mistake(
        "raw-unnamed-column",
        "header and rows end with a comma",
        REFUSED,
        ("raw.csv", "name", "22"),
        spoil=as_lines(lambda rows: [row + "," for row in rows]),
    ),
    Mistake(
        "raw-units-row",
        "a row of units stands below the header",
        REFUSED,
        ("raw.csv", "time_s", "unit of time"),
        spoil=as_lines(_units_below),
    ),
    Mistake(
        "raw-text-cell",
        "a cell holds a word of the acquisition system",
        REFUSED,
        ("raw.csv", PROBE, "'OVRFL'", "row 812"),
        spoil=cell(PROBE, 812, "OVRFL"),
    ),
    Mistake(
        "raw-nan",
        "a reading is NaN",
        REFUSED,
        (PROBE, "finite", "row 812"),
        spoil=cell(PROBE, 812, "nan"),
    ),
    Mistake(
        "raw-inf",
        "a reading is infinite",
        REFUSED,
        (PROBE, "finite", "row 812"),
        spoil=cell(PROBE, 812, "-inf"),
    ),
    Mistake(
        "raw-huge",
        "a reading is too large for a number (1e999)",
        REFUSED,
        (PROBE, "row 812"),
        spoil=cell(PROBE, 812, "1e999"),
    ),
    Mistake(
        "raw-empty-cell",
        "a cell is empty",
        REFUSED,
        (PROBE, "empty", "row 812"),
        spoil=cell(PROBE, 812, ""),
    ),
    Mistake(
        "raw-hexadecimal",
        "the codes are written in hexadecimal",
        REFUSED,
        (PROBE, "0x7ff", "row 1"),
        spoil=as_lines(_hexadecimal),
    ),
    Mistake(
        "raw-short-row",
        "a row lacks its last value",
        REFUSED,
        ("raw.csv", "21 values", "20 in row 812"),
        spoil=as_lines(_short_row),
    ),
    Mistake(
        "raw-cut",
        "the file ends in the middle of a row",
        REFUSED,
        ("raw.csv", "21 values", "cut short"),
        spoil=as_text(_half_row),
    ),
    Mistake(
        "raw-two-headers",
        "two records were put behind each other, the second with its header",
        REFUSED,
        ("raw.csv", "time_s", "row 2002"),
        spoil=as_lines(lambda rows: rows + rows),
    ),
    Mistake(
        "raw-channel-missing",
        "a channel of test.toml is not in the table",
        REFUSED,
        ("raw.csv", PROBE, "no such column", "test.toml"),
        spoil=table(lambda t: t.drop(columns=PROBE)),
    ),
    Mistake(
        "raw-channel-extra",
        "the table has a channel that test.toml does not describe",
        REFUSED,
        ("raw.csv", "PS3", "test.toml"),
        spoil=table(lambda t: t.assign(PS3=2048)),
    ),
    Mistake(
        "raw-channel-twice",
        "a channel is in the table twice",
        REFUSED,
        ("raw.csv", PROBE, "2 times"),
        spoil=named({"P31_B_hub_forward": PROBE}),
    ),
    Mistake(
        "raw-case",
        "the channels are in lower case in the table",
        REFUSED,
        ("raw.csv", "P25_A_tip_forward", "p25_a_tip_forward"),
        spoil=as_lines(lambda rows: [rows[0].lower(), *rows[1:]]),
    ),
    Mistake(
        "raw-clock-missing",
        "the clock is called Time",
        REFUSED,
        ("raw.csv", "time_s", "Time"),
        spoil=named({"time_s": "Time"}),
    ),
)
