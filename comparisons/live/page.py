"""The session as a page of this machine: one server in a thread, and nothing else is asked for."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any

from comparisons.live.state import LiveState, page_document
from surge_core.errors import InputError

__all__ = ["Page"]

HOST = "127.0.0.1"
# Requests are answered at once or not at all: a browser has a few connections, not many.
MOST_REQUESTS = 16
PATIENCE_S = 10.0
# The page asks four times a second.
LINGER_S = 0.6
_FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}
_HEADERS = {
    # Nothing but the three files of this page and its numbers; no page may frame it.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Page:
    """Serve the newest state on 127.0.0.1.

    Parameters
    ----------
    port : int
        Port; 0 for any that is free.

    Raises
    ------
    InputError
        When the port is taken.
    """

    def __init__(self, port: int) -> None:
        self._files = {
            path: ((resources.files(__package__) / "web" / name).read_bytes(), kind)
            for path, (name, kind) in _FILES.items()
        }
        self._state: LiveState | None = None
        self._asked = threading.Event()
        try:
            self._server = _Server((HOST, port), self)
        except OSError as error:
            raise InputError(
                "--page",
                expected=f"a port of {HOST} that is free",
                found=f"{port}: {error.strerror or error}",
            ) from None
        self.port = int(self._server.server_address[1])
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.1,), name="page", daemon=True
        )
        self._thread.start()

    @property
    def address(self) -> str:
        """What to type into a browser."""
        return f"http://{HOST}:{self.port}/"

    def show(self, state: LiveState) -> None:
        """Serve another state from now on."""
        self._state = state

    def close(self) -> None:
        """Stop serving, once a browser that is watching has had the last state."""
        if self._asked.is_set():
            self._asked.clear()
            self._asked.wait(LINGER_S)
        self._server.shutdown()
        self._server.server_close()

    def answer(self, path: str) -> tuple[bytes, str] | None:
        """Return content and type of a path, or None where there is nothing.

        Parameters
        ----------
        path : str
            Without its query.
        """
        if path != "/state.json":
            return self._files.get(path)
        state = self._state
        self._asked.set()
        document: dict[str, Any] = {} if state is None else page_document(state)
        text = json.dumps(document, ensure_ascii=False, allow_nan=False)
        return text.encode("utf-8"), "application/json"

    def is_ours(self, host: str | None) -> bool:
        """Tell whether a request names this machine: another name may have been rebound to it.

        Parameters
        ----------
        host : str or None
            The header ``Host``.
        """
        return host in (f"{HOST}:{self.port}", f"localhost:{self.port}")


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, address: tuple[str, int], page: Page) -> None:
        self.page = page
        self._free = threading.BoundedSemaphore(MOST_REQUESTS)
        super().__init__(address, _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, unless too many are at work."""
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer one request."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a browser that goes away is no error."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = PATIENCE_S
    server_version = "sindy-surge"
    sys_version = ""

    def do_GET(self) -> None:
        """Answer with one of the files or with the numbers."""
        if not self.server.page.is_ours(self.headers.get("Host")):
            return self._reply(421, b"another host\n", "text/plain")
        found = self.server.page.answer(self.path.partition("?")[0])
        if found is None:
            return self._reply(404, b"not found\n", "text/plain")
        return self._reply(200, *found)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing."""

    def _reply(self, status: int, content: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)
