"""Work in spawned processes: same results in the same order, and a sentence when one dies."""

import os

import pytest

from fast.models.calibration.inference.processes import spread
from fast.models.errors import FastError


def test_processes_change_no_result_and_keep_its_order() -> None:
    alone, _ = spread(_square, 3.0, list(range(7)), 1)
    beside, cpu_s = spread(_square, 3.0, list(range(7)), 2)
    assert alone == beside == [3.0 * i * i for i in range(7)]
    assert cpu_s > 0


def test_a_dead_process_is_said() -> None:
    with pytest.raises(FastError, match=r"a process that worked on squares died"):
        spread(_die, None, [0, 1], 2, what="squares")


def _square(factor: float, i: int) -> float:
    return factor * i * i


def _die(shared: None, i: int) -> None:
    os._exit(3)
