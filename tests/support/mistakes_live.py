"""Mistakes in the feed of a running test, which `live` takes row by row."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mistake import FLAGGED, HARMLESS, REFUSED, Mistake, Outcome, Spoil
from mistakes_raw_files import NOISE
from spoiling import as_bytes, as_lines, as_text, at_rows, cell, channel, table, toml, written

from comparisons.live.frames import columns_frame, end_frame, rows_frame

__all__ = ["LIVE", "LIVE_COMMAND"]

PROBE = "P31_B_hub_aft"
LIVE_COMMAND = "live - --test test.toml -o reduced.csv --no-estimate --quiet"
BINARY_COMMAND = f"{LIVE_COMMAND} --format binary"


def _feed(
    id_: str,
    did: str,
    outcome: Outcome,
    says: tuple[str, ...],
    spoil: Spoil,
    why: str = "",
    command: str = LIVE_COMMAND,
) -> Mistake:
    within = (1e-9, 1e-9) if outcome == HARMLESS else None
    return Mistake(f"live-{id_}", did, outcome, says, command, why, within, spoil, "raw.csv")


def _frames(change: Callable[[bytes], bytes] = lambda frame: frame, type_: str = "f8") -> Spoil:
    """Turn the record into frames of the binary format, with the first of them spoiled."""

    def spoil(folder: Path) -> None:
        file = folder / "raw.csv"
        names = file.read_text("utf-8").split("\n", 1)[0].split(",")
        columns = dict.fromkeys(names, "f8")
        rows = np.loadtxt(file, delimiter=",", skiprows=1)
        starts = range(0, len(rows), 50)
        frames = [rows_frame(columns, rows[s : s + 50], i + 1) for i, s in enumerate(starts)]
        begin = columns_frame({**columns, names[-1]: type_})
        file.write_bytes(b"".join([change(begin), *frames, end_frame(len(frames) + 1)]))

    return spoil


def _long_frame(folder: Path) -> None:
    _frames()(folder)
    file = folder / "raw.csv"
    data = file.read_bytes()
    # The first two frames are those of the columns and of the rows from 0 to 0.049 s.
    place = data.index(b"SSLV", 4) + 16
    file.write_bytes(data[:place] + (60_000).to_bytes(4, "little") + data[place + 4 :])


def _of_version_9(frame: bytes) -> bytes:
    body = frame[:4] + b"\x09" + frame[5:-4]
    return body + zlib.crc32(body).to_bytes(4, "little")


LIVE = (
    _feed("empty", "the feed ends before it begins", REFUSED, ("feed",), written("raw.csv", "")),
    _feed("noise", "the feed is binary noise", REFUSED, ("feed",), written("raw.csv", NOISE)),
    _feed(
        "header-only",
        "the feed ends behind its header",
        REFUSED,
        ("rows",),
        as_lines(lambda r: r[:1]),
    ),
    _feed(
        "50-rows",
        "the feed ends after 50 rows",
        REFUSED,
        ("100 rows", "50"),
        as_lines(lambda r: r[:51]),
    ),
    _feed("no-header", "the feed has no header", REFUSED, ("time_s",), as_lines(lambda r: r[1:])),
    _feed(
        "missing",
        "the feed lacks a channel",
        REFUSED,
        ("the feed", PROBE, "no such column", "a dead probe is left out with its mate"),
        table(lambda t: t.drop(columns=PROBE)),
    ),
    _feed(
        "renamed",
        "the feed has another name for a channel",
        REFUSED,
        ("the feed", PROBE, "no such column", f'column = "{PROBE.lower()}"'),
        table(lambda t: t.rename(columns={PROBE: PROBE.lower()})),
    ),
    _feed(
        "extra",
        "the feed has a column that nobody described",
        REFUSED,
        ("the feed", "oil_bar", "[channels.oil_bar]", 'other_columns = "ignore"'),
        table(lambda t: t.assign(oil_bar=3.0)),
    ),
    _feed(
        "toml",
        "test.toml lacks a calibration",
        REFUSED,
        ("test.toml", PROBE, "zero_count"),
        toml((f"channels/{PROBE}/zero_count", ...)),
    ),
    _feed(
        "shifts",
        "test.toml states the near-stall shift of an aft probe",
        REFUSED,
        ("test.toml", "[near_stall_shifts]", PROBE, "forward mate"),
        toml((f"near_stall_shifts/{PROBE}", 12.5)),
    ),
    _feed(
        "rate",
        "the feed comes at another rate than test.toml says",
        REFUSED,
        ("[test] sample_rate_hz", "1000 Hz", "time_s", "500 Hz", "write sample_rate_hz = 1000"),
        toml(("test/sample_rate_hz", 500.0)),
    ),
    _feed(
        "rate-slower",
        "the feed comes half as fast as test.toml says",
        REFUSED,
        ("[test] sample_rate_hz", "1000 Hz", "2000 Hz", "write sample_rate_hz = 1000"),
        toml(("test/sample_rate_hz", 2000.0)),
    ),
    _feed(
        "rate-near",
        "the rate of the feed is 1 % off that of test.toml",
        REFUSED,
        ("sample_rate_hz", "1010", "1000", "write sample_rate_hz = 1000", "kept"),
        toml(("test/sample_rate_hz", 1010.0)),
    ),
    _feed(
        "milliseconds",
        "the clock of the feed is in milliseconds",
        REFUSED,
        ("sample_rate_hz", 'time_unit = "ms"'),
        channel("time_s", lambda v: 1e3 * v),
    ),
    _feed(
        "no-surge",
        "the feed ends before the surge",
        REFUSED,
        ("no surge",),
        as_lines(lambda r: r[:280]),
    ),
    _feed("cut", "the last row of the feed is cut", FLAGGED, ("1",), as_text(lambda t: t[:-40])),
    _feed(
        "nan",
        "a reading of the feed is NaN: what follows has no near-stall part of its own",
        FLAGGED,
        ("matched by that of piece 1",),
        cell(PROBE, 812, "nan"),
    ),
    _feed(
        "text",
        "a row of the feed is a message of the logger",
        FLAGGED,
        ("1",),
        as_lines(lambda r: [*r[:812], "buffer overrun", *r[812:]]),
    ),
    _feed(
        "back",
        "the clock of the feed runs back for a row: what follows has no near-stall part of its own",
        FLAGGED,
        ("matched by that of piece 1",),
        channel("time_s", at_rows(slice(811, 812), 0.5)),
    ),
    _feed(
        "twice",
        "a block of rows comes twice",
        HARMLESS,
        (),
        as_lines(lambda r: [*r[:1100], *r[1000:]]),
        "rows that were had already are dropped",
    ),
    _feed(
        "crlf",
        "the lines of the feed end as on Windows",
        HARMLESS,
        (),
        as_bytes(lambda d: d.replace(b"\n", b"\r\n")),
        "both ends of line are read",
    ),
    _feed(
        "csv-as-binary",
        "the feed is CSV, and the session was told of frames",
        REFUSED,
        ("the feed", "no frame", "leave out --format binary"),
        as_text(lambda t: t),
        command=BINARY_COMMAND,
    ),
    _feed(
        "binary-as-csv",
        "the feed is of frames, and the session was not told so",
        REFUSED,
        ("the feed", "binary frames", "use --format binary"),
        _frames(),
    ),
    _feed(
        "binary-version",
        "the frames of the feed are of another version",
        REFUSED,
        ("version is 9", "send frames of version 1"),
        _frames(_of_version_9),
        command=BINARY_COMMAND,
    ),
    _feed(
        "binary-type",
        "a column of the binary feed is of a type that there is not",
        REFUSED,
        ("T31_B", "'q9'", "write one of f8"),
        _frames(type_="q9"),
        command=BINARY_COMMAND,
    ),
    _feed(
        "binary-length",
        "the first frame of rows claims to be longer than it is",
        FLAGGED,
        ("damaged bytes between two frames",),
        _long_frame,
        command=BINARY_COMMAND,
    ),
)
