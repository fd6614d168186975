"""Limits of time and memory of one question, watched from beside it.

DuckDB hears an interrupt between two of its steps. One step may be long (`repeat('x', 3000000000)` is one), and what a
step holds does not count for DuckDB's own limit. So a thread looks at the clock and at the memory of the process, and
where an interrupt is not heard, the caller is told, who may end the process.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import duckdb
import psutil

from fast.models.errors import FastError

_LOOK_S = 0.02
_HEARD_S = 2.0  # an interrupt is heard within milliseconds, or in this step not at all
_FAR_OVER = 1.5  # of the limit of memory: there is no time to wait


@dataclass(frozen=True)
class Limits:
    """Wall seconds, and memory of the whole process in MB, that one question may take."""

    time_s: float = 120.0
    memory_mb: float = 4000.0


class OverLimitError(FastError):
    """A question took more time or memory than it may."""


@contextmanager
def limited(
    connection: duckdb.DuckDBPyConnection, limits: Limits, on_deaf: Callable[[str], object] | None = None
) -> Iterator[None]:
    """Interrupt what runs on the connection when it is over a limit.

    `on_deaf` hears the sentence when the interrupt is not heard; without, the question goes on until it is.

    Raises:
        OverLimitError: it was over, in one sentence.
    """
    over: list[str] = []
    ended = threading.Event()
    watch = threading.Thread(target=_watch, args=(connection, limits, on_deaf, over, ended), daemon=True)
    watch.start()
    try:
        yield
    except duckdb.InterruptException as error:
        raise OverLimitError(over[0] if over else "The query was interrupted.") from error
    except (duckdb.OutOfMemoryException, MemoryError) as error:
        raise OverLimitError(
            "The query needs more memory than DuckDB may take here; ask for less at once (one batch, one tool)."
        ) from error
    finally:
        ended.set()
        watch.join()


def _watch(
    connection: duckdb.DuckDBPyConnection,
    limits: Limits,
    on_deaf: Callable[[str], object] | None,
    over: list[str],
    ended: threading.Event,
) -> None:
    process, began_s, over_s = psutil.Process(), time.monotonic(), 0.0
    while not ended.wait(_LOOK_S):
        now_s, held_mb = time.monotonic(), process.memory_info().rss / 1e6
        sentence = _sentence(limits, now_s - began_s, held_mb)
        if sentence and not over:
            over.append(sentence)
            over_s = now_s
        if over:
            connection.interrupt()
            is_deaf = now_s - over_s > _HEARD_S or held_mb > _FAR_OVER * limits.memory_mb
            if is_deaf and on_deaf is not None:
                on_deaf(over[0])


def _sentence(limits: Limits, took_s: float, held_mb: float) -> str:
    if took_s > limits.time_s:
        return (
            f"The query took longer than {limits.time_s:g} s and was ended; ask for less (one batch, one tool), or "
            "give --limit-s more."
        )
    if held_mb > limits.memory_mb:
        return (
            f"The query held {held_mb:.0f} MB, limit {limits.memory_mb:g} MB, and was ended; ask for less (one batch, "
            "one tool), or give --limit-mb more."
        )
    return ""
