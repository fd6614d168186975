"""Find or start the Prefect server: `fast serve`'s, or one embedded in the process that needs it."""

import base64
import json
import os
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import Any

from fast.flows.server.child_process import ChildProcess
from fast.flows.server.database import keep_empty_database, take_empty_database
from fast.flows.server.run_process import is_process_alive
from fast.lake.storage.files import writing_failed
from fast.lake.store import Lake
from fast.models.errors import FastError

START_LIMIT_S = 600.0  # the first start on a machine makes a database: 10 s when it is idle, minutes when busy
KEEP_S = 1.0  # between looks at a server of ours
LISTEN_BACKLOG = 1024  # requests that wait while the server starts again
LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 4200
ANY_PORT = 0  # the system chooses one that is free
PASSWORD_VARIABLE = "FAST_PASSWORD"
USER = "fast"

OFFLINE = {
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "DO_NOT_TRACK": "1",
    "PREFECT_CLOUD_ENABLE_ORCHESTRATION_TELEMETRY": "false",
    "PREFECT_SERVER_UI_SHOW_PROMOTIONAL_CONTENT": "false",
    "PREFECT_SERVER_UI_V2_ENABLED": "false",
}
# Runs are forgotten three months after their end, with their tasks and logs; events after a week. The lake keeps all.
TIDY = {
    "PREFECT_SERVER_SERVICES_DB_VACUUM_ENABLED": "events,flow_runs",
    "PREFECT_SERVER_SERVICES_DB_VACUUM_RETENTION_PERIOD": str(90 * 86400),
}
# Seconds between the rounds of the services, where Prefect has 5 to 20: late runs and workers that are gone are
# marked, and new schedules planned, within a minute. Runs whose process is gone we find ourselves.
ROUNDS = {
    "PREFECT_SERVER_SERVICES_LATE_RUNS_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_SCHEDULER_RECENT_DEPLOYMENTS_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_FOREMAN_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_PAUSE_EXPIRATIONS_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_REPOSSESSOR_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_CLEANUP_RECONCILER_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_CANCELLATION_CLEANUP_LOOP_SECONDS": "60",
    "PREFECT_SERVER_EVENTS_PROACTIVE_GRANULARITY": "PT60S",
}
PATIENT = {"PREFECT_CLIENT_MAX_RETRIES": "7"}  # about four minutes, where a server of others is gone


def state_folder(lake_root: Path) -> Path:
    """Where Prefect's own database for this lake lives; it can be deleted without losing data."""
    return lake_root / ".state" / "prefect"


def address_for_others(lake: Lake) -> str:
    """Address of a lake for processes with another working folder."""
    return str(lake.root.resolve()) if Path(lake.address) == lake.root else lake.address


def configure_client(api_url: str, lake_root: Path) -> None:
    """Set this process's Prefect settings; must come before `import prefect`."""
    os.environ.update(client_environment(api_url))
    os.environ.setdefault("PREFECT_HOME", str(state_folder(lake_root)))
    os.environ.setdefault("PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL", "CRITICAL")


def client_environment(api_url: str) -> dict[str, str]:
    """Settings of a process that talks to the server: its address, its password if it has one, and no telemetry."""
    settings = {**OFFLINE, **PATIENT, "PREFECT_API_URL": api_url}
    if login := _login():
        settings.setdefault("PREFECT_API_AUTH_STRING", login)
    return settings


def _login() -> str | None:
    """`user:password` of the server, where the environment has a password."""
    password = os.environ.get(PASSWORD_VARIABLE)
    return f"{USER}:{password}" if password else None


def ask_server(api_url: str, path: str, body: Any = None, timeout_s: float = 10.0, method: str | None = None) -> Any:
    """Answer of the server to a GET, or to a POST of `body`, without the cost of importing Prefect.

    `method`: another one, such as PATCH.

    Raises:
        OSError: no answer, or a refusal (`urllib.error.HTTPError`).
    """
    headers = {"Content-Type": "application/json"}
    login = os.environ.get("PREFECT_API_AUTH_STRING") or _login()
    if login:
        headers["Authorization"] = f"Basic {base64.b64encode(login.encode()).decode()}"
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(f"{api_url}{path}", data, headers, method=method)
    for patience_s in (0.5, 1.0, 2.0, 4.0, 0.0):
        try:
            with urllib.request.urlopen(request, timeout=timeout_s) as answer:
                content = answer.read()
            return json.loads(content) if content else None
        except urllib.error.HTTPError as error:
            # SQLite was busy for longer than the server waits for it.
            if error.code != HTTPStatus.SERVICE_UNAVAILABLE or not patience_s:
                raise
        time.sleep(patience_s)
    return None


