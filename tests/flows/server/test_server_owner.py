"""A server that outlives its owner by a second is not taken, and one that dies is started again."""

import errno
import json
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from fast.flows.server import server as prefect_server
from fast.flows.server.server import ANY_PORT, find_server, server
from fast.models.errors import FastError
from tests.flows.server.test_crashed_runs import GONE, OWN

ADDRESS = {"PREFECT_API_URL": "http://127.0.0.1:4200/api", "PREFECT_API_AUTH_STRING": "fast:x"}


@pytest.mark.parametrize(("owner", "is_taken"), [(OWN, True), (GONE, False)])
def test_only_a_server_with_a_living_owner_is_taken(tmp_path, monkeypatch, owner, is_taken):
    monkeypatch.setattr(prefect_server, "is_healthy", lambda url: True)
    (tmp_path / ".state").mkdir()
    note = {"api_url": "http://127.0.0.1:4200/api", "pid": 1, "owner_pid": owner.pid}
    (tmp_path / ".state" / "server.json").write_text(json.dumps(note))
    assert (find_server(tmp_path) is not None) == is_taken


def test_the_server_of_another_users_lake_is_left_to_that_user(tmp_path, monkeypatch):
    """It advised to change permissions that the program itself sets."""

    def refuse(path, mode):
        raise PermissionError(errno.EPERM, "Operation not permitted", str(path))

    monkeypatch.setattr(Path, "chmod", refuse)
    with pytest.raises(FastError, match="is another user's, who alone starts the server of this lake; ask that user"):
        prefect_server.start_server(tmp_path, ANY_PORT)


def test_a_dead_server_is_started_again_and_its_address_written(tmp_path, monkeypatch):
    (tmp_path / ".state").mkdir()
    is_over = threading.Event()

    def restart() -> bool:
        is_over.set()
        return True

    monkeypatch.setattr(prefect_server, "KEEP_S", 0.01)
    process = SimpleNamespace(restart_if_dead=restart, environment=ADDRESS, pid=7)
    prefect_server._keep_alive(tmp_path, process, is_over)
    assert json.loads((tmp_path / ".state" / "server.json").read_text())["pid"] == 7


def test_two_commands_at_once_start_one_server(tmp_path, monkeypatch):
    """Two Prefect servers that make one database at once end with `no such table`."""
    started = []

    def start(lake_root, port):
        started.append(port)
        time.sleep(0.5)  # the other command looks for a server meanwhile
        (lake_root / ".state" / "server.json").write_text(
            json.dumps({"api_url": "http://127.0.0.1:4200/api", "pid": 1, "owner_pid": OWN.pid})
        )
        return SimpleNamespace(environment=ADDRESS, pid=1, restart_if_dead=lambda: False, stop=lambda: None)

    monkeypatch.setattr(prefect_server, "is_healthy", lambda api: True)
    monkeypatch.setattr(prefect_server, "start_server", start)
    both_in, urls = threading.Barrier(2, timeout=30), []

    def use():
        with server(tmp_path) as api:
            urls.append(api.url)
            both_in.wait()

    others = [threading.Thread(target=use) for _ in range(2)]
    for other in others:
        other.start()
    for other in others:
        other.join()
    assert urls == [ADDRESS["PREFECT_API_URL"]] * 2
    assert len(started) == 1
