"""A server that outlives its owner by a second is not taken, and one that dies is started again."""

import json
import threading
from types import SimpleNamespace

import pytest

from fast.flows.server import server as prefect_server
from fast.flows.server.server import find_server
from tests.flows.server.test_crashed_runs import GONE, OWN


@pytest.mark.parametrize(("owner", "is_taken"), [(OWN, True), (GONE, False)])
def test_only_a_server_with_a_living_owner_is_taken(tmp_path, monkeypatch, owner, is_taken):
    monkeypatch.setattr(prefect_server, "is_healthy", lambda url: True)
    (tmp_path / ".state").mkdir()
    note = {"api_url": "http://127.0.0.1:4200/api", "pid": 1, "owner_pid": owner.pid}
    (tmp_path / ".state" / "server.json").write_text(json.dumps(note))
    assert (find_server(tmp_path) is not None) == is_taken


def test_a_dead_server_is_started_again_and_its_address_written(tmp_path, monkeypatch):
    (tmp_path / ".state").mkdir()
    is_over, url = (
        threading.Event(),
        {"PREFECT_API_URL": "http://127.0.0.1:4200/api", "PREFECT_API_AUTH_STRING": "fast:x"},
    )

    def restart() -> bool:
        is_over.set()
        return True

    monkeypatch.setattr(prefect_server, "KEEP_S", 0.01)
    process = SimpleNamespace(restart_if_dead=restart, environment=url, pid=7)
    prefect_server._keep_alive(tmp_path, process, is_over)
    assert json.loads((tmp_path / ".state" / "server.json").read_text())["pid"] == 7
