"""The command `sindy-surge live`: a test as it runs, and its reduction at the end."""

from __future__ import annotations

import argparse
import math
import signal
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from comparisons.cli.command import Command
from comparisons.cli.options import argument, number, whole
from comparisons.cli.reduce import (
    REDUCTION,
    SERIES_SUFFIXES,
    options_named,
    reduction_settings,
)
from surge_core.errors import InputError
from surge_core.files import check_apart, check_target

if TYPE_CHECKING:
    from comparisons.live.feeds import Feed

_BEHAVIOUR = """\
While it runs, the operating point comes from pressures behind a causal low-pass (48 Hz, about 7 ms
late). Surge is reported when the flow at plane 25 has run backwards for 3 ms, some 12 ms after the
machine itself; the time constant is that of `reduce` and `compare` over the last half minute.

Rows whose clock was had are dropped, what is no row is counted and left out. Where rows are missing
the record goes on as a new piece, matched by the near-stall reading of the first one. The longest
piece is reduced; the rows of all are kept beside it.

The run ends with the input, with the end mark of the format, after --timeout, or with Ctrl-C or
SIGTERM; then the rows are reduced as `reduce` would with the same options. They are on disk all the
time: after a crash, reduce that file."""


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
        each.add_to(group)


class _WithFormats(argparse.RawDescriptionHelpFormatter):
    """Show the format of the feed below the options; it is loaded only for that."""

    def format_help(self) -> str:
        from comparisons.live.rows import TEXT_FORMAT

        return f"{super().format_help()}\n{_BEHAVIOUR}\n\n{TEXT_FORMAT}\n"


def _run(given: argparse.Namespace) -> Iterable[str]:
    from classic_ml.io import read_test_description
    from classic_ml.io.series import write_series
    from classic_ml.records import ledger_lines
    from comparisons.live.display import Terminal
    from comparisons.live.monitor import Monitor
    from comparisons.live.page import Page
    from comparisons.live.pieces import Pieces, reduce_longest
    from comparisons.live.session import Session

    out, raw = _targets(given)
    test = read_test_description(given.test)
    with options_named():
        settings = reduction_settings(given)
    with TemporaryDirectory() as scratch, ExitStack() as ends:
        screens: list[Page | Terminal] = []
        if given.page is not None:
            screens.append(Page(given.page))
        if not given.quiet:
            screens.append(Terminal(sys.stdout))
        for screen in screens:
            ends.callback(screen.close)
        monitor = Monitor(test, settings, Path(scratch))
        session = Session(test, _feed(given), Pieces(raw), monitor, screens, given.timeout)
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            if hasattr(signal, name):
                before = signal.signal(getattr(signal, name), lambda which, _: session.stop(which))
                ends.callback(signal.signal, getattr(signal, name), before)
        for screen in screens:
            if isinstance(screen, Page):
                session.say(f"page: http://127.0.0.1:{screen.port}/")
        session.run()
        with options_named():
            pieces = session.pieces.pieces
            piece, reduction = reduce_longest(pieces, given.test, settings, session.entry())
            write_series(reduction.series, out)
        session.show("done")
    kept = given.raw is not None or len(pieces) > 1
    if not kept:
        session.pieces.discard()
    if given.quiet:
        return []
    which = f" of piece {piece.number}" if len(pieces) > 1 else ""
    raw_records = [f"raw record: {each.path}" for each in pieces if kept]
    return [*ledger_lines(reduction.record.history), f"series{which}: {out}", *raw_records]


def _targets(given: argparse.Namespace) -> tuple[Path, Path]:
    """Return where series and raw record go, or refuse what cannot be written."""
    from classic_ml.io.series import ledger_path

    out = given.out or Path(f"live-{datetime.now():%Y%m%d-%H%M%S}.csv")
    raw = given.raw or out.with_name(f"{out.stem}.raw.csv")
    check_target(out, SERIES_SUFFIXES)
    check_target(raw, (".csv",))
    check_apart([given.test], [out, ledger_path(out), raw])
    if raw.exists():
        raise InputError(
            str(raw),
            expected="a new file for the raw record",
            found="one that exists",
            remedy="it may be the record of a session that was cut off: reduce it, or move it away",
        )
    return out, raw


def _feed(given: argparse.Namespace) -> Feed:
    from comparisons.live.feeds import listening, piped

    if given.listen is not None or given.unix is not None:
        return listening(given.listen or given.unix)
    return piped(sys.stdin.fileno())


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


COMMAND = Command(
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
    run=_run,
    add=_add_source,
    formatter=_WithFormats,
)
