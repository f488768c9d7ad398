"""Ctrl-C ends a command with 130 and one line, whatever it is at."""

from __future__ import annotations

import ctypes
import importlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from comparisons.cli import EXIT_INTERRUPTED
from comparisons.interrupts import interrupts_heeded

pytestmark = pytest.mark.skipif(
    not hasattr(signal, "setitimer"), reason="interrupts are not sent again here"
)
PATIENCE_S = 30.0
# A package that is interrupted while it loads, and takes that for a missing part of itself.
STUBBORN = """
import signal
try:
    signal.raise_signal(signal.SIGINT)
    whole = True
except BaseException:
    whole = False
"""


def wait() -> None:
    """Do nothing until an interrupt comes."""
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        time.sleep(0.01)


def interrupt() -> None:
    signal.raise_signal(signal.SIGINT)


def test_an_interrupt_waits_until_a_package_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stubborn_package.py").write_text(STUBBORN, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    loaded = []

    def load_and_wait() -> None:
        loaded.append(importlib.import_module("stubborn_package"))
        wait()

    with pytest.raises(KeyboardInterrupt), interrupts_heeded():
        load_and_wait()
    assert loaded[0].whole
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_loads_without_end_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("comparisons.interrupts.LONGEST_S", 0.2)
    endless = "import signal\nsignal.raise_signal(signal.SIGINT)\nwhile True:\n    pass\n"
    (tmp_path / "endless_package.py").write_text(endless, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(KeyboardInterrupt), interrupts_heeded():
        importlib.import_module("endless_package")


def test_an_interrupt_that_a_compiled_library_swallows_comes_again(
    capfd: pytest.CaptureFixture[str],
) -> None:
    called = ctypes.CFUNCTYPE(None)(interrupt)

    def call_and_wait() -> None:
        called()
        wait()

    with pytest.raises(KeyboardInterrupt), interrupts_heeded():
        call_and_wait()
    assert capfd.readouterr().err == ""


def test_an_interrupt_that_still_waits_at_the_end_is_not_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("comparisons.interrupts.AGAIN_S", PATIENCE_S)
    called = ctypes.CFUNCTYPE(None)(interrupt)
    with pytest.raises(KeyboardInterrupt), interrupts_heeded():
        called()


def test_an_interrupt_that_waits_goes_to_whoever_has_a_say_in_it_by_then() -> None:
    called = ctypes.CFUNCTYPE(None)(interrupt)
    heard: list[int] = []
    with interrupts_heeded():
        called()
        ours = signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
        until_s = time.monotonic() + PATIENCE_S
        while not heard and time.monotonic() < until_s:
            time.sleep(0.01)
        signal.signal(signal.SIGINT, ours)
    assert heard == [signal.SIGINT]


def test_interrupts_that_are_ignored_stay_so() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts_heeded():
            interrupt()
            time.sleep(0.05)
    finally:
        signal.signal(signal.SIGINT, before)


def started(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Return a command in a group of processes of its own, which is about to begin."""
    code = (
        "import sys; from comparisons.cli import main; print('begun', flush=True); "
        f"sys.exit(main({list(arguments)!r}))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    return process


@pytest.mark.parametrize("delay_s", [0.05, 0.25, 0.5, 0.9, 1.5])
def test_a_command_that_starts_is_interrupted_in_one_line(tmp_path: Path, delay_s: float) -> None:
    process = started(tmp_path, "demo", "--out", "demo")
    time.sleep(delay_s)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == EXIT_INTERRUPTED, err
    assert err.endswith("sindy-surge: interrupted; files that were finished are whole\n")
    assert "Traceback" not in err
    assert "Error" not in err


@pytest.mark.parametrize("delay_s", [0.3, 1.0, 2.0])
def test_a_session_that_starts_is_interrupted_without_a_word_of_its_helper(
    tmp_path: Path, delay_s: float
) -> None:
    from raw_data import make_test

    make_test(seconds=1.0).write(tmp_path)
    process = started(tmp_path, "live", "--listen", "0", "--test", "test.toml", "-o", "s.csv")
    time.sleep(delay_s)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE_S)
    # Where it waits for a sender already, that ends in order, without rows.
    waits = "ended: SIGINT" in out
    assert process.returncode == (2 if waits else EXIT_INTERRUPTED), err
    assert err.count("\n") == 1, err
    assert "Traceback" not in out
