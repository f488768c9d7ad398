"""The environments of the peers, one each, so that none is a dependency of the project."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
VENVS = HERE.parent / ".venvs"
NAMES = ("sippy", "sysidentpy", "statsmodels", "jax-sysid")


def python_of(name: str) -> Path:
    """Return the interpreter of an environment."""
    folder = "Scripts/python.exe" if sys.platform == "win32" else "bin/python"
    return VENVS / name / folder


def missing(name: str) -> str | None:
    """Return why an environment cannot be used, or None when it can."""
    if _stamp(name).is_file() and _stamp(name).read_text() == _requirements(name).read_text():
        return None
    log = _log(name)
    if log.is_file():
        lines = [line for line in log.read_text().splitlines() if line.strip()]
        return f"not installed: {lines[-1] if lines else 'pip failed without a word'}"
    return "not installed: run with --setup first"


def set_up(name: str) -> str | None:
    """Make an environment unless it is there; return why that failed, or None.

    Parameters
    ----------
    name : str
        One of ``NAMES``.
    """
    if missing(name) is None:
        return None
    VENVS.mkdir(exist_ok=True)
    _log(name).unlink(missing_ok=True)
    install: list[str | Path] = [python_of(name), "-m", "pip", "install", "--quiet", "--no-deps"]
    steps: tuple[list[str | Path], ...] = (
        [sys.executable, "-m", "venv", "--clear", VENVS / name],
        [*install, "--requirement", _requirements(name)],
    )
    for step in steps:
        done = subprocess.run(step, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            _log(name).write_text(done.stdout + done.stderr)
            return missing(name)
    _stamp(name).write_text(_requirements(name).read_text())
    return None


def _requirements(name: str) -> Path:
    return HERE / f"requirements-{name}.txt"


def _stamp(name: str) -> Path:
    return VENVS / name / ".installed"


def _log(name: str) -> Path:
    return VENVS / f"{name}.log"
