"""A Dask worker on another network, a namespace of its own, reached with certificates and by nobody without."""

import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
HERE, THERE = "10.77.9.1", "10.77.9.2"
NAMESPACE = "fast-test"
TLS = "DASK_DISTRIBUTED__COMM__TLS__"
ASK = """
import os, sys
from fast.models.design.space import BEST_PUBLISHED
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.simulation.attempt import GraspJob
from fast.tasks.simulation.engine import open_engine
from tests.tasks.traces.made_up_grasps import made_up

if __name__ == "__main__":
    engine = open_engine(sys.argv[1], 1, 100.0)
    with engine.lend() as worker:
        print(worker.submit(os.readlink, "/proc/self/ns/net").result(200))
        job = GraspJob(BEST_PUBLISHED, get_object(0), SimulatorVersion(), GraspSetup(), 60.0)
        print(worker.submit(made_up, job).result(200).result.peak_force_n)
    engine.close()
"""


def ip(*words: str) -> bool:
    """Whether a command of `ip` succeeded."""
    program = shutil.which("ip")
    return program is not None and subprocess.run([program, *words], capture_output=True, check=False).returncode == 0


@contextmanager
def other_network() -> Iterator[None]:
    """A namespace with a cable to this one."""
    if not ip("netns", "add", NAMESPACE):
        pytest.skip("no rights to make a network namespace, or no `ip` (Debian: iproute2)")
    try:
        assert ip("link", "add", "fast0", "type", "veth", "peer", "name", "fast1", "netns", NAMESPACE)
        assert ip("addr", "add", f"{HERE}/30", "dev", "fast0")
        assert ip("link", "set", "fast0", "up")
        assert ip("-n", NAMESPACE, "addr", "add", f"{THERE}/30", "dev", "fast1")
        assert ip("-n", NAMESPACE, "link", "set", "fast1", "up")
        assert ip("-n", NAMESPACE, "link", "set", "lo", "up")
        yield
    finally:
        ip("netns", "del", NAMESPACE)


@pytest.fixture
def certified(tmp_path: Path) -> dict[str, str]:
    """Environment of a process that may take part: one certificate for all, which is its own authority."""
    certificate, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    words = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=fast"]
    program = shutil.which("openssl") or pytest.skip("no openssl to make a certificate")
    subprocess.run([program, *words, "-keyout", key, "-out", certificate], check=True, capture_output=True)
    found = {f"{TLS}CA_FILE": str(certificate)}
    for role in ("SCHEDULER", "WORKER", "CLIENT"):
        found |= {f"{TLS}{role}__CERT": str(certificate), f"{TLS}{role}__KEY": str(key)}
    return {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore", **found}


@pytest.mark.study
@pytest.mark.timeout(900)
def test_a_worker_of_another_network_simulates_and_strangers_are_refused(tmp_path, certified):
    with other_network(), socket.socket() as probe:
        probe.bind((HERE, 0))
        port = probe.getsockname()[1]
        probe.close()
        words = ["--protocol", "tls", "--host", HERE, "--port", str(port), "--dashboard-address", "127.0.0.1:0"]
        scheduler = start(tmp_path, certified, "scheduler", *words)
        place = [f"tls://{HERE}:{port}", "--host", f"tls://{THERE}", "--nthreads", "1"]
        inside = [shutil.which("ip") or "ip", "netns", "exec", NAMESPACE]
        worker = start(tmp_path, certified, "worker", *place, "--dashboard-address", "127.0.0.1:0", inside=inside)
        try:
            done = ask(certified, f"dask+tls://{HERE}:{port}")
            assert done.returncode == 0, done.stderr + (tmp_path / "worker.log").read_text()
            network, peak_n = done.stdout.split()
            assert network != os.readlink("/proc/self/ns/net")
            assert float(peak_n) == 1.0
            stranger = {name: value for name, value in certified.items() if not name.startswith(TLS)}
            refused = ask(stranger, f"dask+tls://{HERE}:{port}")
            assert refused.returncode != 0
            assert "no Dask scheduler answers" in refused.stderr
        finally:
            for process in (worker, scheduler):
                process.terminate()
                process.wait(60)


def start(folder: Path, environment: dict[str, str], kind: str, *words: str, inside: list[str] | None = None):
    command = [*(inside or []), sys.executable, "-m", f"distributed.cli.dask_{kind}", *words]
    with (folder / f"{kind}.log").open("ab") as log:
        return subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)


def ask(environment: dict[str, str], address: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", ASK, address]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=400, check=False)
