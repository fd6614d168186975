"""Find or start the Prefect server: `fast serve`'s, or one embedded in the process that needs it."""

import json
import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from models.errors import FastError

START_LIMIT_S = 180.0  # the first start migrates a new database: 10 s on an idle machine, a minute on a busy one

_OFFLINE = {
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "DO_NOT_TRACK": "1",
    "PREFECT_CLOUD_ENABLE_ORCHESTRATION_TELEMETRY": "false",
    "PREFECT_SERVER_UI_SHOW_PROMOTIONAL_CONTENT": "false",
    "PREFECT_SERVER_UI_V2_ENABLED": "false",
}


def state_folder(lake_root: Path) -> Path:
    """Where Prefect's own database for this lake lives; it can be deleted without losing data."""
    return lake_root / ".state" / "prefect"


def configure_client(api_url: str, lake_root: Path) -> None:
    """Set this process's Prefect settings; must come before `import prefect`."""
    os.environ.update(_OFFLINE)
    os.environ["PREFECT_API_URL"] = api_url
    os.environ.setdefault("PREFECT_HOME", str(state_folder(lake_root)))
    os.environ.setdefault("PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL", "CRITICAL")


@contextmanager
def server(lake_root: Path, port: int | None = None) -> Iterator[str]:
    """API address of a server: the environment's, one that serves this lake already, or a new one.

    A new server is stopped on exit, and stops by itself when this process dies.

    Raises:
        FastError: the server did not become healthy.
    """
    known = os.environ.get("PREFECT_API_URL") or running_server(lake_root)
    if known:
        yield known
        return
    with _own_server(lake_root, port or _free_port()) as url:
        yield url


def running_server(lake_root: Path) -> str | None:
    """API address of a server that already serves this lake, if it answers."""
    try:
        url = json.loads(_address_file(lake_root).read_text())["api_url"]
    except (OSError, ValueError, KeyError):
        return None
    return url if is_healthy(url) else None


def is_healthy(api_url: str) -> bool:
    """True when the server answers its health check."""
    try:
        with urllib.request.urlopen(f"{api_url}/health", timeout=2) as answer:
            return answer.status == 200
    except (OSError, urllib.error.URLError):
        return False


@contextmanager
def _own_server(lake_root: Path, port: int) -> Iterator[str]:
    home = state_folder(lake_root)
    home.mkdir(parents=True, exist_ok=True)
    url = f"http://127.0.0.1:{port}/api"
    environment = {**os.environ, **_OFFLINE, "PREFECT_HOME": str(home), "PREFECT_API_URL": url}
    log_path = home / "server.log"
    with log_path.open("ab") as log:
        child = subprocess.Popen(
            [sys.executable, "-m", "flows.prefect_server", str(port), str(os.getpid())],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,  # Ctrl-C in the terminal is for us; we stop the server when we are done
        )
    try:
        _wait_until_healthy(url, child, log_path)
        _address_file(lake_root).write_text(json.dumps({"api_url": url, "pid": child.pid}))
        yield url
    finally:
        _address_file(lake_root).unlink(missing_ok=True)
        child.terminate()
        try:
            child.wait(timeout=15)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


def _wait_until_healthy(url: str, child: "subprocess.Popen[bytes]", log_path: Path) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while not is_healthy(url):
        if child.poll() is not None or time.monotonic() > deadline:
            raise FastError(
                f"the Prefect server did not start within {START_LIMIT_S:.0f} s; its log is {log_path}; "
                "run `fast doctor`, then try again."
            )
        time.sleep(0.2)


def _address_file(lake_root: Path) -> Path:
    return lake_root / ".state" / "server.json"


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _serve(port: int, parent_pid: int) -> None:
    """Body of the server's own process."""
    import uvicorn

    from tasks.pool import follow_parent

    follow_parent(parent_pid)
    uvicorn.run("prefect.server.api.server:create_app", factory=True, host="127.0.0.1", port=port, log_level="warning")


if __name__ == "__main__":
    _serve(int(sys.argv[1]), int(sys.argv[2]))
