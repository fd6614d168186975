"""Many who try to own the same thing of a lake at the same moment."""

import threading
from concurrent.futures import ThreadPoolExecutor

from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.models.errors import FastError


def race_for_lease(address: object, at_once: int) -> tuple[int, int]:
    """How many of those who try own it, and how many are refused; who owns it holds it until the others were told."""
    barrier, finished = threading.Barrier(at_once), threading.Event()
    owns: list[bool] = []
    refused: list[bool] = []

    def attempt(_: int) -> None:
        own = Lake.open(address)
        barrier.wait()
        try:
            with exclusive(own.storage, "gantry", "busy"):
                owns.append(True)
                finished.wait(20)
        except FastError:
            refused.append(True)
            if len(refused) == at_once - 1:
                finished.set()

    with ThreadPoolExecutor(at_once) as pool:
        list(pool.map(attempt, range(at_once)))
    return len(owns), len(refused)
