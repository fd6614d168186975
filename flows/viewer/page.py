"""A recording in a browser of this machine: Rerun's page and the recording, from one server behind the lake's gate.

The servers that Rerun brings ask nobody for a key, so none of them stays open. Its program hands out the files of its
page once, before there is anything to see, and ends. As it is, that page loads fonts and scripts from the network and
reports what it is used for; a policy forbids the browser to ask any other server than ours.
"""

import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING

from fast.flows.server.access import Api, address_for_person
from fast.flows.server.gate import App, add_gate
from fast.models.errors import FastError

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

LOOPBACK = "127.0.0.1"
PORT = 9090  # Rerun's own, if it is free: people forward it through ssh
START_LIMIT_S = 30.0
LOOK_S = 0.2  # between looks at a recording that grows
RECORDING = "/recording.rrd"
FILES = ("/", "/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.ico")
POLICY = "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob: data:"
# Its page asks for a recording without the cookie, which is what lets a browser in.
_WITH_COOKIE = b"""<script>
const ask = window.fetch;
window.fetch = (what, how) => ask(new Request(what, {...how, credentials: "same-origin"}));
</script>
"""
_PIECE_BYTES = 1 << 20
# `CI` is the only way to have it send nothing without changing a user's own settings of Rerun.
_QUIET = {"CI": "1", "RUST_LOG": "info"}
_ASKS_FOR_ANALYTICS = "FORCE_RERUN_ANALYTICS"

Files = dict[str, tuple[bytes, str]]  # content and kind, by path


@contextmanager
def open_page(recording: Path, login: str, is_whole: threading.Event) -> Iterator[str]:
    """Serve a recording with Rerun's page until the `with` block ends; gives the address for a browser.

    Until the recording is whole, the page gets what is written to it. `login`: `user:password` of the lake.

    Raises:
        FastError: Rerun did not give its page.
    """
    import uvicorn

    app = add_gate(make_app(read_files(), recording, is_whole), login, LOOPBACK)
    with _listen() as listener:
        config = uvicorn.Config(app, lifespan="off", log_level="critical", proxy_headers=False)
        config.timeout_graceful_shutdown = 1  # a browser may still wait for more of the recording
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, args=([listener],), daemon=True, name="viewer-page")
        thread.start()
        try:
            yield address_for_person(Api(f"http://{LOOPBACK}:{listener.getsockname()[1]}/api", login))
        finally:
            server.should_exit = True
            thread.join()


def make_app(files: Files, recording: Path, is_whole: threading.Event) -> App:
    """Make the page with its recording, without the gate."""
    from starlette.applications import Starlette
    from starlette.responses import RedirectResponse, Response, StreamingResponse
    from starlette.routing import Route

    headers = {"Content-Security-Policy": POLICY, "Cache-Control": "no-store"}

    async def send_file(request: "Request") -> "Response":
        path = request.url.path
        if path == "/" and "url" not in request.query_params:
            return RedirectResponse(f"/?url={request.base_url}{RECORDING[1:]}", 303, headers)
        content, kind = files[path]
        # Its page shows how much of a file is there by its length.
        return Response(content, headers={**headers, "rerun-final-length": str(len(content))}, media_type=kind)

    async def send_recording(_: "Request") -> "Response":
        return StreamingResponse(_follow(recording, is_whole), 200, headers, "application/octet-stream")

    return Starlette(routes=[Route(RECORDING, send_recording), *(Route(path, send_file) for path in files)])


async def _follow(recording: Path, is_whole: threading.Event) -> AsyncIterator[bytes]:
    """Yield a recording piece by piece, until it is whole."""
    import asyncio

    with recording.open("rb") as file:
        while True:
            is_last = is_whole.is_set()  # asked first: what is written until then is still sent
            while piece := file.read(_PIECE_BYTES):
                yield piece
            if is_last:
                return
            await asyncio.sleep(LOOK_S)


def read_files() -> Files:
    """Read the files of Rerun's page, from its program.

    Raises:
        FastError: it did not give them.
    """
    # With an address to show, it serves the page alone and opens no port for data.
    command = [sys.executable, "-m", "rerun_cli", "--serve-web", "--bind", LOOPBACK, "--web-viewer-port", "0"]
    environment = {name: value for name, value in os.environ.items() if name != _ASKS_FOR_ANALYTICS}
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(
            [*command, f"http://{LOOPBACK}{RECORDING}"],
            env=environment | _QUIET,
            stdout=log,
            stderr=log,
            start_new_session=True,  # it starts a program of its own, and both have to end
        )
        try:
            source = _wait_for_address(process, log)
            files = {path: _read_file(f"{source}{path}") for path in FILES}
        except OSError as error:
            raise FastError(_did_not_start(f"{error}")) from error
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            process.wait()
    page, kind = files["/"]
    return {**files, "/": (page.replace(b"<html>", b"<html>" + _WITH_COOKIE, 1), kind)}


def _read_file(address: str) -> tuple[bytes, str]:
    with urllib.request.urlopen(address, timeout=START_LIMIT_S) as answer:
        return answer.read(), answer.headers["Content-Type"]


def _wait_for_address(process: "subprocess.Popen[bytes]", log: IO[bytes]) -> str:
    """Return where Rerun serves its page, as it says itself: others could meanwhile take a port that we chose."""
    deadline = time.monotonic() + START_LIMIT_S
    while True:
        is_alive = process.poll() is None
        log.seek(0)
        words = log.read().decode(errors="replace")
        if found := re.search(rf"http://{re.escape(LOOPBACK)}:\d+", words):
            return found[0]
        if not is_alive or time.monotonic() > deadline:
            lines = [line.strip() for line in words.splitlines() if line.strip()]
            raise FastError(_did_not_start(lines[-1] if lines else f"it ended with status {process.returncode}"))
        time.sleep(0.05)


def _did_not_start(why: str) -> str:
    return f"Rerun's viewer did not start: {why}; write the recording with --save FILE and open it elsewhere."


def _listen() -> socket.socket:
    """Return a listening socket on Rerun's own port, or on a free one."""
    try:
        return socket.create_server((LOOPBACK, PORT))
    except OSError:
        return socket.create_server((LOOPBACK, 0))
