"""The Rerun viewer as a process: a window on the screen of this machine, or a page in its browser.

Nothing of it leaves the machine. It listens on loopback only and sends no usage data. The page is handed on by a
server of ours, with a policy that lets the browser ask this machine only: the page as it is loads fonts and scripts
from the network and reports what it is used for.
"""

import http.client
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import IO

from fast.flows.server.gate import find_fault
from fast.flows.server.loopback import LOOPBACK_NAMES
from fast.models.errors import FastError, MissingDependencyError, UsageError

LOOPBACK = "127.0.0.1"
PAGE_PORT, DATA_PORT = 9090, 9876  # Rerun's own, if they are free: people forward them through ssh
START_LIMIT_S = 30.0
# The only way to have it send nothing without changing a user's own settings of Rerun.
NO_ANALYTICS = {"CI": "1"}
ASKS_FOR_ANALYTICS = "FORCE_RERUN_ANALYTICS"
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
_HANDED_ON = ("Content-Type", "Content-Length", "rerun-final-length")


@dataclass(frozen=True)
class Viewer:
    """A viewer that runs. `data_address`: where recordings can be sent; `page_address`: None for a window."""

    process: "subprocess.Popen[bytes]"
    data_address: str
    page_address: str | None
    log: IO[bytes]

    def wait(self) -> None:
        """Until it is closed.

        Raises:
            FastError: it failed, with the last line that it said.
        """
        if self.process.wait() not in (0, -2, -15):  # Ctrl-C reaches it too
            raise FastError(f"the viewer failed: {self.last_words()}; try --web, or --save FILE and open it elsewhere.")

    def last_words(self) -> str:
        """The last line that it said."""
        self.log.seek(0)
        lines = [line for line in self.log.read().decode(errors="replace").splitlines() if line.strip()]
        return lines[-1].strip() if lines else f"it ended with status {self.process.returncode}"


def check_viewer(is_page: bool) -> None:
    """Refuse what cannot be shown, before a recording is written.

    Raises:
        MissingDependencyError: there is no viewer.
        UsageError: a window is asked for, and there is no screen.
    """
    _find_program()
    if not is_page and not has_screen():
        raise UsageError(
            "this machine has no screen to open a window on (DISPLAY and WAYLAND_DISPLAY are not set); add --web to "
            "look at it in a browser, or --save FILE to write the recording only."
        )


def has_screen() -> bool:
    """Whether windows can be opened here."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in SCREENS)


@contextmanager
def open_viewer(path: Path | None, is_page: bool) -> Iterator[Viewer]:
    """A viewer of a recording, or without one of what is sent to it; it ends with the `with` block.

    Raises:
        FastError: it did not start.
    """
    with ExitStack() as stack:
        data_port = find_port(DATA_PORT)
        command = [_find_program(), "--bind", LOOPBACK, "--port", str(data_port)]
        web_port = find_port()
        if is_page:
            command += ["--serve-web", "--web-viewer-port", str(web_port)]
        environment = {name: value for name, value in os.environ.items() if name != ASKS_FOR_ANALYTICS}
        log = stack.enter_context(tempfile.TemporaryFile())
        process = subprocess.Popen(
            [*command, *([str(path)] if path else [])],
            env=environment | NO_ANALYTICS,
            stdout=log,
            stderr=log,
            start_new_session=True,  # `rerun` starts a program of its own, and both have to end
        )
        stack.callback(_end, process)
        page = stack.enter_context(_hand_on(web_port, data_port)) if is_page else None
        data_address = f"rerun+http://{LOOPBACK}:{data_port}/proxy"
        asked = urllib.parse.urlencode({"url": data_address})
        viewer = Viewer(process, data_address, f"{page}/?{asked}" if page else None, log)
        _wait_until_up(viewer, web_port if is_page else data_port)
        yield viewer


def find_port(wanted: int = 0) -> int:
    """A free port of this machine, the wanted one if it is free."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((LOOPBACK, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise FastError("this machine has no free port for the viewer; close programs that listen, then try again.")


@contextmanager
def _hand_on(web_port: int, data_port: int) -> Iterator[str]:
    """Hand Rerun's page on with a policy that lets it ask this machine only; gives the address."""
    source = f"http://{LOOPBACK}:{web_port}"
    policy = (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob: data:; "
        f"connect-src 'self' http://{LOOPBACK}:{data_port}"
    )

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked = {name.lower(): value for name, value in self.headers.items()}
            if sentence := find_fault(asked, frozenset(LOOPBACK_NAMES)):
                self.send_error(403, sentence)
                return
            try:
                with urllib.request.urlopen(f"{source}{self.path}", timeout=START_LIMIT_S) as answer:
                    self.send_response(answer.status)
                    for name in _HANDED_ON:
                        if (value := answer.headers.get(name)) is not None:
                            self.send_header(name, value)
                    self.send_header("Content-Security-Policy", policy)
                    self.end_headers()
                    shutil.copyfileobj(answer, self.wfile)
            except urllib.error.HTTPError as error:
                self.send_error(error.code)
            except (BrokenPipeError, ConnectionResetError):
                pass  # the browser has gone
            except (OSError, http.client.HTTPException):
                self.send_error(502)

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing of each request."""

    with ThreadingHTTPServer((LOOPBACK, find_port(PAGE_PORT)), Handler) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True, name="viewer-page").start()
        try:
            yield f"http://{LOOPBACK}:{server.server_address[1]}"
        finally:
            server.shutdown()


def _wait_until_up(viewer: Viewer, port: int) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while time.monotonic() < deadline and viewer.process.poll() is None:
        with socket.socket() as probe:
            if probe.connect_ex((LOOPBACK, port)) == 0:
                return
        time.sleep(0.05)
    if viewer.process.poll() is None:
        raise FastError(f"the viewer did not start within {START_LIMIT_S:.0f} s: {viewer.last_words()}.")
    viewer.wait()


def _end(process: "subprocess.Popen[bytes]") -> None:
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
    process.wait()


def _find_program() -> str:
    """The Rerun viewer beside this Python, or on the path.

    Raises:
        MissingDependencyError: there is none.
    """
    beside = str(Path(sys.executable).parent)
    viewer = shutil.which("rerun", path=beside) or shutil.which("rerun")
    if viewer is None:
        raise MissingDependencyError(
            "the viewer `rerun` is not installed; run `make setup`, or write the recording to a file with --save."
        )
    return viewer
