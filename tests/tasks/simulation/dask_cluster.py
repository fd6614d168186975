"""A Dask scheduler and workers on loopback, each a process of its own, for studies and tests."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fast.models.errors import FastError

START_LIMIT_S = 60.0
_ONE_MORE_TRY = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}  # a call that kills its worker twice has failed
ROOT = Path(__file__).parents[3]


class Cluster:
    """A scheduler at `address` (as of `tasks.simulation.engine`) and its workers, nannies of one thread each."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.port = _free_port()
        self.address = f"dask://127.0.0.1:{self.port}"
        self.workers: list[subprocess.Popen[bytes]] = []
        self.start_scheduler()

    def start_scheduler(self) -> None:
        """Start the scheduler and wait until it listens."""
        words = ["--host", "127.0.0.1", "--port", str(self.port), "--dashboard-address", "127.0.0.1:0"]
        self.scheduler = self._start("scheduler", *words)
        deadline = time.monotonic() + START_LIMIT_S
        while not _answers(self.port):
            if self.scheduler.poll() is not None or time.monotonic() > deadline:
                raise FastError(f"the Dask scheduler did not start; its log is {self._folder / 'scheduler.log'}.")
            time.sleep(0.1)

    def add_worker(self, n_threads: int = 1) -> None:
        """Start another worker; it comes when it comes."""
        words = [f"tcp://127.0.0.1:{self.port}", "--nthreads", str(n_threads), "--host", "127.0.0.1"]
        name = f"worker{len(self.workers)}"
        words += [
            "--dashboard-address",
            "127.0.0.1:0",
            "--name",
            name,
            "--local-directory",
            str(self._folder / name),
            "--death-timeout",
            "60",
        ]
        self.workers.append(self._start("worker", *words))

    def kill(self) -> None:
        """End everything."""
        for process in [*self.workers, self.scheduler]:
            process.terminate()
        for process in [*self.workers, self.scheduler]:
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self, kind: str, *words: str) -> "subprocess.Popen[bytes]":
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore", **_ONE_MORE_TRY}
        with (self._folder / f"{kind}.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "distributed.cli.dask_" + kind, *words],
                cwd=self._folder, env=environment, stdout=log, stderr=log, stdin=subprocess.DEVNULL,
            )  # fmt: skip


@contextmanager
def cluster(folder: Path, n_workers: int) -> Iterator[Cluster]:
    """A cluster that ends with the `with` block."""
    found = Cluster(folder)
    try:
        for _ in range(n_workers):
            found.add_worker()
        yield found
    finally:
        found.kill()


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
