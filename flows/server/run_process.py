"""Which process does a flow run: a tag that it carries, so that others can tell whether it still lives."""

import logging
import os
import re
import signal
import socket
import sys
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING
from uuid import UUID

import psutil

from fast.flows.server.environment import LAB_VARIABLE

if TYPE_CHECKING:
    from rich.console import Console

logger = logging.getLogger(__name__)

ASKED_S = 120.0  # a grasp takes 20 s; a run would tell a server that is gone for four minutes how it ended

_TAG = re.compile(r"process:(?P<host>.+):(?P<pid>\d+):(?P<started_s>\d+)")
_SAME_START_S = 2  # clocks of /proc are read to whole ticks


@dataclass(frozen=True)
class RunningProcess:
    """A process by host, id and start (s since 1970), since ids are used again."""

    host: str
    pid: int
    started_s: int

    @classmethod
    def own(cls) -> "RunningProcess":
        """Return this process."""
        return cls(socket.gethostname(), os.getpid(), int(psutil.Process().create_time()))

    @classmethod
    def of_tags(cls, tags: list[str]) -> "RunningProcess | None":
        """Return the process that the tags of a flow run name; the last one, if it was continued."""
        found = [match for tag in tags if (match := _TAG.fullmatch(tag))]
        return cls(found[-1]["host"], int(found[-1]["pid"]), int(found[-1]["started_s"])) if found else None

    @property
    def tag(self) -> str:
        """As a tag of a flow run."""
        return f"process:{self.host}:{self.pid}:{self.started_s}"

    @property
    def is_here(self) -> bool:
        """Whether it is one of this machine, of which alone can be told whether it lives."""
        return self.host == socket.gethostname()

    def is_alive(self) -> bool:
        """Return True while it runs here."""
        return is_process_alive(self.pid, self.started_s)


def is_process_alive(pid: int, started_s: int | None = None) -> bool:
    """Return True while a process with this id, and start if given, runs on this machine and is no zombie."""
    try:
        process = psutil.Process(pid)
        is_it = started_s is None or abs(process.create_time() - started_s) <= _SAME_START_S
        return is_it and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:
        return True


def _drop_output(console: "Console") -> None:
    """Drop what the run says when its worker, which reads it, is gone; rich would end it in the midst."""
    for stream in (sys.stdout, sys.stderr):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def follow_lab(lab_pid: int, poll_s: float = 1.0) -> None:
    """Send this process SIGTERM when the `fast serve` that began it is gone, even by SIGKILL; end it `ASKED_S` later.

    A worker that is gone is started again, and its runs go on.
    """

    def watch() -> None:
        while is_process_alive(lab_pid):
            time.sleep(poll_s)
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(ASKED_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="follow-lab").start()


def mark_run() -> None:
    """Have the flow run that this process does carry its tag, and pause when the lab that began it is gone.

    Without a server it goes without the tag.
    """
    from httpx import HTTPError
    from prefect import get_client
    from prefect.runtime import flow_run
    from rich.console import Console

    run_id = flow_run.get_id()
    if run_id is None:
        return
    Console.on_broken_pipe = _drop_output  # type: ignore[assignment, method-assign]
    if LAB_VARIABLE in os.environ:
        follow_lab(int(os.environ[LAB_VARIABLE]))
    kept = [tag for tag in flow_run.get_tags() if not _TAG.fullmatch(tag)]
    try:
        with get_client(sync_client=True) as client:
            client.update_flow_run(UUID(run_id), tags=[*kept, RunningProcess.own().tag])
    except HTTPError as error:
        logger.warning("the flow run %s does not say which process does it: %s", run_id, error)
