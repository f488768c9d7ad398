"""The command `sindy-surge live`: a test as it runs, and its reduction at the end."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from classic_ml.io import read_test_description
from classic_ml.io.series import ledger_path, write_series
from classic_ml.records import ledger_lines
from comparisons.cli.options import SERIES_SUFFIXES
from comparisons.cli.reduce import options_named, reduction_settings
from comparisons.live.feeds import listening, piped
from comparisons.live.monitor import Monitor
from comparisons.live.pieces import Pieces, reduce_longest
from comparisons.live.screens import Page, Terminal
from comparisons.live.session import Session
from surge_core.errors import InputError
from surge_core.files import check_apart, check_target


def run(given: argparse.Namespace) -> Iterable[str]:
    """Follow a feed to its end, and reduce what it brought."""
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
        address = given.listen or given.unix
        feed = listening(address) if address is not None else piped(sys.stdin.fileno())
        session = Session(test, feed, Pieces(raw), monitor, screens, given.timeout)
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
