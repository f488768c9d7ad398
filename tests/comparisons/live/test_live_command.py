"""`sindy-surge live` as users start it: a pipe, a socket, a signal."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from live_records import LiveRecord, series_of

from comparisons.cli import main

PATIENCE_S = 120.0


def awaited(look: Callable[[], Any]) -> Any:
    """Return what is there at last; the machine may be slow."""
    until_s = time.monotonic() + PATIENCE_S
    while not (found := look()):
        assert time.monotonic() < until_s
        time.sleep(0.05)
    return found


@contextmanager
def running(
    record: LiveRecord, folder: Path, *options: str
) -> Iterator[tuple[subprocess.Popen[bytes], Callable[[str], re.Match[str]]]]:
    """Start a session in a process of its own; with it, wait for what it says."""
    log = folder / "log.txt"
    command = [sys.executable, "-m", "comparisons.cli", "live", "--test", str(record.test_path)]
    with log.open("w", encoding="utf-8") as stream:
        process = subprocess.Popen(
            [*command, "-o", str(folder / "series.csv"), *options],
            stdin=subprocess.PIPE,
            stdout=stream,
            stderr=subprocess.STDOUT,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"},
        )
        try:
            yield process, lambda said: awaited(lambda: re.search(said, log.read_text("utf-8")))
        finally:
            process.kill()
            process.communicate()


def test_a_pipe_with_page_and_estimate_ends_with_what_reduce_gives(
    record: LiveRecord, tmp_path: Path
) -> None:
    with running(record, tmp_path, "-", "--page", "0") as (process, said):
        page = said(r"http://127\.0\.0\.1:\d+/")[0]
        pipe = process.stdin
        assert pipe is not None
        pipe.write(b"\n".join([*record.rows[:2501], b""]))
        pipe.flush()

        def shown() -> Any:
            document = json.loads(urlopen(page + "state.json").read())
            return document if document.get("tau_ms") else None

        document = awaited(shown)
        pipe.write(b"\n".join(record.rows[2501:]))
        pipe.close()
        process.stdin = None
        assert process.wait(PATIENCE_S) == 0
    assert document["tau_ms"][0] == pytest.approx(18.0, abs=8.0)
    assert document["machine"] == "surge"
    assert (tmp_path / "series.csv").read_bytes() == record.series
    # All that is kept is the series with its ledger.
    assert {p.name for p in tmp_path.iterdir()} == {"series.csv", "series.ledger.json", "log.txt"}


def test_a_signal_ends_the_run_in_order(record: LiveRecord, tmp_path: Path) -> None:
    raw = tmp_path / "kept.csv"
    with running(record, tmp_path, "--listen", "0", "--raw", str(raw)) as (process, said):
        port = int(said(r"waiting for a sender at 127\.0\.0\.1:(\d+)")[1])
        with socket.create_connection(("127.0.0.1", port)) as sender:
            sender.sendall(b"\n".join([*record.rows[:2501], b""]))
            said("cycle 6 ended")
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        said("ended: SIGTERM")
    assert (tmp_path / "series.csv").read_bytes() == series_of(raw, record.test_path)


def live(record: LiveRecord, *options: str) -> list[str]:
    return ["live", "-", "--test", str(record.test_path), "--quiet", *options]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("-o", "no folder/live.csv"), "no folder/live.csv: expected an existing folder"),
        (("-o", "live.csv", "--raw", "there.csv"), "there.csv: expected a new file"),
        (("-o", "live.csv", "--cutoff", "0"), "--cutoff"),
    ],
)
def test_what_cannot_be_is_refused_before_a_row_is_taken(
    record: LiveRecord,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.csv").write_text("a run that was cut off", "utf-8")
    assert main(live(record, *options)) == 2
    assert sentence in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["there.csv"]
