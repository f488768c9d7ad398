"""The session as a page of this machine: one server in a thread, and nothing else is asked for."""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any

from surge_core.errors import InputError
from surge_core.files import to_strict_json

HOST = "127.0.0.1"


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
                if self.path == "/":
                    content, kind = page._page, "text/html"
                elif self.path == "/state.json":
                    content = to_strict_json(page._document).encode("utf-8")
                    kind = "application/json"
                else:
                    return self.send_error(404)
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
