"""Worlds of an independent solver: its grasps, measured by the made-up lab with the laws of the lab.

What the solver and the simulator differ by is part of every world, so these figures say how gap discovery fares where
the simulator is not merely on another mesh. The laws act on traces; none of them changes what the solver solved.
"""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.challenge.hidden.panels import Panels, TrueSet
from fast.flows.challenge.hidden.worlds import Group, WorldKey, Worlds
from fast.models.gap.bank.bank import Bank
from fast.models.gap.data import GapData
from fast.models.gap.evidence.candidates import weigh_candidates
from fast.models.gap.evidence.likelihood import Problem, fit_evidence
from fast.models.gap.evidence.trials import LEAST, Trials
from fast.models.records import Trace
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.gap.development import PUBLIC_SEED, measure_worlds

DATA = Path(__file__).parents[2] / "data"
N_WORLDS: dict[Group, int] = {"null": 60, "single": 48, "unlisted": 12, "pair": 24}
SMALL_PANELS = ((1, 2), (1, 3), (2, 2), (2, 3), (3, 3), (4, 4), (5, 4))  # designs and objects
N_SMALL: dict[Group, int] = {"null": 60, "single": 48, "unlisted": 12}
_VISIBLE = 0.04  # of the force
_THETA = (0.52, 0.45)  # friction and Poisson's ratio


def measure_gap_independent(options: Options) -> Tables:
    """False alarms, names and closed gaps of gap discovery where another solver's grasps are the truth."""
    panels, bank = read_independent()
    tables = measure_worlds(Worlds(panels, bank, PUBLIC_SEED), "independent", N_WORLDS, options)
    small = [
        _measure_small(Worlds(panels, bank, PUBLIC_SEED, n_designs=n_designs, n_objects=n_objects), options)
        for n_designs, n_objects in SMALL_PANELS
    ]
    return {**tables, "small panels": small}


def _measure_small(worlds: Worlds, options: Options) -> dict[str, object]:
    """Alarms on panels too small to hold anything out, by the least lines that a rehearsal draws."""
    keys = [worlds.draw(group, number) for group, n in N_SMALL.items() for number in range(min(n, options.worlds or n))]
    hidden = [sum(one.spread_strength for one in key.effects) for key in keys]
    alarms = [is_alarm(worlds, key) for key in keys]
    nothing = [alarm for key, alarm in zip(keys, alarms, strict=True) if not key.effects]
    visible = [alarm for strength, alarm in zip(hidden, alarms, strict=True) if strength >= _VISIBLE]
    row = {
        "panel": f"{worlds.n_designs} x {worlds.n_objects}",
        "nothing hidden": len(nothing),
        "false alarms": sum(nothing),
        "visible 4 % or more": len(visible),
        "noticed": sum(visible),
    }
    options.tell(str(row))
    return row


def is_alarm(worlds: Worlds, key: WorldKey) -> bool:
    """Whether a world is an alarm by the least lines, all its grasps taken together."""
    problem = worlds.problem(key)
    data = GapData.of_all(problem.grasps, problem.bank).usable
    fit = fit_evidence(Problem.of(data))
    weighed = weigh_candidates(fit, data.names)
    trials = Trials.of(fit, weighed, {name: CATALOGUE[name].family for name in data.names})
    return trials.signs.measure_over(LEAST) > 1.0


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
