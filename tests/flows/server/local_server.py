"""An HTTP server on the loopback address that answers as a test says and keeps what it was sent."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple


class Request(NamedTuple):
    """What came in."""

    method: str
    path: str
    body: Any
    headers: dict[str, str]


def _read(content: bytes, headers: Any) -> Any:
    if headers.get("Content-Type") == "application/octet-stream":
        return content
    return json.loads(content) if content else None


@contextmanager
def local_server(answer: Callable[[Request], tuple[int, Any]]) -> Iterator[tuple[str, list[Request]]]:
    """Address of a server whose answers (status, JSON) come from `answer`, and the list of what it was sent."""
    seen: list[Request] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self._answer()

        def do_POST(self) -> None:
            self._answer()

        def do_PUT(self) -> None:
            self._answer()

        def do_DELETE(self) -> None:
            self._answer()

        def log_message(self, *words: object) -> None:
            pass

        def _answer(self) -> None:
            content = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            request = Request(self.command, self.path, _read(content, self.headers), dict(self.headers))
            seen.append(request)
            status, body = answer(request)
            self.send_response(status)
            self.end_headers()
            self.wfile.write(json.dumps(body).encode())

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", seen
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
