"""Warm pools of worker processes for FEM work; a worker never outlives the process that started it."""

import logging
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import ParamSpec, Protocol, TypeVar

from fast.models.own_code import look_here

logger = logging.getLogger(__name__)

P = ParamSpec("P")
R = TypeVar("R")

_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


class EngineWorker(Protocol):
    """A process that does one thing at a time, in order. `ends_hangs`: it ends itself when a grasp hangs."""

    ends_hangs: bool

    def submit(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> "Future[R]":
        """Queue `function` for the process; `concurrent.futures.BrokenExecutor` says that it died."""
        ...

    def restart(self) -> None:
        """Kill the process, since it hangs."""
        ...


class Worker:
    """One process that does one thing at a time, in order; it is replaced after it crashed or was killed."""

    ends_hangs = False

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._executor: ProcessPoolExecutor | None = None

    def call(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Run `function` in the process and wait for its result."""
        return self.submit(function, *args, **kwargs).result()

    def submit(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> "Future[R]":
        """Queue `function` for the process."""
        with self._lock:
            if self._executor is None:
                self._executor = _new_executor()
            try:
                return self._executor.submit(function, *args, **kwargs)
            except BrokenProcessPool:
                logger.warning("a worker process died; starting a new one")
                self._executor = _new_executor()
                return self._executor.submit(function, *args, **kwargs)

    def restart(self) -> None:
        """Kill the process (it hangs); queued work fails with `BrokenProcessPool`."""
        with self._lock:
            if self._executor is not None:
                for process in list((self._executor._processes or {}).values()):  # noqa: SLF001 - no public way before Python 3.14
                    process.kill()
                self._executor.shutdown(wait=False, cancel_futures=True)
                self._executor = None

    def close(self) -> None:
        """Stop the process; waits for what it is at."""
        with self._lock:
            if self._executor is not None:
                self._executor.shutdown(cancel_futures=True)
                self._executor = None


class WorkerPool:
    """Warm workers, lent to one user at a time: what a worker has prepared serves its user's next call."""

    def __init__(self, n_workers: int) -> None:
        self._workers = [Worker() for _ in range(n_workers)]
        self._idle: queue.SimpleQueue[Worker] = queue.SimpleQueue()
        for worker in self._workers:
            self._idle.put(worker)

    @contextmanager
    def lend(self) -> Iterator[Worker]:
        """Lend a worker for as long as the `with` block lasts; wait until one is idle."""
        worker = self._idle.get()
        try:
            yield worker
        finally:
            self._idle.put(worker)

    def call(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Run `function` in the next idle worker and wait for its result."""
        with self.lend() as worker:
            return worker.call(function, *args, **kwargs)

    def close(self) -> None:
        """Stop the workers; waits for the ones at work."""
        for worker in self._workers:
            worker.close()


def _new_executor() -> ProcessPoolExecutor:
    os.environ.update(_ONE_THREAD)
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_start_worker, initargs=(os.getpid(),))


def _start_worker(parent_pid: int) -> None:
    # Ctrl-C, and a terminal that closes, reach every process of the terminal, a service's SIGTERM all of its processes;
    # the parent decides what still has to be finished.
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    look_here()  # designs of a family of the user's own
    follow_parent(parent_pid)


def follow_parent(parent_pid: int, poll_s: float = 1.0) -> None:
    """Make this process exit soon after the one that started it is gone, even by SIGKILL."""

    def watch() -> None:
        while os.getppid() == parent_pid:
            time.sleep(poll_s)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="follow-parent").start()
