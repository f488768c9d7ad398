"""Send a raw record as a running test would, line by line at the pace of its clock.

    sindy-surge live --listen 7000 --test test.toml --page 8000 -o series.csv
    python live_feed.py raw.csv --to 127.0.0.1:7000

Without a record, a small simulated one is sent to a session that is started here.
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from comparisons.rig import simulate, write_run


def send(raw: Path, put: Callable[[bytes], object], n_rows: int, rate_hz: float) -> None:
    """Send the header, the rows so many at a time, each when it is due, and the end mark."""
    header, *lines = raw.read_bytes().splitlines(keepends=True)
    put(header)
    begun_s = time.monotonic()
    for start in range(0, len(lines), n_rows):
        time.sleep(max(0.0, begun_s + start / rate_hz - time.monotonic()))
        put(b"".join(lines[start : start + n_rows]))
    put(b"#end\n")


def connected(host: str, port: int, patience_s: float = 20.0) -> socket.socket:
    """Return a connection to a session that may still be starting."""
    until_s = time.monotonic() + patience_s
    while True:
        try:
            return socket.create_connection((host, port))
        except ConnectionRefusedError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.1)


def demonstrate() -> None:
    """Send a simulated test to a session of our own, over a pipe, at twenty times its pace."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "test"
        write_run(simulate("985", seed=0, duration_s=3.0), folder)
        command = [sys.executable, "-m", "comparisons.cli", "live", "-"]
        command += ["--test", str(folder / "test.toml"), "-o", str(folder / "series.csv")]
        with subprocess.Popen(command, stdin=subprocess.PIPE, bufsize=0) as session:
            assert session.stdin is not None
            send(folder / "raw.csv", session.stdin.write, 10, 20_000.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("raw", type=Path, nargs="?", help="raw record (.csv)")
    parser.add_argument("--to", metavar="HOST:PORT", help="default: the standard output")
    parser.add_argument("--rate", type=float, default=1000.0, help="rows a second")
    parser.add_argument("--rows", type=int, default=10, help="rows in a batch")
    arguments = parser.parse_args()
    if arguments.raw is None:
        demonstrate()
    elif arguments.to is None:
        with open(sys.stdout.fileno(), "wb", buffering=0, closefd=False) as out:
            send(arguments.raw, out.write, arguments.rows, arguments.rate)
    else:
        host, _, port = arguments.to.rpartition(":")
        with connected(host, int(port)) as connection:
            send(arguments.raw, connection.sendall, arguments.rows, arguments.rate)


if __name__ == "__main__":
    main()
