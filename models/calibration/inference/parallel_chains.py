"""NUTS chains of PyMC on any log density with a gradient, side by side in processes of their own.

A chain depends on its seed and its start only: the number of processes changes no draw. Processes are spawned, never
forked (threads of BLAS or of a caller would deadlock), keep to one BLAS thread, and end with their parent.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fast.models.calibration.inference.optimise import LogDensity
from fast.models.calibration.inference.processes import spread
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.errors import UsageError

if TYPE_CHECKING:
    from fast.models.calibration.inference.nuts import Chain

Progress = Callable[[str], None]
_REPORT_S = 5.0


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
    import cloudpickle

    shared = log_density if min(settings.workers, len(jobs)) == 1 else cloudpickle.dumps(log_density)
    chains, _ = spread(_run, shared, jobs, settings.workers, what="chains", hear=report.hear)
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


def _run(density: LogDensity | bytes, job: _Job, progress: Callable[[int, int], None]) -> "Chain":
    """Sample a chain of a density, or of the one in this pickle."""
    import cloudpickle

    from fast.models.calibration.inference.nuts import run_chain

    return run_chain(cloudpickle.loads(density) if isinstance(density, bytes) else density, *job, progress)


class _Report:
    """Turns news of chains into a sentence now and then."""

    def __init__(self, n_chains: int, n_draws: int, progress: Progress | None) -> None:
        self._done, self._divergences = [0] * n_chains, [0] * n_chains
        self._n_draws, self._progress = n_draws, progress
        self._started: float | None = None  # with the first news: a process imports for seconds
        self._last = 0.0

    def hear(self, chain: int, n_done: int, n_divergences: int) -> None:
        """Note that a chain has made so many draws, tuning included."""
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
