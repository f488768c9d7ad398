"""What a session knows at one moment: one list of fields for the terminal and the page."""

from __future__ import annotations

import math
import shutil
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, TextIO

from classic_ml.flow import LBM_KG
from comparisons.live.estimate import Estimate
from comparisons.live.operating_point import OperatingPoints
from surge_core.rounding import round_to_error

__all__ = ["LiveState", "Terminal", "page_document", "tau_words"]

CLEAR_LINE = "\r\x1b[K"
# The quantities of an operating point: label, name, factor and format.
QUANTITIES: tuple[tuple[str, str, float, str], ...] = (
    ("clock", "time_s", 1.0, "{:.3f} s"),
    ("corrected flow", "Wc25_kg_s", 1.0 / LBM_KG, "{:.1f} lbm/s"),
    ("pressure ratio", "pressure_ratio", 1.0, "{:.3f}"),
    ("φ", "phi", 1.0, "{:.4f}"),
    ("ψ'", "psi_p", 1.0, "{:.3f}"),
    ("corrected speed", "Nc_frac", 100.0, "{:.1f} %"),
)


@dataclass(frozen=True)
class LiveState:
    """Everything that is shown.

    Parameters
    ----------
    test, feed, record : str
        Name of the test; how the feed does and what was kept of it, in words.
    phase : {"waiting", "running", "reducing", "done"}
        How far the session is.
    machine : str
        ``"stable"``, ``"in stall"``, ``"surge"`` or ``"not known"``.
    point : OperatingPoints or None
        The newest one.
    n_cycles : int
        Complete surge cycles.
    period_s : float
        Their median period; NaN before there are two troughs.
    estimate : Estimate or None
        The newest provisional fit.
    trail : tuple of tuple of float
        (time, φ, ψ') of the last seconds, thinned out.
    events : tuple of str
        The last ones, the newest at the end.
    """

    test: str
    phase: str
    feed: str
    record: str = ""
    machine: str = "not known"
    point: OperatingPoints | None = None
    n_cycles: int = 0
    period_s: float = math.nan
    estimate: Estimate | None = None
    trail: tuple[tuple[float, ...], ...] = field(default=(), repr=False)
    events: tuple[str, ...] = ()


def _fields(state: LiveState) -> list[tuple[str, str]]:
    """Return label and value of everything that is shown in words."""
    cycles = str(state.n_cycles)
    if math.isfinite(state.period_s):
        cycles += f", one every {1e3 * state.period_s:.0f} ms ({1.0 / state.period_s:.2f} Hz)"
    return [
        ("feed", state.feed),
        ("machine", state.machine),
        *((how[0], _quantity(state.point, *how[1:])) for how in QUANTITIES),
        ("surge cycles", cycles),
        ("time constant τ", tau_words(state.estimate)),
        ("record", state.record),
    ]


def _quantity(point: OperatingPoints | None, name: str, factor: float, form: str) -> str:
    value = math.nan if point is None else factor * float(getattr(point, name)[-1])
    return form.format(value) if math.isfinite(value) else "–"


def tau_words(estimate: Estimate | None) -> str:
    """Return the time constant as it is shown.

    Parameters
    ----------
    estimate : Estimate or None
        The newest fit.
    """
    if estimate is None:
        return "not yet estimated"
    if estimate.why_not:
        return f"not yet: {estimate.why_not}"
    tau = round_to_error(1e3 * estimate.tau_s, 1e3 * estimate.tau_stderr_s)
    return f"{tau} ms, provisional"


def _status_line(state: LiveState) -> str:
    """Return the moment in one line of a terminal; what matters most first, since it may be cut."""
    values = dict(_fields(state))
    labels = ("clock", "machine", "φ", "ψ'", "surge cycles", "time constant τ", "feed")
    return "  ".join(f"{label} {values[label]}" for label in labels)


def page_document(state: LiveState) -> dict[str, Any]:
    """Return the moment as plain types, as the page takes it.

    Parameters
    ----------
    state : LiveState
        The moment.
    """
    estimate = state.estimate
    known = estimate is not None and not estimate.why_not
    return {
        "schema": "sindy-surge/live/1",
        "test": state.test,
        "phase": state.phase,
        "machine": state.machine,
        "fields": [{"label": label, "value": value} for label, value in _fields(state)],
        "trail": state.trail,
        "tau_ms": [1e3 * estimate.tau_s, 1e3 * estimate.tau_stderr_s]
        if estimate is not None and known
        else None,
        "curve": estimate.curve if estimate is not None else [],
        "events": state.events,
    }


class Terminal:
    """Write a line an event and, where the stream is a terminal, the newest state below them.

    Parameters
    ----------
    stream : text stream
        Where to write.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._moving = stream.isatty()

    def say(self, event: str) -> None:
        """Write an event."""
        self._write(_plain(event) + "\n")

    def show(self, state: LiveState) -> None:
        """Write the state over the one before."""
        if self._moving:
            width = shutil.get_terminal_size().columns - 1
            self._write(_plain(_status_line(state))[:width])

    def close(self) -> None:
        """Leave the line."""
        if self._moving:
            self._write("")

    def _write(self, text: str) -> None:
        # A terminal or pipe that is gone ends its display, not the run.
        with suppress(OSError, ValueError):
            self._stream.write((CLEAR_LINE if self._moving else "") + text)
            self._stream.flush()


def _plain(text: str) -> str:
    """Return text without control characters, which a terminal would obey."""
    return "".join(c if c.isprintable() else "?" for c in text)
