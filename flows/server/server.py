"""Find or start the Prefect server: `fast serve`'s, or one embedded in the process that needs it."""

import fcntl
import json
import os
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from http import HTTPStatus
from pathlib import Path
from typing import Any

from fast.flows.server.access import Api, own_login
from fast.flows.server.child_process import ChildProcess
from fast.flows.server.database import keep_empty_database, name_database, take_empty_database
from fast.flows.server.environment import enter_environment, list_ignored, make_environment, named_server
from fast.flows.server.loopback import LOOPBACK, join_numbers, open_listeners
from fast.flows.server.run_process import is_process_alive
from fast.lake.storage.files import writing_failed
from fast.lake.store import Lake
from fast.models.errors import FastError, UsageError

START_LIMIT_S = 600.0  # the first start on a machine makes a database: 10 s when it is idle, minutes when busy
KEEP_S = 1.0  # between looks at a server of ours
LISTEN_BACKLOG = 1024  # requests that wait while the server starts again
DEFAULT_PORT = 4200
ANY_PORT = 0  # the system chooses one that is free

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


def state_folder(lake_root: Path) -> Path:
    """Return where Prefect's own database for this lake lives; it can be deleted without losing data."""
    return lake_root / ".state" / "prefect"


def address_for_others(lake: Lake) -> str:
    """Return the address of a lake for processes with another working folder."""
    return str(lake.root.resolve()) if Path(lake.address) == lake.root else lake.address


def configure_client(api: Api, lake_root: Path) -> None:
    """Set this process's Prefect settings; must come before `import prefect`."""
    enter_environment(api, state_folder(lake_root))


def ask_server(api: Api, path: str, body: Any = None, timeout_s: float = 10.0, method: str | None = None) -> Any:
    """Return the server's answer to a GET, or to a POST of `body`, without the cost of importing Prefect.

    `method`: another one, such as PATCH.

    Raises:
        OSError: no answer, or a refusal (`urllib.error.HTTPError`).
    """
    headers = {"Content-Type": "application/json", **api.headers}
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(f"{api.url}{path}", data, headers, method=method)
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
def server(lake_root: Path, port: int | None = None) -> Iterator[Api]:
    """Yield a server: the one that FAST_PREFECT_API_URL names, one that serves this lake already, or a new one.

    A new server is started again when it dies, stopped on exit, and stops by itself when this process dies.

    Raises:
        UsageError: the server that was named does not answer.
        FastError: a new one did not become healthy.
    """
    process, api = None, reach_named_server()
    with in_turn(lake_root):
        api = api or find_server(lake_root)
        if api is None:
            process = start_server(lake_root, port or ANY_PORT)
            api = get_api(process)
    if process is None:
        yield api
        return
    is_over = threading.Event()
    watcher = threading.Thread(
        target=_keep_alive, args=(lake_root, process, is_over), daemon=True, name="server-watcher"
    )
    watcher.start()
    try:
        yield api
    finally:
        is_over.set()
        watcher.join()
        stop_server(lake_root, process)


@contextmanager
def in_turn(lake_root: Path) -> Iterator[None]:
    """Keep other processes from looking for a server of this lake or starting one: two would make one database at once.

    Where there are no locks, nobody waits.
    """
    with ExitStack() as stack:
        with suppress(OSError):
            home = lake_root / ".state"
            home.mkdir(parents=True, exist_ok=True)
            fcntl.flock(stack.enter_context((home / "starting").open("a")), fcntl.LOCK_EX)
        yield


def _keep_alive(lake_root: Path, process: ChildProcess, is_over: threading.Event) -> None:
    """Start a server of ours again when it died, until it is over; clients ask again meanwhile."""
    while not is_over.wait(KEEP_S):
        if process.restart_if_dead():
            note_server(lake_root, process)


def reach_named_server() -> Api | None:
    """Return the server that FAST_PREFECT_API_URL names, if it names one.

    Raises:
        UsageError: it does not answer, or does not let us in.
    """
    named = named_server()
    if named is None or is_healthy(named):
        return named
    raise UsageError(
        f"FAST_PREFECT_API_URL is {named.url}, which does not answer or does not let us in; start that server, set "
        "FAST_PREFECT_API_AUTH_STRING to its user:password, or unset both, and FAST brings its own."
    )


def report_ignored() -> str | None:
    """Return the sentence about settings for another Prefect, if there are any."""
    ignored = list_ignored()
    if not ignored:
        return None
    return (
        f"left aside, since FAST brings its own Prefect server: {', '.join(ignored)} "
        "(a setting that is meant for FAST is named FAST_PREFECT_...)"
    )


