"""Mistakes in the feed of a running test, which `live` takes row by row."""

from __future__ import annotations

from mistake import FLAGGED, HARMLESS, REFUSED, Mistake, Outcome, Spoil
from mistakes_raw_files import NOISE
from spoiling import as_bytes, as_lines, as_text, at_rows, cell, channel, table, toml, written

__all__ = ["LIVE", "LIVE_COMMAND"]

PROBE = "P31_B_hub_aft"
LIVE_COMMAND = "live - --test test.toml -o reduced.csv --no-estimate --quiet"


def _feed(
    id_: str, did: str, outcome: Outcome, says: tuple[str, ...], spoil: Spoil, why: str = ""
) -> Mistake:
    within = (1e-9, 1e-9) if outcome == HARMLESS else None
    return Mistake(f"live-{id_}", did, outcome, says, LIVE_COMMAND, why, within, spoil, "raw.csv")


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
        "a reading of the feed is NaN: what follows has no near-stall part",
        REFUSED,
        ("[near_stall]", "0.812", "kept"),
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
        "the clock of the feed runs back: what follows has no near-stall part",
        REFUSED,
        ("[near_stall]", "0.812", "kept"),
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
)
