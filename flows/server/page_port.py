"""The port of the lab's page, kept open as long as a command runs; its process starts when somebody comes."""

import json
import os
import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fast.flows.server.access import Api, own_login
from fast.flows.server.child_process import ChildProcess
from fast.flows.server.environment import FOLDER_VARIABLE
from fast.flows.server.loopback import LOOPBACK, join_numbers, open_listeners
from fast.flows.server.server import address_for_others, read_address
from fast.lake.storage.files import writing_failed
from fast.lake.store import Lake
from fast.models.errors import UsageError

PORT = 4210
LOGIN_VARIABLE = "FAST_PAGE_LOGIN"
_LOOK_S = 1.0
_BACKLOG = 256


class PageServer:
    """The port of a lake's page. Whoever comes while its process is not there waits until it is."""

    def __init__(self, lake: Lake, listeners: list[socket.socket]) -> None:
        login = own_login(lake.root)
        port = listeners[0].getsockname()[1]
        self.api = Api(f"http://{LOOPBACK}:{port}/api", login)
        self._listeners, self._lake = listeners, lake
        self._is_over = threading.Event()
        home = lake.root / ".state" / "page"
        try:
            home.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise writing_failed(home, error) from error
        environment = {**os.environ, LOGIN_VARIABLE: login, FOLDER_VARIABLE: os.getcwd()}
        arguments = [join_numbers(listeners), str(os.getpid()), address_for_others(lake)]
        self._process = ChildProcess("fast.flows.page.process", arguments, environment, home / "page.log", listeners)
        self._watcher = threading.Thread(target=self._serve_on, daemon=True, name="page-watcher")
        self._watcher.start()
        _address_file(lake.root).write_text(json.dumps({"api_url": self.api.url, "owner_pid": os.getpid()}))

    @property
    def pid(self) -> int:
        """Process id of the page, 0 before somebody came."""
        return self._process.pid

    def start(self) -> None:
        """Start the process now, so that the first who comes need not wait."""
        if not self._process.is_alive():
            self._process.start()

    def close(self) -> None:
        """Give the port back, and end the process."""
        self._is_over.set()
        self._watcher.join()
        _address_file(self._lake.root).unlink(missing_ok=True)
        self._process.stop()

    def _serve_on(self) -> None:
        """Start the process when somebody waits and none is there; not at once, where one has died at once."""
        while not self._is_over.wait(0.0 if self._process.pid == 0 else _LOOK_S):
            if self._process.is_alive():
                continue
            if select.select(self._listeners, [], [], _LOOK_S)[0] and not self._is_over.is_set():
                if self._process.pid == 0:
                    self._process.start()
                else:
                    self._process.restart_if_dead()


@contextmanager
def serve_page(lake: Lake, port: int | None = None, host: str = LOOPBACK) -> Iterator[Api]:
    """Yield the page of a lake: the one that another command of this machine serves, or a new one on its port.

    `port`: None is 4210, or a free one where that is taken.

    Raises:
        UsageError: the port is taken.
    """
    known = find_page(lake.root)
    if known is not None:
        yield known
        return
    page = PageServer(lake, listen(port, host))
    try:
        yield page.api
    finally:
        page.close()


def listen(port: int | None, host: str = LOOPBACK) -> list[socket.socket]:
    """Return listening sockets; `port`: None is 4210, or a free one where that is taken, 0 a free one.

    Raises:
        UsageError: the port is taken.
    """
    try:
        return open_listeners(host, PORT if port is None else port, _BACKLOG)
    except OSError as error:
        if port is None:
            return listen(0, host)
        raise UsageError(
            f"--page-port {port} cannot be used on {host} ({error.strerror}); give another one."
        ) from error


def find_page(lake_root: Path) -> Api | None:
    """Find the page that a process of this machine serves for this lake."""
    return read_address(_address_file(lake_root), lake_root)


def _address_file(lake_root: Path) -> Path:
    return lake_root / ".state" / "page.json"
