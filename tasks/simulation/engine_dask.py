"""Simulations on a Dask cluster: the scheduler knows the workers, runs again what a lost one had, and is not ours.

Workers need this package, of the same version, and no access to the lake: a job goes out, its result comes back, and
the process that runs the campaign writes the rows. Dask's wire carries pickled programs: who reaches it may run code
on both ends, so it is loopback or TLS with certificates of the lab (`tasks.simulation.engine.check_engine`).
"""

import faulthandler
import logging
import queue
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from fast.models.errors import FastError, MissingDependencyError
from fast.models.solver_code import solver_id
from fast.tasks.simulation.attempt import GraspJob

if TYPE_CHECKING:
    from distributed import Client
    from distributed import Future as DaskFuture

logger = logging.getLogger(__name__)

CONNECT_LIMIT_S = 30.0

P = ParamSpec("P")
R = TypeVar("R")


class EngineError(FastError):
    """A cluster cannot be used, or is gone; what was simulated is in the lake."""


class DaskEngine:
    """The workers of a Dask scheduler; safe to use from several threads.

    Args:
        address: `dask://HOST:PORT`, or `dask+tls://HOST:PORT` with the certificates of Dask's own configuration.
        n_slots: how many grasps are on their way at once.
        limit_s: wall time after which a worker that is at a grasp ends itself.
    """

    def __init__(self, address: str, n_slots: int, limit_s: float) -> None:
        self.address = address
        self._limit_s = limit_s
        self.is_here = address.startswith("dask://")  # which is loopback
        self._client = _connect(address)
        self._lock = threading.Lock()
        self._loans: Counter[str] = Counter()
        self._running: dict[str, DaskFuture] = {}
        self._idle: queue.SimpleQueue[int] = queue.SimpleQueue()
        for slot in range(n_slots):
            self._idle.put(slot)

    @contextmanager
    def lend(self) -> Iterator["DaskWorker"]:
        """Lend a slot for as long as the `with` block lasts; prefer one worker, which keeps the meshes it made."""
        slot = self._idle.get()
        worker = DaskWorker(self, self._client, self._limit_s)
        try:
            yield worker
        finally:
            worker.settle("")
            self._idle.put(slot)

    def close(self) -> None:
        """Leave the cluster, which lives on."""
        self._client.close()

    def present(self) -> list[str]:
        """Return the addresses of the workers that are there now.

        Raises:
            EngineError: the scheduler is gone.
        """
        try:
            return sorted(self._client.scheduler_info(n_workers=-1)["workers"])
        except (OSError, RuntimeError, KeyError) as error:
            raise lost(self.address) from error

    def least_lent(self, addresses: list[str]) -> str:
        """Return, of some workers, the one with the fewest users."""
        with self._lock:
            return min(addresses, key=lambda address: (self._loans[address], address))

    def count(self, address: str, change: int) -> None:
        """Note that a worker has one user more or less."""
        if address:
            with self._lock:
                self._loans[address] += change

    def hold(self, running: "DaskFuture") -> None:
        """Keep the future of a call until it is finished."""
        with self._lock:
            self._running[str(running.key)] = running

    def let_go(self, done: "DaskFuture") -> None:
        """Forget the future of a finished call."""
        with self._lock:
            self._running.pop(str(done.key), None)


