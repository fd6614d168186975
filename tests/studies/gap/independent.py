"""Worlds of an independent solver: its grasps, measured by the made-up lab with the laws of the lab.

What the solver and the simulator differ by is part of every world, so these figures say how gap discovery fares where
the simulator is not merely on another mesh. The laws act on traces; none of them changes what the solver solved.
"""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.challenge.hidden.panels import Panels
from fast.flows.challenge.hidden.true_sets import TrueSet
from fast.flows.challenge.hidden.worlds import Group, Worlds
from fast.models.gap.bank.bank import Bank
from fast.models.records import Trace
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.gap.development import PUBLIC_SEED, measure_worlds

DATA = Path(__file__).parents[2] / "data"
N_WORLDS: dict[Group, int] = {"null": 60, "single": 48, "unlisted": 12, "pair": 24}
_THETA = (0.52, 0.45)  # friction and Poisson's ratio


def measure_gap_independent(options: Options) -> Tables:
    """False alarms, names and closed gaps of gap discovery where another solver's grasps are the truth."""
    worlds = Worlds(*read_independent(), PUBLIC_SEED)
    return measure_worlds(worlds, "independent", N_WORLDS, options)


def read_independent() -> tuple[Panels, Bank]:
    """Grasps of the independent solver, and the simulator's bank of the same designs and objects."""
    small, bank = read_small(DATA / "gap-small.npz")
    table = pq.read_table(DATA / "independent" / "nominal.parquet")
    design, obj = (np.array(table[name]) for name in ("design_id", "object_id"))
    channels = [np.array(table[name]) for name in ("time_s", "lift_mm", "force_n")]
    cells = {}
    for tool, number in enumerate(small.designs):
        for column, object_id in enumerate(small.objects):
            is_own = (design == f"d{number:02d}") & (obj == object_id)
            if is_own.any():
                cells[tool, column] = Trace(*(channel[is_own] for channel in channels))
    base = TrueSet(name="base-0", theta=_THETA)
    return Panels(small.designs, small.objects, {base.name: base}, {base.name: cells}), bank
