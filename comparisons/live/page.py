"""The session as a page of this machine: one server in a thread, and nothing else is asked for."""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any

from comparisons.live.display import LiveState, page_document
from surge_core.errors import InputError
from surge_core.files import to_strict_json

__all__ = ["Page"]

HOST = "127.0.0.1"


class Page:
    """Serve the newest state on 127.0.0.1: ``/`` is the page, ``/state.json`` its numbers.

    Parameters
    ----------
    port : int
        Port; 0 for any that is free.

    Attributes
    ----------
    port : int
        The port that it has.

    Raises
    ------
    InputError
        When the port is taken.
    """

    def __init__(self, port: int) -> None:
        self._page = (resources.files(__package__) / "web" / "page.html").read_bytes()
        self._state: LiveState | None = None
        page = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                # Another name may have been bound to this machine by a page elsewhere.
                if self.headers.get("Host") not in (
                    f"{HOST}:{page.port}",
                    f"localhost:{page.port}",
                ):
                    return self.send_error(421)
                answers = {"/": page.whole, "/state.json": page.numbers}
                if self.path not in answers:
                    return self.send_error(404)
                content, kind = answers[self.path]()
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

    def show(self, state: LiveState) -> None:
        """Serve another state from now on."""
        self._state = state

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()

    def whole(self) -> tuple[bytes, str]:
        """Return the page and its type."""
        return self._page, "text/html"

    def numbers(self) -> tuple[bytes, str]:
        """Return the newest state as JSON, and its type."""
        document = {} if self._state is None else page_document(self._state)
        return to_strict_json(document).encode("utf-8"), "application/json"
