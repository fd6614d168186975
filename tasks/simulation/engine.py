"""Where simulations are computed: worker processes of this machine, or of a Dask cluster. Changes no result."""

import re
from contextlib import AbstractContextManager
from typing import Protocol

from fast.models.errors import ConfigError
from fast.tasks.simulation.pool import EngineWorker, WorkerPool

LOCAL = "local"
_ADDRESS = re.compile(r"(?P<scheme>dask|dask\+tls)://(?P<host>[A-Za-z0-9_.-]+):(?P<port>\d{1,5})")
_LOOPBACK = ("localhost", "127.0.0.1")


class Engine(Protocol):
    """Lends workers, each to one user at a time: what a worker has prepared serves its user's next call."""

    def lend(self) -> AbstractContextManager[EngineWorker]:
        """Lend a worker for as long as the `with` block lasts; wait until one is idle."""
        ...

    def close(self) -> None:
        """Let the workers go."""
        ...


def check_engine(address: str) -> str:
    """Return the address of an engine, if it is one.

    Raises:
        ValueError: it is none, or a plain connection would leave this machine.
    """
    if address == LOCAL:
        return address
    found = _ADDRESS.fullmatch(address)
    if found is None:
        raise ValueError(f'`{address}` is no engine; write "local", "dask://127.0.0.1:8786" or "dask+tls://HOST:8786"')
    if found["scheme"] == "dask" and found["host"] not in _LOOPBACK:
        raise ValueError(
            f"`{address}` would send programs in the clear, and whoever reaches that port can run theirs here; write "
            "dask+tls:// (docs/how-to/scale-out.md)"
        )
    return address


def open_engine(address: str, n_workers: int, limit_s: float) -> Engine:
    """Open the engine at an address of `check_engine`, with at most `n_workers` of its workers in use.

    `limit_s` is the wall time after which a call to a worker elsewhere hangs; those of this machine are watched here.

    Raises:
        ConfigError: there is no such engine.
        FastError: it does not answer, or the package for it is missing.
    """
    try:
        check_engine(address)
    except ValueError as error:
        raise ConfigError(f"{error}.") from error
    if address == LOCAL:
        return WorkerPool(n_workers)
    from fast.tasks.simulation.engine_dask import DaskEngine

    return DaskEngine(address, n_workers, limit_s)
