"""What a session knows at one moment: one list of fields, on a terminal and on a page.

The page is for this machine: one server in a thread, and nothing else is asked for.
"""

from __future__ import annotations

import math
import shutil
import threading
from collections.abc import Sequence
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, TextIO

from classic_ml.flow import LBM_KG
from comparisons.live.monitor import Monitor
from surge_core.errors import InputError
from surge_core.files import to_strict_json

HOST = "127.0.0.1"
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
# Of a line, which may be cut: what matters most first.
IN_LINE = ("clock", "machine", "φ", "ψ'", "surge cycles", "time constant τ", "feed")


def live_document(
    monitor: Monitor, *, test: str, phase: str, feed: str, record: str, events: Sequence[str]
) -> dict[str, Any]:
    """Return the moment as plain types, as the page takes it.

    ``phase`` is "waiting", "running", "reducing" or "done"; ``feed`` and ``record`` say in words
    how the feed does and what was kept of it; of the events the newest stands at the end.
    """
    detector, estimate, point = monitor.detector, monitor.estimate, monitor.point
    cycles, period_s = str(detector.n_cycles), detector.period_s
    if math.isfinite(period_s):
        cycles += f", one every {1e3 * period_s:.0f} ms ({1.0 / period_s:.2f} Hz)"
    fields = {"feed": feed, "machine": monitor.machine}
    for label, name, factor, form in QUANTITIES:
        value = factor * point.get(name, math.nan)
        fields[label] = form.format(value) if math.isfinite(value) else "–"
    fields["surge cycles"] = cycles
    fields["time constant τ"] = "not yet estimated" if estimate is None else estimate.words
    fields["record"] = record
    known = estimate is not None and not estimate.why_not
    return {
        "schema": "sindy-surge/live/1",
        "test": test,
        "phase": phase,
        "machine": monitor.machine,
        "fields": [{"label": label, "value": value} for label, value in fields.items()],
        "trail": list(monitor.trail),
        "tau_ms": [1e3 * estimate.tau_s, 1e3 * estimate.tau_stderr_s]
        if estimate is not None and known
        else None,
        "curve": estimate.curve if estimate is not None else [],
        "events": list(events),
    }


class Terminal:
    """Write a line an event and, where the stream is a terminal, the newest state below them."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._moving = stream.isatty()

    def say(self, event: str) -> None:
        """Write an event."""
        self._write(_plain(event) + "\n")

    def show(self, document: dict[str, Any]) -> None:
        """Write the state over the one before."""
        if self._moving:
            values = {field["label"]: field["value"] for field in document["fields"]}
            line = "  ".join(f"{label} {values[label]}" for label in IN_LINE)
            self._write(_plain(line)[: shutil.get_terminal_size().columns - 1])

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


class Page:
    """Serve the newest state on 127.0.0.1: ``/`` is the page, ``/state.json`` its numbers.

    Port 0 is any that is free; ``port`` then is the one that it has.
    """

    def __init__(self, port: int) -> None:
        self._page = (resources.files(__package__) / "web" / "page.html").read_bytes()
        self._document: dict[str, Any] = {}
        page = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                # Another name may have been bound to this machine by a page elsewhere.
                if self.headers.get("Host") not in (
                    f"{HOST}:{page.port}",
                    f"localhost:{page.port}",
                ):
                    return self.send_error(421)
                state = to_strict_json(page._document).encode("utf-8")
                kinds = {"/": (page._page, "text/html"), "/state.json": (state, "application/json")}
                if self.path not in kinds:
                    return self.send_error(404)
                content, kind = kinds[self.path]
                self.send_response(200)
                self.send_header("Content-Type", f"{kind}; charset=utf-8")
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, format: str, *args: Any) -> None:
                """Log nothing."""

        try:
            self._server = ThreadingHTTPServer((HOST, port), Handler)
        except OSError as error:
            raise InputError(
                "--page",
                expected=f"a port of {HOST} that is free",
                found=f"{port}: {error.strerror or error}",
            ) from None
        self.port = int(self._server.server_address[1])
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()

    def say(self, event: str) -> None:
        """Do nothing: events come with the states."""

    def show(self, document: dict[str, Any]) -> None:
        """Serve another state from now on."""
        self._document = document

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
