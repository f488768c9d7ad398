"""The command `sindy-surge live`: what is typed."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from comparisons.cli.command import Command
from comparisons.cli.options import REDUCTION, argument, number, whole

_BEHAVIOUR = """\
While it runs, the operating point comes from pressures behind a causal low-pass (48 Hz, about 7 ms
late). Surge is reported when the flow at plane 25 has run backwards for 3 ms, some 12 ms after the
machine itself; the time constant is that of `reduce` and `compare` over the last half minute.

Rows whose clock was had are dropped, what is no row is counted and left out. Where rows are missing
the record goes on as a new piece, matched by the near-stall reading of the first one. The longest
piece is reduced; the rows of all are kept beside it.

The run ends with the input, with the end mark of the format, after --timeout, or with Ctrl-C or
SIGTERM; then the rows are reduced as `reduce` would with the same options. They are on disk all the
time: after a crash, reduce that file.

The feed is lines of text, as `cat raw.csv` gives them. The first line of every connection holds the
names of the columns, the second one may hold their units, every further one a row of plain decimal
numbers. Between them stand commas, semicolons or tabs; beside the latter two a comma may be the
decimal sign. Lines that begin with # count for nothing, but for "#end", which ends
the run."""


def _add_source(parser: argparse.ArgumentParser) -> None:
    """Add where the rows come from, and the options of the reduction as a group."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "input", nargs="?", choices=("-",), metavar="-", help="read the standard input"
    )
    source.add_argument(
        "--listen",
        type=_address,
        metavar="[HOST:]PORT",
        help="wait for a sender here, and again when it is gone (default host: 127.0.0.1; "
        "on another address any machine that reaches it can send)",
    )
    source.add_argument("--unix", type=Path, metavar="PATH", help="wait on a Unix socket")
    words = "for the running estimate and for the series at the end"
    group = parser.add_argument_group("options of `reduce`", words)
    for each in REDUCTION:
        group.add_argument(*each.flags, **each.details)


def _address(text: str) -> tuple[str, int]:
    """Return host and port of ``[HOST:]PORT``; the host is this machine without one."""
    host, _, port = text.rpartition(":")
    try:
        return host.strip("[]") or "127.0.0.1", whole(0, 65_535)(port)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(f"expected HOST:PORT or PORT, found {text!r}") from None


def _seconds(text: str) -> float:
    if (value := number(text)) <= 0.0:
        raise argparse.ArgumentTypeError(f"expected seconds above 0, found {text!r}")
    return value


LIVE = Command(
    "live",
    help="follow a test as it runs, and reduce it at the end",
    description="Take the rows of a running test from a pipe or a socket, show operating point, "
    "surge and a running estimate, and end with the series that `reduce` gives.",
    arguments=(
        argument("--test", type=Path, required=True, help="description of the test (.toml)"),
        argument(
            "-o",
            "--out",
            type=Path,
            metavar="SERIES",
            help="series (.csv or .nc; default: live-DATE-TIME.csv)",
        ),
        argument("--raw", type=Path, metavar="FILE.csv", help="keep the raw record here"),
        argument(
            "--timeout",
            type=_seconds,
            default=math.inf,
            metavar="S",
            help="end the run after so long without a row (default: wait)",
        ),
        argument(
            "--page",
            type=whole(0, 65535),
            metavar="PORT",
            help="show a page on 127.0.0.1 (0: any free port)",
        ),
        argument("--quiet", action="store_true", help="say nothing but errors"),
    ),
    add=_add_source,
    more=_BEHAVIOUR,
)
