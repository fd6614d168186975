"""A process that stands, and who asks while it comes back."""

import os
import signal
import socket

import pytest

from fast.flows.server import child_process
from fast.flows.server.child_process import ChildProcess
from fast.flows.server.server import ANY_PORT, LOOPBACK, _listen
from fast.models.errors import FastError
from fast.models.own_code import FOLDER

LIMIT_S = 60.0


def test_who_asks_while_a_killed_server_comes_back_is_answered(tmp_path, monkeypatch):
    monkeypatch.setattr(child_process, "LEAST_LIFE_S", 0.0)
    listener = _listen(LOOPBACK, ANY_PORT)
    number, place = str(listener.fileno()), listener.getsockname()
    process = ChildProcess("tests.flows.campaign.answering_process", [number], os.environ, tmp_path / "log", listener)
    process.start()
    try:
        with socket.create_connection(place, LIMIT_S) as asked:
            assert asked.recv(4) == b"here"
        os.kill(process.pid, signal.SIGKILL)
        while process.is_alive():
            pass
        with socket.create_connection(place, LIMIT_S) as asked:  # nobody is there, and nobody is refused
            assert process.restart_if_dead()
            assert asked.recv(4) == b"here"
    finally:
        process.stop()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(place, LIMIT_S)


def test_a_process_is_told_where_modules_of_a_users_own_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert ChildProcess("one", [], {}, tmp_path / "log").environment[FOLDER] == str(tmp_path)
    assert ChildProcess("one", [], {FOLDER: "/lab"}, tmp_path / "log").environment[FOLDER] == "/lab"


def test_a_port_that_is_taken_is_named():
    with socket.create_server((LOOPBACK, 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(FastError, match=f"port {port} of 127.0.0.1 cannot be used"):
            _listen(LOOPBACK, port)
