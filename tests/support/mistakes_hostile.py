"""Text in data files that another program would take for a command: it must stay text."""

from __future__ import annotations

import os
from pathlib import Path

from mistake import HARMLESS, REDUCE, REFUSED, Mistake, Spoil
from spoiling import as_lines, as_text, cell, named, replaced, toml, written

__all__ = ["HOSTILE", "SCRIPT"]

SCRIPT = "<script>alert(1)</script>"
# Clears the screen and rings, in a terminal that believes it.
ESCAPE = "\x1b[2J\x07\x1b]0;owned\x07"
PROBE = "P31_B_hub_aft"
SAME = (1e-9, 1e-9)
REPORT = f"{REDUCE} --report report.html"
RUN = "reconstruct model.json series.csv -o again.csv --report report.html"


def _renamed(name: str) -> Spoil:
    """Give a probe another name in both files."""

    def spoil(folder: Path) -> None:
        named({PROBE: name})(folder)
        toml(("channels", lambda t: {name if k == PROBE else k: v for k, v in t.items()}))(folder)

    return spoil


def _described(name: str) -> Spoil:
    """Give a probe another name in test.toml alone, so that the table lacks it."""
    return toml(("channels", lambda t: {name if k == PROBE else k: v for k, v in t.items()}))


def _pipe(folder: Path) -> None:
    (folder / "raw.csv").unlink()
    os.mkfifo(folder / "raw.csv")


HOSTILE = (
    Mistake(
        "hostile-channel-script",
        "a channel is called like a script that closes what it stands in",
        HARMLESS,
        (),
        REPORT,
        "names are escaped in the report",
        SAME,
        _renamed(f"'><img src=x onerror=alert(1)>{SCRIPT}"),
    ),
    Mistake(
        "hostile-channel-path",
        "a channel's name is a path",
        HARMLESS,
        (),
        REDUCE,
        "no file is called like a channel",
        SAME,
        _renamed("../../P31"),
    ),
    Mistake(
        "hostile-test-script",
        "the test is called like a script",
        HARMLESS,
        (),
        REPORT,
        "names are escaped in the report",
        SAME,
        toml(("test/name", f"</title>{SCRIPT}")),
    ),
    Mistake(
        "hostile-test-formula",
        "the test is called like a formula of a spreadsheet",
        HARMLESS,
        (),
        REDUCE,
        "no table that is written holds the name",
        SAME,
        toml(("test/name", "=cmd|'/C calc'!A0")),
    ),
    Mistake(
        "hostile-test-escape",
        "the name of the test would clear the screen",
        REFUSED,
        ("test.toml", "[test]", "name", "one line"),
        REDUCE,
        spoil=toml(("test/name", f"E3{ESCAPE}")),
    ),
    Mistake(
        "hostile-test-lines",
        "the name of the test has two lines",
        REFUSED,
        ("test.toml", "[test]", "name", "one line"),
        REDUCE,
        spoil=toml(("test/name", "E3\nsindy-surge: all is well")),
    ),
    Mistake(
        "hostile-rake",
        "a rake is called like a script that would clear the screen",
        REFUSED,
        ("test.toml", "rake", "one line"),
        REDUCE,
        spoil=toml((f"channels/{PROBE}/rake", SCRIPT + "\n" + ESCAPE)),
    ),
    Mistake(
        "hostile-channel-escape",
        "the name of a channel would clear the screen",
        REFUSED,
        ("test.toml", "[channels]", "control characters"),
        REDUCE,
        spoil=_described(f"P31{ESCAPE}\nsindy-surge: done"),
    ),
    Mistake(
        "hostile-channel-long",
        "a channel that the table lacks has a name of ten thousand letters",
        REFUSED,
        ("raw.csv", "PPP"),
        REDUCE,
        spoil=_described("P" * 10_000),
    ),
    Mistake(
        "hostile-column-escape",
        "a column without a description has a name that would clear the screen",
        REFUSED,
        ("raw.csv",),
        REDUCE,
        spoil=as_lines(lambda rows: [f"{rows[0]},x{ESCAPE}", *(row + ",1" for row in rows[1:])]),
    ),
    Mistake(
        "hostile-cell-escape",
        "a cell would clear the screen",
        REFUSED,
        ("raw.csv", PROBE, "row 812"),
        REDUCE,
        spoil=cell(PROBE, 812, ESCAPE),
    ),
    Mistake(
        "hostile-cell-long",
        "a cell has a million letters",
        REFUSED,
        ("raw.csv", PROBE, "row 812"),
        REDUCE,
        spoil=cell(PROBE, 812, "9e" * 500_000),
    ),
    Mistake(
        "hostile-cell-digits",
        "a cell has a million digits",
        REFUSED,
        ("raw.csv", PROBE, "row 812"),
        REDUCE,
        spoil=cell(PROBE, 812, "9" * 1_000_000),
    ),
    Mistake(
        "hostile-key",
        "a key would clear the screen",
        REFUSED,
        ("test.toml",),
        REDUCE,
        spoil=toml((f"adc/bits{ESCAPE}\n", 12)),
    ),
    Mistake(
        "hostile-value-long",
        "a value has a million letters",
        REFUSED,
        ("test.toml", "gamma"),
        REDUCE,
        spoil=toml(("compressor/gamma", "x" * 1_000_000)),
    ),
    Mistake(
        "hostile-value-list",
        "a value is a list of a million numbers",
        REFUSED,
        ("test.toml", "gamma"),
        REDUCE,
        spoil=replaced("gamma = 1.4", "gamma = [" + "1," * 1_000_000 + "]", "test.toml"),
    ),
    Mistake(
        "hostile-file-name",
        "a file is called with a line break",
        REFUSED,
        ("no such file",),
        REDUCE.replace("raw.csv", "'raw\nsindy-surge: done.csv'"),
    ),
    Mistake(
        "hostile-series-cell",
        "a cell of a series would clear the screen",
        REFUSED,
        ("series.csv", "phi", "row 500"),
        "compare series.csv",
        spoil=cell("phi", 500, ESCAPE, "series.csv"),
    ),
    Mistake(
        "hostile-series-header",
        "the columns of a series have names of a million letters",
        REFUSED,
        ("series.csv", "time_s"),
        "compare series.csv",
        spoil=as_lines(
            lambda rows: [rows[0].replace("time_s", "t" * 1_000_000), *rows[1:]], "series.csv"
        ),
    ),
    Mistake(
        "hostile-ledger",
        "the ledger of a series holds a script",
        HARMLESS,
        (),
        RUN,
        "words are escaped in the report",
        spoil=as_text(lambda t: t.replace("calibrate", SCRIPT), "series.ledger.json"),
    ),
    Mistake(
        "hostile-model",
        "the estimator of a saved model is called like a script",
        HARMLESS,
        (),
        RUN,
        "names are escaped in the report and on the terminal",
        spoil=as_text(lambda t: t.replace("classic_ml", SCRIPT + "\\u001b[2J"), "model.json"),
    ),
    Mistake(
        "hostile-formula",
        "the table begins with a formula of a spreadsheet",
        REFUSED,
        ("raw.csv",),
        REDUCE,
        spoil=written("raw.csv", "=1+1,@SUM(A1)\n1,2\n"),
    ),
    Mistake(
        "hostile-pipe",
        "the raw record is a pipe that nobody fills",
        REFUSED,
        ("raw.csv", "pipe"),
        REDUCE,
        spoil=_pipe,
    ),
)
