"""Independent pieces of work in spawned processes, each with one BLAS thread; results do not depend on how many."""

import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from typing import Any, TypeVar

from fast.models.blas import one_blas_thread
from fast.models.errors import FastError

Shared = TypeVar("Shared")
Job = TypeVar("Job")
Result = TypeVar("Result")
_REPORT_S = 5.0
_WATCH_S = 1.0
_NEWS_S = 1.0
_in_process: list[Any] = []  # of a worker: the function, what its jobs share, and where news go


def spread(
    work: Callable[..., Result],
    shared: Shared,
    jobs: Sequence[Job],
    n_workers: int,
    progress: Callable[[str], None] | None = None,
    what: str = "jobs",
    hear: Callable[..., None] | None = None,
) -> tuple[list[Result], float]:
    """Return results of `work(shared, job)` in the order of `jobs`, and CPU seconds spent in other processes.

    `work` must be importable; `shared` is sent once to each process. `progress` hears how many of `what` are done. With
    `hear` the work is called as `work(shared, job, tell)`: what it tells is heard as `hear(number of the job, *told)`,
    in this process.

    Raises:
        FastError: a process died.
    """
    report = _Report(len(jobs), progress, what)
    if min(n_workers, len(jobs)) <= 1:
        results = []
        for number, job in enumerate(jobs):
            results.append(work(shared, job, *([] if hear is None else [partial(hear, number)])))
            report.one_more()
        return results, 0.0
    context = get_context("spawn")
    news = None if hear is None else context.SimpleQueue()
    pool = ProcessPoolExecutor(n_workers, context, _begin, (work, shared, news, os.getpid()))
    cpu_s: dict[int, float] = {}
    left: set[Future[Any]] = set()
    try:
        futures = [pool.submit(_do, number, job) for number, job in enumerate(jobs)]
        left = set(futures)
        while left:
            done, left = wait(left, timeout=None if news is None else _NEWS_S, return_when=FIRST_COMPLETED)
            while hear is not None and news is not None and not news.empty():
                hear(*news.get())
            for future in done:
                _, pid, spent_s = future.result()
                cpu_s[pid] = max(spent_s, cpu_s.get(pid, 0.0))
                report.one_more()
    except BrokenProcessPool as error:
        raise FastError(
            f"a process that worked on {what} died, perhaps for lack of memory; run it again with fewer workers."
        ) from error
    finally:  # whatever ended it early: what is at work has nobody left to work for
        for process in list((pool._processes or {}).values()) if left else []:  # noqa: SLF001 - no public way before Python 3.14
            process.terminate()
        pool.shutdown(cancel_futures=True)
    return [future.result()[0] for future in futures], sum(cpu_s.values())


def _begin(work: Callable[..., Any], shared: Any, news: Any, parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, which ends this process
    one_blas_thread()
    _in_process[:] = [work, shared, news]
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_S)
    os._exit(1)


def _do(number: int, job: Any) -> tuple[Any, int, float]:
    """Return result, process, and CPU time of that process so far, its start included."""
    work, shared, news = _in_process
    tell = [] if news is None else [_Teller(news, number)]
    return work(shared, job, *tell), os.getpid(), time.process_time()


class _Teller:
    """Sends news about a job, not more often than they are read."""

    def __init__(self, news: Any, number: int) -> None:
        self._news, self._number = news, number
        self._last = time.monotonic()

    def __call__(self, *told: Any) -> None:
        now = time.monotonic()
        if now - self._last >= _NEWS_S:
            self._last = now
            self._news.put((self._number, *told))


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
