"""NUTS chains of PyMC on any log density with a gradient, side by side in processes of their own.

A chain depends on its seed and its start only: the number of processes changes no draw. Processes are spawned, never
forked (threads of BLAS or of a caller would deadlock), keep to one BLAS thread, and end with their parent.
"""

import multiprocessing
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any

import numpy as np

from fast.models.calibration.inference.optimise import LogDensity
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.errors import FastError, UsageError

if TYPE_CHECKING:
    from fast.models.calibration.inference.nuts import Chain

Progress = Callable[[str], None]
_REPORT_S = 5.0
_WORKER_REPORT_S = 1.0


@dataclass(frozen=True, eq=False)
class Samples:
    """What NUTS drew. draws: chains x n x k, in the space of the density.

    `n_divergences` and `n_deepest` (trees cut at their greatest depth) count draws after tuning, `n_gradients` all
    evaluations of the density, tuning included. tree_depth: chains x n. `cpu_s` is the CPU time of all processes
    (s, without their start).
    """

    draws: np.ndarray
    tree_depth: np.ndarray
    n_divergences: int
    n_deepest: int
    n_gradients: int
    cpu_s: float

    @property
    def flat(self) -> np.ndarray:
        """All draws, (chains n) x k."""
        return self.draws.reshape(-1, self.draws.shape[2])


def sample(
    log_density: LogDensity,
    start: np.ndarray,
    settings: CalibrationSettings,
    *,
    scale: np.ndarray | None = None,
    progress: Progress | None = None,
) -> Samples:
    """Draw from a density with one NUTS chain a row of `start` (chains x k).

    `log_density` returns the value at a vector (k), which may be minus infinity, and the gradient (k). It is sent
    to other processes by cloudpickle when `settings.workers` and the number of chains are above 1. `scale`
    (k x k) is a guess of the posterior covariance; it becomes the first metric, and the metric is learnt from there.
    `progress` hears a sentence every few seconds. Uses draws, tune, target_accept, seed, workers of `settings`.

    Raises:
        UsageError: the density is not finite at a start.
        FastError: a process died.

    Example:
        >>> settings = CalibrationSettings(draws=200, tune=100, workers=1)
        >>> sample(lambda z: (-0.5 * z @ z, -z), np.zeros((2, 3)), settings).draws.shape
        (2, 200, 3)
    """
    _check_start(log_density, start)
    seeds = [int(seed) for seed in np.random.SeedSequence(settings.seed).generate_state(len(start))]
    jobs = [(row, scale, settings, seed) for row, seed in zip(start, seeds, strict=True)]
    report = _Report(len(jobs), settings.draws + settings.tune, progress)
    n_workers = min(settings.workers, len(jobs))
    if n_workers == 1:
        chains = [
            _run(log_density, job, lambda *news, chain=i: report.hear(chain, *news)) for i, job in enumerate(jobs)
        ]
    else:
        chains = _Processes(log_density, jobs, n_workers, report).run()
    return Samples(
        draws=np.stack([chain.draws for chain in chains]),
        tree_depth=np.stack([chain.tree_depth for chain in chains]),
        n_divergences=sum(chain.n_divergences for chain in chains),
        n_deepest=sum(chain.n_deepest for chain in chains),
        n_gradients=sum(chain.n_gradients for chain in chains),
        cpu_s=sum(chain.cpu_s for chain in chains),
    )


def _check_start(log_density: LogDensity, start: np.ndarray) -> None:
    for number, row in enumerate(start):
        value, gradient = log_density(row)
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            raise UsageError(
                f"the log density is {value} or its gradient is not finite at the start of chain {number}; "
                "start chains where it is finite."
            )


_Job = tuple[np.ndarray, np.ndarray | None, CalibrationSettings, int]


def _run(log_density: LogDensity, job: _Job, tell: Callable[[int, int], None]) -> "Chain":
    from fast.models.calibration.inference.nuts import run_chain

    return run_chain(log_density, *job, tell)


