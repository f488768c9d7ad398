"""The command `sindy-surge live`: a test as it runs, and its reduction at the end."""

from __future__ import annotations

import argparse
import math
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from comparisons.cli.reduction_options import (
    add_reduction_options,
    options_named,
    reduction_settings,
)

if TYPE_CHECKING:
    from comparisons.live.feeds import Feed
    from comparisons.live.pieces import Result
    from comparisons.live.session import Session

__all__ = ["add_parser"]

SERIES = (".csv", ".nc", ".nc4", ".netcdf")
_BEHAVIOUR = """\
While it runs, the operating point comes from pressures behind a causal low-pass (48 Hz, about 7 ms
late) and is one row late; it is matched at near stall once the interval [near_stall] of test.toml
has passed, and says so. Surge is reported when the filtered flow at plane 25 has run backwards for
3 ms, some 12 ms after the machine itself on the simulated rig; a cycle when P31 has risen by 15 %
of its mean behind its trough. The time constant is that of `reduce` and `compare` over the last
half minute, estimated again behind every cycle, and provisional.

A feed may fall silent or break. Rows whose clock was had are dropped, what is no row is counted and
left out. Where rows are missing the record goes on as a new piece, which is reduced by itself; one
without a near-stall reading is matched by that of the piece before it, and its ledger says so.
`reduce` does the same with the test.toml that lies beside its raw record (--raw), where the table
[near_stall_shifts] holds the match.

The run ends with the input, with the end mark of the format, after --timeout, or with Ctrl-C or
SIGTERM; then the rows are reduced as `reduce` would with the same options. They are on disk all the
time: after a crash, reduce that file."""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the sub-command.

    Parameters
    ----------
    commands : argparse sub-parsers
        Those of `sindy-surge`.
    """
    parser = commands.add_parser(
        "live",
        help="follow a test as it runs, and reduce it at the end",
        description="Take the rows of a running test from a pipe or a socket, show operating "
        "point, surge and a running estimate, and end with the series that `reduce` gives.",
        formatter_class=_WithFormats,
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("input", nargs="?", choices=("-",), help="read the standard input")
    source.add_argument(
        "--listen",
        type=_address,
        metavar="[HOST:]PORT",
        help="wait for a sender here, and again when it is gone (default host: 127.0.0.1; "
        "on another address any machine that reaches it can send)",
    )
    source.add_argument(
        "--connect", type=_address, metavar="[HOST:]PORT", help="connect to a server that sends"
    )
    source.add_argument("--unix", type=Path, metavar="PATH", help="wait on a Unix socket")
    parser.add_argument("--test", type=Path, required=True, help="description of the test (.toml)")
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="SERIES",
        help="series (.csv or .nc; default: live-DATE-TIME.csv)",
    )
    parser.add_argument("--raw", type=Path, metavar="FILE.csv", help="keep the raw record here")
    parser.add_argument(
        "--timeout",
        type=_seconds,
        default=math.inf,
        metavar="S",
        help="end the run after so long without a row (default: wait)",
    )
    parser.add_argument(
        "--page", type=_port, metavar="PORT", help="show a page on 127.0.0.1 (0: any free port)"
    )
    add_reduction_options(
        parser.add_argument_group(
            "options of `reduce`",
            "for the running estimate and for the series at the end; the state that is shown "
            "during the run follows test.toml alone",
        )
    )
    parser.add_argument("--no-estimate", action="store_true", help="without a running estimate")
    parser.add_argument("--quiet", action="store_true", help="say nothing but errors")
    parser.set_defaults(run=_run)


class _WithFormats(argparse.RawDescriptionHelpFormatter):
    """Show the format of the feed below the options; it is loaded only for that."""

    def format_help(self) -> str:
        from comparisons.live.lines import TEXT_FORMAT

        return f"{super().format_help()}\n{_BEHAVIOUR}\n\n{TEXT_FORMAT}\n"


def _run(arguments: argparse.Namespace) -> None:
    from classic_ml.io import read_test_description
    from comparisons.live.monitor import Monitor
    from comparisons.live.page import Page
    from comparisons.live.pieces import Pieces, reduce_pieces
    from comparisons.live.session import Session
    from comparisons.live.terminal import Terminal

    out, raw = _targets(arguments)
    test = read_test_description(arguments.test)
    with options_named():
        settings = reduction_settings(arguments)
    with TemporaryDirectory() as scratch, ExitStack() as ends:
        monitor = Monitor(test, settings, Path(scratch), estimates=not arguments.no_estimate)
        terminal = None if arguments.quiet else Terminal(sys.stdout)
        page = None if arguments.page is None else Page(arguments.page)
        screens = [screen for screen in (page, terminal) if screen is not None]
        for screen in screens:
            ends.callback(screen.close)
        session = Session(
            test,
            _feed(arguments),
            Pieces(raw),
            monitor,
            screens,
            terminal.tell if terminal is not None else lambda event: None,
            arguments.timeout,
        )
        if page is not None:
            session.say("page", page.address)
        with _stopped_by_signals(session):
            session.run()
        with options_named():
            results = reduce_pieces(
                session.pieces.pieces, arguments.test, out, settings, session.entry()
            )
        session.show("done")
    _print_results(results, arguments.quiet)
    if arguments.raw is None and all(result.error is None for result in results):
        session.pieces.discard()
    elif not arguments.quiet:
        for result in results:
            described = f" with {result.piece.test}" if result.piece.test else ""
            print(f"raw record: {result.piece.path}{described}")


def _targets(arguments: argparse.Namespace) -> tuple[Path, Path]:
    """Return where series and raw record go, or refuse what cannot be written."""
    from classic_ml.io.series import ledger_path
    from surge_core.errors import InputError
    from surge_core.files import check_apart, check_target

    out = arguments.out or Path(f"live-{datetime.now():%Y%m%d-%H%M%S}.csv")
    raw = arguments.raw or out.with_name(f"{out.stem}.raw.csv")
    check_target(out, SERIES)
    check_target(raw, (".csv",))
    check_apart([arguments.test], [out, ledger_path(out), raw])
    if raw.exists():
        raise InputError(
            str(raw),
            expected="a new file for the raw record",
            found="one that exists",
            remedy="it may be the record of a session that was cut off: reduce it, or move it away",
        )
    return out, raw


def _feed(arguments: argparse.Namespace) -> Feed:
    from comparisons.live.feeds import calling, listening, piped

    if arguments.connect is not None:
        return calling(*arguments.connect)
    if arguments.listen is not None or arguments.unix is not None:
        return listening(arguments.listen or arguments.unix)
    return piped(sys.stdin.fileno())


@contextmanager
def _stopped_by_signals(session: Session) -> Iterator[None]:
    """Let signals end the session in order; behind it they do what they did before."""

    def stop(number: int, _frame: object) -> None:
        session.stop(signal.Signals(number).name)

    names = ("SIGINT", "SIGTERM", "SIGHUP")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = [signal.signal(number, stop) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _print_results(results: list[Result], quiet: bool) -> None:
    from comparisons.cli.reduce import print_reduction

    if quiet:
        return
    for result in results:
        if len(results) > 1:
            print(f"piece {result.piece.number}, {result.piece.n_rows} rows:")
        if result.reduction is None:
            print(f"not reduced: {result.error}")
        else:
            print_reduction(result.reduction)
            print(f"series: {result.series}")


def _address(text: str) -> tuple[str, int]:
    from comparisons.live.feeds import parse_address

    try:
        return parse_address(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected HOST:PORT or PORT, found {text!r}") from None


def _port(text: str) -> int:
    return _address(f"127.0.0.1:{text}")[1]


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"expected seconds above 0, found {text!r}")
    return value