@contextmanager
def server(lake_root: Path, port: int | None = None) -> Iterator[str]:
    """API address of a server: the environment's, one that serves this lake already, or a new one.

    A new server is started again when it dies, stopped on exit, and stops by itself when this process dies.

    Raises:
        FastError: the server did not become healthy.
    """
    known = os.environ.get("PREFECT_API_URL") or find_server(lake_root)
    if known:
        yield known
        return
    process = start_server(lake_root, port or ANY_PORT)
    is_over = threading.Event()
    watcher = threading.Thread(
        target=_keep_alive, args=(lake_root, process, is_over), daemon=True, name="server-watcher"
    )
    watcher.start()
    try:
        yield get_api_url(process)
    finally:
        is_over.set()
        watcher.join()
        stop_server(lake_root, process)


def _keep_alive(lake_root: Path, process: ChildProcess, is_over: threading.Event) -> None:
    """Start a server of ours again when it died, until it is over; clients ask again meanwhile."""
    while not is_over.wait(KEEP_S):
        if process.restart_if_dead():
            note_server(lake_root, process)


def find_server(lake_root: Path) -> str | None:
    """API address of a server that already serves this lake, if it answers."""
    try:
        entry = json.loads(_address_file(lake_root).read_text())
        url, owner_pid = str(entry["api_url"]), int(entry["owner_pid"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    if not is_process_alive(owner_pid):
        return None  # it may still answer, but follows its owner within a second
    return url if url.startswith(f"http://{LOOPBACK}:") and is_healthy(url) else None


def is_healthy(api_url: str) -> bool:
    """True when the server answers its health check."""
    try:
        return ask_server(api_url, "/health", timeout_s=2) is True
    except (OSError, ValueError, urllib.error.URLError):
        return False


def start_server(lake_root: Path, port: int, host: str = LOOPBACK) -> ChildProcess:
    """Start a server of this lake and wait until it answers; others find it by the lake's address file.

    This process holds the listening socket, and only hands it on: while a server that was killed is started again,
    clients wait in the queue of the socket. A refused one would ask again after 1, 2, 4, ... 64 s, and come late.

    Raises:
        FastError: the port is taken, the folder of its state cannot be written, or it did not become healthy.
    """
    home = state_folder(lake_root)
    try:
        home.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise writing_failed(home, error) from error
    listener = _listen(host, port)
    port = int(listener.getsockname()[1])
    url = f"http://{LOOPBACK}:{port}/api"
    environment = {**os.environ, **client_environment(url), "PREFECT_HOME": str(home)}
    if login := _login():
        environment["PREFECT_SERVER_API_AUTH_STRING"] = login
    for name, value in {**TIDY, **ROUNDS}.items():
        environment.setdefault(name, value)
    # Pages that were opened under another name ask the server they came from.
    environment.setdefault("PREFECT_UI_API_URL", "/api")
    arguments = [str(listener.fileno()), str(os.getpid()), str(lake_root / "outputs")]
    process = ChildProcess("fast.flows.server.server_process", arguments, environment, home / "server.log", listener)
    is_made_by_prefect = take_empty_database(home)
    process.start()
    try:
        _wait_until_healthy(url, process)
        if is_made_by_prefect:
            keep_empty_database(home)
    except BaseException:
        process.stop()
        raise
    note_server(lake_root, process)
    return process


def note_server(lake_root: Path, process: ChildProcess) -> None:
    """Write the address of a server where other processes of this machine look for it."""
    _address_file(lake_root).write_text(
        json.dumps({"api_url": get_api_url(process), "pid": process.pid, "owner_pid": os.getpid()})
    )


def stop_server(lake_root: Path, process: ChildProcess) -> None:
    """Stop a server of ours."""
    _address_file(lake_root).unlink(missing_ok=True)
    process.stop()


def get_api_url(process: ChildProcess) -> str:
    """API address of a server of ours, for processes of this machine."""
    return process.environment["PREFECT_API_URL"]


def _wait_until_healthy(url: str, process: ChildProcess) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while not is_healthy(url):
        if not process.is_alive() or time.monotonic() > deadline:
            raise FastError(
                f"the Prefect server did not start within {START_LIMIT_S:.0f} s; its log is {process.log_path}; "
                "run `fast doctor`, then try again."
            )
        time.sleep(0.2)


def _address_file(lake_root: Path) -> Path:
    return lake_root / ".state" / "server.json"


def _listen(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host, port), backlog=LISTEN_BACKLOG)
    except OSError as error:
        raise FastError(f"port {port} of {host} cannot be used ({error.strerror}); give another one.") from error
