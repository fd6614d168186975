"""Nothing leaves the machine unasked: every process of a command is watched for addresses that are not its own."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.flows.cli.cli_lakes import ROOT, proposed_lake

# Read by every Python that is started below, before anything else.
WATCH = """
import os, sys

def is_own(host):
    return host in (None, "", "localhost", "::1", "::") or str(host).startswith(("127.", "0.0.0.0"))

def watch(event, words):
    if event in ("socket.connect", "socket.sendto"):
        address = words[1]
        host = address[0] if isinstance(address, tuple) else None
    elif event in ("socket.getaddrinfo", "socket.gethostbyname"):
        host = words[0]
    else:
        return
    if not is_own(host.decode() if isinstance(host, bytes) else host):
        with open(os.environ["LEAVES"], "a") as log:
            log.write(f"{event} {host} by {' '.join(sys.orig_argv)}\\n")

with open(os.environ["LEAVES"] + ".seen", "a") as log:
    log.write("watched\\n")
sys.addaudithook(watch)
"""
NOBODY_OPTED_OUT = ("DO_NOT_TRACK", "CI", "PREFECT_SERVER_ANALYTICS_ENABLED")


@pytest.fixture
def watched(tmp_path):
    """Environment of a user who has opted out of nothing, with the watch; and where it writes."""
    folder = tmp_path / "watch"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(WATCH)
    leaves = tmp_path / "leaves"
    found = {name: value for name, value in os.environ.items()
             if name not in NOBODY_OPTED_OUT and not name.startswith(("PREFECT_", "GITHUB_"))}  # fmt: skip
    path = os.pathsep.join([str(folder), str(ROOT)])
    return {**found, "PYTHONPATH": path, "LEAVES": str(leaves), "HOME": str(tmp_path)}, leaves


def seen_of(leaves: Path) -> tuple[int, str]:
    """Processes that were watched, and what they asked of others."""
    n = len((leaves.parent / "leaves.seen").read_text().splitlines())
    return n, leaves.read_text() if leaves.exists() else ""


def test_the_watch_sees_who_leaves(watched):
    environment, leaves = watched
    code = "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM).connect(('192.0.2.1', 9))"
    subprocess.run([sys.executable, "-c", code], env=environment, check=False, capture_output=True)
    assert "socket.connect 192.0.2.1" in seen_of(leaves)[1]


@pytest.mark.parametrize("words", [
    ("campaign", "status"), ("sql", "SELECT 1"), ("print", "sheet", "quick/B01"), ("view", "quick", "--save", "x.rrd"),
])  # fmt: skip
def test_commands_ask_nobody(tmp_path, watched, words):
    environment, leaves = watched
    lake = proposed_lake(tmp_path)
    command = [sys.executable, "-m", "fast.flows.cli.main", *words, "--lake", str(lake)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    n_watched, left = seen_of(leaves)
    assert n_watched >= 1
    assert left == ""


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_server_worker_and_deployments_ask_nobody(tmp_path, watched):
    environment, leaves = watched
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "fast.flows.cli.main", "serve", "--lake", str(tmp_path / "lake")]
    command += ["--port", str(port)]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as lab:
        lines = iter(lab.stdout.readline, "")
        assert any("worker ready" in line for line in lines)
        lab.send_signal(signal.SIGINT)
        assert lab.wait(timeout=120) == 0
    n_watched, left = seen_of(leaves)
    assert n_watched >= 4  # the command, the server, the worker, and what deployed
    assert left == ""