class DaskWorker:
    """A user's place in the cluster: calls go to one worker while it lives, and to any other when it is gone."""

    ends_hangs = True

    def __init__(self, engine: DaskEngine, client: "Client", limit_s: float) -> None:
        self._engine, self._client, self._limit_s = engine, client, limit_s
        self._at = ""

    def settle(self, address: str) -> None:
        """Take another worker for the calls to come; an empty address is none."""
        self._engine.count(self._at, -1)
        self._at = address
        self._engine.count(address, 1)

    def submit(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> "Future[R]":
        """Queue `function`; it waits for a worker if there is none.

        Raises:
            EngineError: the scheduler is gone.
        """
        present = self._engine.present()
        if self._at not in present:
            self.settle(self._engine.least_lent(present) if present else "")
        if not present:
            logger.warning("%s has no worker now; waiting for one", self._engine.address)
        calls = args if self._engine.is_here else tuple(without_lake(value) for value in args)
        try:
            running = self._client.submit(
                run_watched, self._limit_s, solver_id(), function, calls, kwargs,
                pure=False, workers=[self._at] if self._at else None, allow_other_workers=bool(self._at),
            )  # fmt: skip
        except (OSError, RuntimeError) as error:
            raise lost(self._engine.address) from error
        answer: Future[R] = Future()
        self._engine.hold(running)  # Dask forgets a call of which nobody holds the future
        running.add_done_callback(lambda done: _pass_on(self._engine, done, answer))
        return answer

    def restart(self) -> None:
        """Have the process of this place killed and started anew."""
        if self._at:
            self._client.restart_workers([self._at], timeout=CONNECT_LIMIT_S)


def run_watched(
    limit_s: float, solver: str, function: Callable[..., R], args: tuple[Any, ...], kwargs: dict[str, Any]
) -> R:
    """Run a call in a worker: check that it is the worker the campaign wants, and end it if the call hangs.

    Raises:
        EngineError: other code, or several threads in one process.
    """
    from distributed import get_worker

    worker = get_worker()
    if worker.state.nthreads != 1:
        raise EngineError(
            f"the Dask worker {worker.address} has {worker.state.nthreads} threads, and CPU time is counted for one; "
            "start it with --nthreads 1."
        )
    if solver_id() != solver:
        raise EngineError(
            f"the Dask worker {worker.address} has solver code {solver_id()}, this campaign {solver}; install the same "
            "version there and start it again."
        )
    # Ends the process from a thread of C, since a hanging kernel may hold Python's lock; a nanny starts a new one.
    faulthandler.dump_traceback_later(limit_s, exit=True)
    try:
        return function(*args, **kwargs)
    finally:
        faulthandler.cancel_dump_traceback_later()


def without_lake(value: Any) -> Any:
    """Return a job as it leaves this machine: the lake's cache of meshes is a folder of this one."""
    return replace(value, lake_root=None) if isinstance(value, GraspJob) else value


def lost(address: str) -> EngineError:
    """Make the error for a scheduler that does not answer any more."""
    return EngineError(
        f"the Dask scheduler of {address} is gone; what was simulated is in the lake. Start scheduler and workers, "
        "then give the same command again."
    )


def _pass_on(engine: DaskEngine, done: "DaskFuture", promised: "Future[Any]") -> None:
    """Give the outcome of a call to who waits for it, in the words of `concurrent.futures`."""
    from distributed.scheduler import KilledWorker

    engine.let_go(done)
    try:
        promised.set_result(done.result())
    except KilledWorker as error:
        promised.set_exception(BrokenExecutor(str(error)))
    except EngineError as error:
        promised.set_exception(error)
    except BaseException as error:
        was_cancelled = done.status in ("cancelled", "lost", "pending")
        promised.set_exception(lost(engine.address) if was_cancelled else error)


def _connect(address: str) -> "Client":
    """Open a connection to the scheduler.

    Raises:
        MissingDependencyError: Dask is not installed.
        EngineError: nobody answers.
    """
    try:
        from distributed import Client, Security
    except ImportError as error:
        raise MissingDependencyError(
            f"the engine {address} needs the packages of the extra `scale`; run `pip install .[scale]`."
        ) from error
    where = address.removeprefix("dask+").removeprefix("dask://")
    try:
        if where.startswith("tls://"):
            return Client(
                where, timeout=CONNECT_LIMIT_S, set_as_default=False, security=Security(require_encryption=True)
            )
        return Client(f"tcp://{where}", timeout=CONNECT_LIMIT_S, set_as_default=False)
    except (OSError, TimeoutError, TypeError, ValueError) as error:
        raise EngineError(
            f"no Dask scheduler answers at {address} within {CONNECT_LIMIT_S:.0f} s ({type(error).__name__}); start "
            "it, or set execution.engine to another address."
        ) from error