class _Report:
    """Turns news of chains into a sentence now and then."""

    def __init__(self, n_chains: int, n_draws: int, progress: Progress | None) -> None:
        self._done, self._divergences = [0] * n_chains, [0] * n_chains
        self._n_draws, self._progress = n_draws, progress
        self._started: float | None = None  # with the first news: a process imports for seconds
        self._last = 0.0

    def hear(self, chain: int, n_done: int, n_divergences: int) -> None:
        """A chain has made so many draws, tuning included."""
        self._done[chain], self._divergences[chain] = n_done, n_divergences
        now = time.monotonic()
        if self._started is None:
            self._started = self._last = now
        if self._progress is not None and now - self._last >= _REPORT_S:
            self._last = now
            self._progress(self._sentence(now - self._started))

    def _sentence(self, spent_s: float) -> str:
        n_done, n_all = sum(self._done), self._n_draws * len(self._done)
        left_s = spent_s * (n_all - n_done) / max(n_done, 1)
        return (
            f"NUTS: {n_done:,} of {n_all:,} draws in {len(self._done)} chains, {sum(self._divergences)} divergences, "
            f"about {left_s:.0f} s left"
        )


class _Processes:
    """Gives each idle process the next chain."""

    def __init__(self, log_density: LogDensity, jobs: Sequence[_Job], n_workers: int, report: _Report) -> None:
        import cloudpickle

        self._density = cloudpickle.dumps(log_density)
        self._jobs, self._n_workers, self._report = jobs, n_workers, report
        self._chains: list[Chain | None] = [None] * len(jobs)
        self._waiting = list(reversed(range(len(jobs))))

    def run(self) -> "list[Chain]":
        """All chains, in the order of the jobs."""
        context = multiprocessing.get_context("spawn")
        processes: list[Any] = []
        pipes: list[Connection] = []
        try:
            for _ in range(self._n_workers):
                own, other = context.Pipe()
                process = context.Process(target=_serve, args=(other,), daemon=True)
                process.start()
                other.close()
                processes.append(process)
                pipes.append(own)
            for own in pipes:
                own.send(self._density)
                self._give(own)
            while any(chain is None for chain in self._chains):
                for pipe in wait(pipes):
                    self._take(pipe)
        except (EOFError, BrokenPipeError, ConnectionResetError) as error:
            raise FastError(
                "a process that sampled died, perhaps for lack of memory; sample again with fewer workers."
            ) from error
        finally:
            for process in processes:
                process.terminate()
            for process in processes:
                process.join()
        return [chain for chain in self._chains if chain is not None]

    def _give(self, pipe: Connection) -> None:
        if self._waiting:
            number = self._waiting.pop()
            pipe.send((number, self._jobs[number]))

    def _take(self, pipe: Any) -> None:
        kind, number, news = pipe.recv()
        if kind == "error":
            raise news
        if kind == "news":
            self._report.hear(number, *news)
            return
        self._chains[number] = news
        self._give(pipe)


def _serve(pipe: Connection) -> None:
    """Sample the chains that come through the pipe until it closes; it closes when the parent ends."""
    import cloudpickle

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, which ends this process
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):  # raised when the parent has ended
        log_density = cloudpickle.loads(pipe.recv())
        while True:
            number, job = pipe.recv()
            try:
                pipe.send(("chain", number, _run(log_density, job, _Sender(pipe, number))))
            except Exception as error:
                pipe.send(("error", number, error))


class _Sender:
    """Sends news about a chain, not more often than they are read."""

    def __init__(self, pipe: Connection, number: int) -> None:
        self._pipe, self._number = pipe, number
        self._last = time.monotonic()

    def __call__(self, n_done: int, n_divergences: int) -> None:
        now = time.monotonic()
        if now - self._last >= _WORKER_REPORT_S:
            self._last = now
            self._pipe.send(("news", self._number, (n_done, n_divergences)))
