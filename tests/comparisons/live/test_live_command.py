"""`sindy-surge live` as users start it: real processes, sockets and signals."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import socket
import stat
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from live_records import LiveRecord, series_of

from comparisons.cli import main
from comparisons.live.frames import columns_frame, end_frame, rows_frame

PATIENCE_S = 60.0


class Running:
    """A session in a process of its own, and what it has said."""

    def __init__(self, process: subprocess.Popen[str], log: Path) -> None:
        self.process = process
        self.log = log

    @property
    def said(self) -> str:
        return self.log.read_text("utf-8")

    def wait_for(self, pattern: str) -> re.Match[str]:
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            match = re.search(pattern, self.said)
            if match:
                return match
            assert self.process.poll() is None, self.said
            time.sleep(0.05)
        raise AssertionError(f"{pattern} was not said: {self.said}")

    def ended(self) -> int:
        return self.process.wait(PATIENCE_S)


@contextmanager
def running(record: LiveRecord, folder: Path, *options: str) -> Iterator[Running]:
    log = folder / "log.txt"
    command = [
        sys.executable,
        "-m",
        "comparisons.cli",
        "live",
        "--test",
        str(record.test_path),
    ]
    with log.open("w", encoding="utf-8") as stream:
        process = subprocess.Popen(
            [*command, "-o", str(folder / "series.csv"), *options],
            stdin=subprocess.PIPE,
            stdout=stream,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"},
        )
        try:
            yield Running(process, log)
        finally:
            if process.poll() is None:
                process.kill()
            process.communicate()


def wait_for_size(path: Path, size: int) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not (path.exists() and path.stat().st_size == size):
        assert time.monotonic() < until_s
        time.sleep(0.02)


def test_a_pipe_with_page_and_estimate_ends_with_what_reduce_gives(
    record: LiveRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(record, tmp_path, "-", "--page", "0") as session:
        port = int(session.wait_for(r"http://127\.0\.0\.1:(\d+)/")[1])
        assert session.process.stdin is not None
        pipe = session.process.stdin.buffer  # type: ignore[attr-defined]
        pipe.write(record.header + b"".join(record.lines[:2500]))
        pipe.flush()
        session.wait_for("first estimate of τ")
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        connection.request("GET", "/state.json")
        document = json.loads(connection.getresponse().read())
        connection.close()
        pipe.write(b"".join(record.lines[2500:]))
        pipe.close()
        session.process.stdin = None
        assert session.ended() == 0, session.said
    assert document["tau_ms"][0] == pytest.approx(18.0, abs=8.0)
    assert document["machine"].startswith("surge")
    assert (tmp_path / "series.csv").read_bytes() == record.series
    # All that is kept is the series with its ledger.
    assert {p.name for p in tmp_path.iterdir()} == {"series.csv", "series.ledger.json", "log.txt"}
    assert (
        main(
            [
                "reduce",
                str(record.raw),
                "--test",
                str(record.test_path),
                "-o",
                str(tmp_path / "reduced.csv"),
            ]
        )
        == 0
    )
    printed = [line for line in capsys.readouterr().out.splitlines() if "series:" not in line]
    assert printed
    assert [line for line in printed if line not in session.said.splitlines()] == []
    assert "live feed: 3001 rows in 1 piece over 1 connection" in session.said
    assert re.search(r"latency: median \d+ ms, longest \d+ ms of a budget of 200 ms", session.said)


OPTIONS = ("--cutoff", "60", "--probes", "tip", "--hysteresis", "1.5", "--window", "1", "2.6")


def test_with_options_of_reduce_it_ends_with_what_reduce_gives_with_them(
    record: LiveRecord, tmp_path: Path
) -> None:
    reduced = tmp_path / "reduced.csv"
    where = ("--test", str(record.test_path), "-o", str(reduced))
    assert main(["reduce", str(record.raw), *where, *OPTIONS]) == 0
    with running(record, tmp_path, "-", "--quiet", "--no-estimate", *OPTIONS) as session:
        assert session.process.stdin is not None
        pipe = session.process.stdin.buffer  # type: ignore[attr-defined]
        pipe.write(record.header + b"".join(record.lines))
        pipe.close()
        session.process.stdin = None
        assert session.ended() == 0, session.said
    series = (tmp_path / "series.csv").read_bytes()
    assert series == reduced.read_bytes()
    # Each of them matters to this record.
    assert series != record.series


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--cutoff", "-1"), "--cutoff: expected a number above 0, found -1.0"),
        (("--filter-order", "4"), "--filter-order: expected 3 or 5, found 4"),
        (("--window", "2", "1"), "--window: expected two times, the earlier first"),
    ],
)
def test_an_option_of_reduce_that_cannot_be_is_refused_before_the_feed_is_read(
    record: LiveRecord,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    says: str,
) -> None:
    where = ("--test", str(record.test_path), "-o", str(tmp_path / "series.csv"))
    assert main(["live", "--listen", "0", *where, *options]) == 2
    said = capsys.readouterr()
    assert (said.out, says in said.err) == ("", True)
    assert list(tmp_path.iterdir()) == []


def test_tcp_goes_on_behind_a_lost_connection(record: LiveRecord, tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    content = record.content
    raw = tmp_path / "kept.csv"
    with running(record, tmp_path, "--listen", "0", "--no-estimate", "--raw", str(raw)) as session:
        port = int(session.wait_for(r"waiting for a sender on 127\.0\.0\.1:(\d+)")[1])
        half = len(content) // 2 + 17
        with socket.create_connection(("127.0.0.1", port)) as sender:
            for start in range(0, half, 9000):
                sender.sendall(content[start : min(start + 9000, half)])
                time.sleep(float(rng.uniform(0.0, 0.01)))
        session.wait_for("connection lost: the sender closed it")
        with socket.create_connection(("127.0.0.1", port)) as sender:
            overlap = b"".join(record.lines[1000:])
            sender.sendall(record.header + overlap + b"#end\n")
            assert session.ended() == 0, session.said
    assert (tmp_path / "series.csv").read_bytes() == record.series
    assert raw.read_bytes() == content
    assert "had already" in session.said


def test_a_signal_ends_the_session_in_order(record: LiveRecord, tmp_path: Path) -> None:
    sent = record.header + b"".join(record.lines[:2700])
    with running(record, tmp_path, "--listen", "0", "--no-estimate") as session:
        port = int(session.wait_for(r"waiting for a sender on 127\.0\.0\.1:(\d+)")[1])
        with socket.create_connection(("127.0.0.1", port)) as sender:
            sender.sendall(sent)
            wait_for_size(tmp_path / "series.raw.csv", len(sent))
            session.process.send_signal(signal.SIGTERM)
            assert session.ended() == 0, session.said
    assert "ended: SIGTERM" in session.said
    part = tmp_path / "part.csv"
    part.write_bytes(sent)
    assert (tmp_path / "series.csv").read_bytes() == series_of(part, record.test_path)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal here")
def test_a_killed_session_leaves_a_record_that_can_be_reduced(
    record: LiveRecord, tmp_path: Path
) -> None:
    sent = record.header + b"".join(record.lines[:2700])
    spool = tmp_path / "series.raw.csv"
    with running(record, tmp_path, "-", "--no-estimate") as session:
        assert session.process.stdin is not None
        session.process.stdin.buffer.write(sent)  # type: ignore[attr-defined]
        session.process.stdin.flush()
        wait_for_size(spool, len(sent))
        session.process.kill()
        session.ended()
    assert spool.read_bytes() == sent
    out = tmp_path / "saved.csv"
    command = ["reduce", str(spool), "--test", str(record.test_path), "-o", str(out)]
    assert main(command) == 0
    part = tmp_path / "part.csv"
    part.write_bytes(sent)
    assert out.read_bytes() == series_of(part, record.test_path)
    # The next session does not write over it.
    assert (
        main(
            [
                "live",
                "-",
                "--test",
                str(record.test_path),
                "-o",
                str(tmp_path / "series.csv"),
                "--quiet",
            ]
        )
        == 2
    )
    assert spool.read_bytes() == sent


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no Unix sockets here")
def test_binary_frames_over_a_unix_socket(record: LiveRecord, tmp_path: Path) -> None:
    path = tmp_path / "feed.sock"
    columns = dict.fromkeys(record.names, "f8")
    parts = [columns_frame(columns)]
    parts += [rows_frame(columns, record.values[i : i + 300], 1) for i in range(0, 3001, 300)]
    options = ("--unix", str(path), "--format", "binary", "--no-estimate", "--quiet")
    with running(record, tmp_path, *options) as session:
        until_s = time.monotonic() + PATIENCE_S
        while not path.exists():
            assert time.monotonic() < until_s
            time.sleep(0.05)
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sender:
            sender.connect(str(path))
            sender.sendall(b"".join([*parts, end_frame(1)]))
            assert session.ended() == 0, session.said
    assert session.said == ""
    assert not path.exists()
    assert (tmp_path / "series.csv").read_bytes() == record.series


def test_it_calls_a_server_again_when_the_connection_is_lost(
    record: LiveRecord, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        port = server.getsockname()[1]
        options = ("--connect", f"127.0.0.1:{port}", "--no-estimate")
        with running(record, tmp_path, *options) as session:
            with server.accept()[0] as first:
                first.sendall(record.header + b"".join(record.lines[:1800]) + b"1,2")
            with server.accept()[0] as second:
                second.sendall(record.header + b"".join(record.lines[1700:]))
                wait_for_size(tmp_path / "series.raw.csv", len(record.content))
                session.process.send_signal(signal.SIGINT)
                assert session.ended() == 0, session.said
    assert "ended: SIGINT" in session.said
    assert (tmp_path / "series.csv").read_bytes() == record.series


def refused(
    capsys: pytest.CaptureFixture[str], record: LiveRecord, *options: str, test: Path | None = None
) -> str:
    chosen = record.test_path if test is None else test
    assert main(["live", "--test", str(chosen), "--no-estimate", *options]) == 2
    said = capsys.readouterr().err
    assert said.startswith("sindy-surge: ")
    assert "Traceback" not in said
    assert len(said.strip().splitlines()) == 1
    return said


def test_what_cannot_be_used_is_said_in_one_sentence(
    record: LiveRecord,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = ("-o", str(tmp_path / "s.csv"), "--quiet")

    def fed(content: bytes, *options: str, test: Path | None = None) -> str:
        file = tmp_path / "input.bin"
        file.write_bytes(content)
        with file.open() as stream, monkeypatch.context() as patch:
            patch.setattr(sys, "stdin", stream)
            return refused(capsys, record, "-", *out, *options, test=test)

    said = fed(record.header.replace(b",T25_A", b"") + b"1,2\n")
    assert "the feed: channel T25_A: expected it in the table" in said
    assert "expected a table [channels.extra]" in fed(b"extra," + record.header)
    assert "found none" in fed(b"")
    binary = ("--format", "binary")
    said = fed(b"\0\1\2" * 500, *binary)
    assert "1 line or frame that was left out: bytes that are no frame; " in said
    assert "leave out --format binary" in fed(record.content, *binary)
    columns = dict.fromkeys(record.names, "f8")
    begin = columns_frame(columns)
    assert "its version is 9" in fed(begin.replace(b"SSLV\1", b"SSLV\x09"), *binary)
    of_type = columns_frame({**columns, "T25_A": "i4"}).replace(b"T25_A:i4", b"T25_A:q9")
    fresh = of_type[:-4] + zlib.crc32(of_type[:-4]).to_bytes(4, "little")
    assert "the type of column T25_A is 'q9': write one of f8" in fed(fresh, *binary)
    said = fed(begin + rows_frame(columns, record.values[:300], 1))
    assert "expected lines of text, found binary frames; use --format binary" in said
    few = fed(record.header + b"".join(record.lines[:99]))
    assert "at least 100 rows" in few
    assert "the raw record is kept" in few
    (tmp_path / "s.raw.csv").unlink()
    assert "no such file" in fed(b"", test=tmp_path / "none.toml")
    bad = tmp_path / "bad.toml"
    bad.write_text("[test]\nname = 3\n", "utf-8")
    assert "bad.toml" in fed(b"", test=bad)
    assert "expected an output file ending in" in fed(b"", "-o", str(tmp_path / "s.txt"))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert port in refused(capsys, record, "--listen", port, *out)
        assert port in fed(b"", "--page", port)
    plain = tmp_path / "plain"
    plain.write_text("not a socket", "utf-8")
    if hasattr(socket, "AF_UNIX"):
        assert "plain" in refused(capsys, record, "--unix", str(plain), *out)
    assert plain.read_text("utf-8") == "not a socket"


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["-", "--listen", "0"],
        ["--listen", "localhost"],
        ["--listen", "1.2.3.4:99999"],
        ["-", "--page", "http"],
        ["-", "--budget", "0"],
        ["-", "--timeout", "nan"],
        ["-", "--format", "xml"],
    ],
)
def test_options_that_make_no_sense_are_refused(options: list[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["live", "--test", "test.toml", *options])
    assert left.value.code == 2


def test_the_help_tells_formats_and_delays(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["live", "--help"])
    assert left.value.code == 0
    said = capsys.readouterr().out
    for words in ("SSLV", "CRC-32", "#end", "12 ms after", "one row late", "provisional"):
        assert words in said
