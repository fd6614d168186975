"""A virtual bench that another thread lends, as a terminal beside a real one does."""

import threading
from contextlib import contextmanager

from fast.hardware.by_hand import ByHand
from fast.tasks.bench.lend import Lender, read_lent
from tests.hardware.safety.scenario_bench import open_bench
from tests.waiting import wait_for


@contextmanager
def open_gantry(may_vent):
    with open_bench() as bench:
        yield ByHand(bench)


@contextmanager
def lent(lake, first_holder="", open_it=open_gantry, file="turin.toml"):
    """A bench that another thread lends; `runs` are the campaigns that it was to start."""
    is_over, runs = threading.Event(), []
    run = lambda config: runs.append(config) or "ran"  # noqa: E731 - read beside what it fills
    lender = Lender(lake, "turin", str(file), True, open_it, run, is_over.is_set)
    thread = threading.Thread(target=lender.lend, args=(first_holder,))
    thread.start()
    try:
        wait_for(lambda: read_lent(lake) is not None, 20.0)
        yield runs
    finally:
        is_over.set()
        thread.join()
