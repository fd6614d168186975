"""Independent pieces of work in spawned processes, each with one BLAS thread; results do not depend on how many."""

import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any, TypeVar

from fast.models.blas import one_blas_thread
from fast.models.errors import FastError

Shared = TypeVar("Shared")
Job = TypeVar("Job")
Result = TypeVar("Result")
_REPORT_S = 5.0
_WATCH_S = 1.0
_in_process: list[Any] = []  # of a worker: the function, and what its jobs share


def spread(
    work: Callable[[Shared, Job], Result],
    shared: Shared,
    jobs: Sequence[Job],
    n_workers: int,
    progress: Callable[[str], None] | None = None,
    what: str = "jobs",
) -> tuple[list[Result], float]:
    """Results of `work(shared, job)` in the order of `jobs`, and CPU seconds spent in other processes.

    `work` must be importable; `shared` is sent once to each process. `progress` hears how many of `what` are done.

    Raises:
        FastError: a process died.
    """
    report = _Report(len(jobs), progress, what)
    if min(n_workers, len(jobs)) <= 1:
        results = []
        for job in jobs:
            results.append(work(shared, job))
            report.one_more()
        return results, 0.0
    pool = ProcessPoolExecutor(n_workers, get_context("spawn"), _begin, (work, shared, os.getpid()))
    results, cpu_s = [], {}
    try:
        with pool:
            for result, pid, spent_s in pool.map(_do, jobs):
                results.append(result)
                cpu_s[pid] = spent_s
                report.one_more()
    except BrokenProcessPool as error:
        raise FastError(
            f"a process that worked on {what} died, perhaps for lack of memory; calibrate again with fewer workers."
        ) from error
    return results, sum(cpu_s.values())


def _begin(work: Callable[[Any, Any], Any], shared: Any, parent: int) -> None:
    one_blas_thread()
    _in_process[:] = [work, shared]
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_S)
    os._exit(1)


def _do(job: Any) -> tuple[Any, int, float]:
    """Result, process, and CPU time of that process so far, its start included."""
    work, shared = _in_process
    return work(shared, job), os.getpid(), time.process_time()


class _Report:
    def __init__(self, n: int, progress: Callable[[str], None] | None, what: str) -> None:
        self._n, self._done, self._progress, self._what = n, 0, progress, what
        self._started = self._last = time.monotonic()

    def one_more(self) -> None:
        self._done += 1
        now = time.monotonic()
        if self._progress is not None and now - self._last >= _REPORT_S:
            self._last = now
            left_s = (now - self._started) * (self._n - self._done) / self._done
            self._progress(f"{self._what}: {self._done:,} of {self._n:,}, about {left_s:.0f} s left")