def find_server(lake_root: Path) -> Api | None:
    """Find a server that already serves this lake, if it answers."""
    api = read_address(_address_file(lake_root), lake_root)
    return api if api is not None and is_healthy(api) else None


def find_any_server(lake: Lake) -> Api | None:
    """Find the server that is named, or one that already serves this lake."""
    return named_server() or find_server(lake.root)


def read_address(file: Path, lake_root: Path) -> Api | None:
    """Read what a living process of this machine has written of its server; None where there is none.

    A server whose owner is dead may still answer, but follows it within a second.
    """
    try:
        entry = json.loads(file.read_text())
        url, owner_pid = str(entry["api_url"]), int(entry["owner_pid"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    is_ours = url.startswith(f"http://{LOOPBACK}:") and is_process_alive(owner_pid)
    return Api(url, own_login(lake_root)) if is_ours else None


def is_healthy(api: Api) -> bool:
    """Return True when the server answers its health check, and lets us in."""
    try:
        return ask_server(api, "/health", timeout_s=2) is True
    except (OSError, ValueError, urllib.error.URLError):
        return False


def start_server(lake_root: Path, port: int, host: str = LOOPBACK) -> ChildProcess:
    """Start a server of this lake and wait until it answers; others find it by the lake's address file.

    This process holds the listening socket, and only hands it on: while a server that was killed is started again,
    clients wait in the queue of the socket. A refused one would ask again after 1, 2, 4, ... 64 s, and come late.

    Raises:
        FastError: the port is taken, the folder of its state cannot be written or is another user's, or it did not
            become healthy.
    """
    home = state_folder(lake_root)
    try:
        home.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise writing_failed(home, error) from error
    try:
        home.chmod(0o700)  # its database holds what the pages show
    except PermissionError as error:
        raise FastError(
            f"{home} is another user's, who alone starts the server of this lake; ask that user for `fast serve`."
        ) from error
    login = own_login(lake_root)
    listeners = _listen(host, port)
    port = int(listeners[0].getsockname()[1])
    api = Api(f"http://{LOOPBACK}:{port}/api", login)
    environment = make_environment(api, home)
    name_database(environment)
    environment["FAST_SERVER_LOGIN"] = login
    environment["PREFECT_SERVER_CORS_ALLOWED_ORIGINS"] = api.page  # not the default, which is everybody
    for name, value in {**TIDY, **ROUNDS}.items():
        environment.setdefault(name, value)
    # Pages that were opened under another name ask the server they came from.
    environment.setdefault("PREFECT_UI_API_URL", "/api")
    arguments = [join_numbers(listeners), str(os.getpid()), str((lake_root / "outputs").resolve())]
    process = ChildProcess("fast.flows.server.server_process", arguments, environment, home / "server.log", listeners)
    is_made_by_prefect = take_empty_database(home)
    process.start()
    try:
        _wait_until_healthy(api, process)
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
        json.dumps({"api_url": get_api(process).url, "pid": process.pid, "owner_pid": os.getpid()})
    )


def stop_server(lake_root: Path, process: ChildProcess) -> None:
    """Stop a server of ours."""
    _address_file(lake_root).unlink(missing_ok=True)
    process.stop()


def get_api(process: ChildProcess) -> Api:
    """Return address and login of a server of ours, for processes of this machine."""
    return Api(process.environment["PREFECT_API_URL"], process.environment["PREFECT_API_AUTH_STRING"])


def _wait_until_healthy(api: Api, process: ChildProcess) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while not is_healthy(api):
        if not process.is_alive():
            raise FastError(f"the Prefect server ended while it started: {_last_words(process)}; run `fast doctor`.")
        if time.monotonic() > deadline:
            raise FastError(
                f"the Prefect server did not start within {START_LIMIT_S:.0f} s; its log is {process.log_path}; "
                "run `fast doctor`, then try again."
            )
        time.sleep(0.2)


def _last_words(process: ChildProcess) -> str:
    lines = process.log_path.read_text(errors="replace").strip().splitlines()
    return f"{lines[-1].strip()[:200] if lines else 'it said nothing'} (its log is {process.log_path})"


def _address_file(lake_root: Path) -> Path:
    return lake_root / ".state" / "server.json"


def _listen(host: str, port: int) -> list[socket.socket]:
    try:
        return open_listeners(host, port, LISTEN_BACKLOG)
    except OSError as error:
        raise FastError(f"port {port} of {host} cannot be used ({error.strerror}); give another one.") from error
