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
# A browser that asks four times a second gets the last state.
LINGER_S = 0.6
_FILES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
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
        folder = resources.files(__package__) / "web"
        self._files = {
            path: ((folder / name).read_bytes(), kind) for path, (name, kind) in _FILES.items()
        }
        self._state: LiveState | None = None
        self._asked = threading.Event()
        page = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                # Another name may have been bound to this machine by a page elsewhere.
                if self.headers.get("Host") not in page.names:
                    return self.send_error(421)
                content, kind = page.answer(self.path.partition("?")[0])
                if not kind:
                    return self.send_error(404)
                self.send_response(200)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Content-Security-Policy", "default-src 'self'")
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

    @property
    def address(self) -> str:
        """What to type into a browser."""
        return f"http://{HOST}:{self.port}/"

    @property
    def names(self) -> tuple[str, str]:
        """Names under which a browser may ask."""
        return f"{HOST}:{self.port}", f"localhost:{self.port}"

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

    def answer(self, path: str) -> tuple[bytes, str]:
        """Return content and type of a path; an empty type where there is nothing.

        Parameters
        ----------
        path : str
            Without its query.
        """
        if path != "/state.json":
            return self._files.get(path, (b"", ""))
        self._asked.set()
        document = {} if self._state is None else page_document(self._state)
        text = json.dumps(document, ensure_ascii=False, allow_nan=False)
        return text.encode("utf-8"), "application/json"
