"""Send a raw record as a running test would, row by row at the pace of its clock.

    sindy-surge live --listen 7000 --test test.toml --page 8000 -o series.csv
    python live_feed.py raw.csv --to 127.0.0.1:7000

Without a record, a small simulated one is sent to a session that is started here.
"""

from __future__ import annotations

import argparse
import contextlib
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from comparisons.live.frames import columns_frame, end_frame, rows_frame
from comparisons.rig import simulate, write_run


def text_batches(raw: Path, n_rows: int) -> Iterator[bytes]:
    """Yield the header, the rows so many at a time, and the end mark, as lines."""
    header, *lines = raw.read_bytes().splitlines(keepends=True)
    yield header
    for start in range(0, len(lines), n_rows):
        yield b"".join(lines[start : start + n_rows])
    yield b"#end\n"


def binary_batches(raw: Path, n_rows: int) -> Iterator[bytes]:
    """Yield the same as frames: counts as 16-bit integers, clock and kelvins as floats."""
    names = raw.open(encoding="utf-8").readline().strip().split(",")
    rows = np.loadtxt(raw, delimiter=",", skiprows=1)
    whole = (rows == np.round(rows)).all(axis=0)
    columns = {name: "i2" if w else "f8" for name, w in zip(names, whole, strict=True)}
    yield columns_frame(columns)
    starts = range(0, len(rows), n_rows)
    for number, start in enumerate(starts, start=1):
        yield rows_frame(columns, rows[start : start + n_rows], number)
    yield end_frame(len(starts) + 1)


def send(batches: Iterator[bytes], put: Callable[[bytes], object], batch_s: float) -> None:
    """Send each batch when it is due."""
    begun_s = time.monotonic()
    for number, batch in enumerate(batches):
        due_s = begun_s + max(0, number - 1) * batch_s
        time.sleep(max(0.0, due_s - time.monotonic()))
        put(batch)


def stream(arguments: argparse.Namespace) -> None:
    """Send the record to a socket, or to the standard output."""
    n_rows = arguments.rows
    batches = (binary_batches if arguments.format == "binary" else text_batches)(
        arguments.raw, n_rows
    )
    batch_s = n_rows / (arguments.rate * arguments.speed)
    if arguments.to == "-":
        send(batches, lambda data: (sys.stdout.buffer.write(data), sys.stdout.flush()), batch_s)
        return
    host, _, port = arguments.to.rpartition(":")
    with contextlib.closing(connected(host, int(port))) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        send(batches, connection.sendall, batch_s)


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
        with subprocess.Popen(command, stdin=subprocess.PIPE) as session:
            assert session.stdin is not None
            # Let it load first, so that the latency it prints is that of the rows.
            time.sleep(2.0)
            send(text_batches(folder / "raw.csv", 10), unbuffered(session.stdin.fileno()), 5e-4)
            session.stdin.close()


def unbuffered(handle: int) -> Callable[[bytes], object]:
    """Return a function that writes to a pipe at once."""
    return open(handle, "wb", buffering=0, closefd=False).write


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("raw", type=Path, nargs="?", help="raw record (.csv)")
    parser.add_argument("--to", default="-", help="HOST:PORT, or - for the standard output")
    parser.add_argument("--format", choices=("csv", "binary"), default="csv")
    parser.add_argument("--rate", type=float, default=1000.0, help="rows a second of the record")
    parser.add_argument("--speed", type=float, default=1.0, help="times as fast")
    parser.add_argument("--rows", type=int, default=10, help="rows in a batch")
    arguments = parser.parse_args()
    if arguments.raw is None:
        demonstrate()
    else:
        stream(arguments)


if __name__ == "__main__":
    main()
