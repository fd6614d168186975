"""A process that stands, and who asks while it comes back."""

import os
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack

import psutil
import pytest

from fast.flows.server import child_process
from fast.flows.server.child_process import ChildProcess
from fast.flows.server.loopback import LOOPBACK, join_numbers, split_numbers
from fast.flows.server.server import ANY_PORT, _listen
from fast.models.errors import FastError
from fast.models.own_code import FOLDER

LIMIT_S = 60.0


def test_who_asks_while_a_killed_server_comes_back_is_answered(tmp_path, monkeypatch):
    monkeypatch.setattr(child_process, "LEAST_LIFE_S", 0.0)
    (listener,) = _listen(LOOPBACK, ANY_PORT)
    number, place = str(listener.fileno()), listener.getsockname()
    process = ChildProcess("tests.flows.campaign.answering_process", [number], os.environ, tmp_path / "log", [listener])
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


def test_a_server_of_one_address_answers_programs_of_this_machine_too():
    """It listened there alone, was looked for on 127.0.0.1, and ended after ten minutes."""
    with ExitStack() as stack:
        listeners = [stack.enter_context(listener) for listener in _listen("127.0.0.2", ANY_PORT)]
        places = [listener.getsockname() for listener in listeners]
        port = places[0][1]
        assert places == [("127.0.0.2", port), (LOOPBACK, port)]
        handed_on = [os.dup(int(number)) for number in join_numbers(listeners).split(",")]
        for place, got in zip(places, split_numbers(",".join(map(str, handed_on))), strict=True):
            with got, socket.create_connection(place, LIMIT_S):
                got.accept()[0].close()
        with pytest.raises(FastError, match=f"port {port} of 127.0.0.2 cannot be used"):
            _listen("127.0.0.2", port)


FOLLOWER = """
import os, signal, sys, time
from fast.flows.server.run_process import follow_lab

if len(sys.argv) > 1:
    def hear(number, frame):
        open(sys.argv[1], "w").write("heard")
        sys.exit()
    signal.signal(signal.SIGTERM, hear)
    follow_lab(os.getppid(), poll_s=0.05)
    print(os.getpid(), flush=True)
    time.sleep(60)
else:
    import subprocess
    subprocess.run([sys.executable, __file__, "heard.txt"])
"""


def test_a_run_is_asked_to_end_when_its_lab_is_killed(tmp_path):
    """It was left alone with a server that is gone: minutes in which the bench belonged to nobody who answers."""
    script = tmp_path / "follower.py"
    script.write_text(FOLLOWER)
    with subprocess.Popen([sys.executable, script], cwd=tmp_path, stdout=subprocess.PIPE, text=True) as lab:
        assert lab.stdout is not None
        run = psutil.Process(int(lab.stdout.readline()))
        lab.kill()
    run.wait(LIMIT_S)
    assert (tmp_path / "heard.txt").read_text() == "heard"
