"""Child processes that work as long as the one that started them: server and worker, restarted when they die."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import psutil

from fast.models.own_code import FOLDER

CHECKOUT = Path(__file__).resolve().parents[2]
STOP_LIMIT_S = 15.0
LEAST_LIFE_S = 5.0  # one that dies sooner is not started again at once


class ChildProcess:
    """A Python module run as a process of its own, which ends with this one (`tasks.simulation.pool.follow_parent`)."""

    def __init__(
        self,
        module: str,
        arguments: list[str],
        environment: Mapping[str, str],
        log_path: Path,
        listeners: Sequence[socket.socket] = (),
    ) -> None:
        """Keep `listeners`: handed on to every start of the process and open in between, closed by `stop`.

        The process works in an empty folder beside its log, since Prefect reads settings from the working folder; it
        is told where modules of a user's own are.
        """
        self.log_path = log_path.resolve()
        self._listeners = listeners
        self._command = [sys.executable, "-m", module, *arguments]
        found = filter(None, [str(CHECKOUT), environment.get("PYTHONPATH")])
        self.environment = {FOLDER: str(Path.cwd()), **environment, "PYTHONPATH": os.pathsep.join(found)}
        self._child: subprocess.Popen[bytes] | None = None
        self._started_s = 0.0
        self.since = datetime.now(UTC)

    @property
    def pid(self) -> int:
        """Process id, 0 before the start."""
        return self._child.pid if self._child else 0

    def start(self) -> None:
        """Start the process; what it prints goes to its log."""
        folder = self.log_path.parent / "empty"
        folder.mkdir(parents=True, exist_ok=True)
        with self.log_path.open("ab") as log:
            self._child = subprocess.Popen(
                self._command,
                cwd=folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=[listener.fileno() for listener in self._listeners],
                start_new_session=True,  # Ctrl-C in the terminal is for us; we stop the process when we are done
            )
        self._started_s, self.since = time.monotonic(), datetime.now(UTC)

    def is_alive(self) -> bool:
        """Return True while the process runs."""
        return self._child is not None and self._child.poll() is None

    def restart_if_dead(self) -> bool:
        """Start the process again if it died and had lived a while; True when it was."""
        if self.is_alive() or time.monotonic() - self._started_s < LEAST_LIFE_S:
            return False
        self.start()
        return True

    def list_children(self) -> list[psutil.Process]:
        """List what the process has started, and still runs."""
        try:
            return psutil.Process(self.pid).children() if self.is_alive() else []
        except psutil.NoSuchProcess:
            return []

    def stop(self) -> None:
        """End the process, by force when it does not listen."""
        for listener in self._listeners:
            listener.close()
        if self._child is None:
            return
        self._child.terminate()
        try:
            self._child.wait(timeout=STOP_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
