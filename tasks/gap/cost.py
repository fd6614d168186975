"""What simulating costs, before it begins: what the lake lacks, and CPU time by what such grasps have taken."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from fast.lake.store import Lake
from fast.lake.tables.campaign import SimulatorVersionRow
from fast.models.gap.bank.bank import CENTRE, BankPlan
from fast.models.gap.local_bank import MOST_EFFECTS, MOST_RUNS
from fast.models.ids import canonical_json
from fast.models.records import Design, EffectValue, Theta
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.simulation.plan import SimulationPlan, missing_objects

_T = TypeVar("_T")
_PROBED_DESIGNS, _PROBED_OBJECTS = 2, 2


@dataclass(frozen=True)
class GraspCosts:
    """Mean CPU seconds of a simulated grasp by kind of simulator: its mesh costs most, theta and effects little."""

    cpu_s: Mapping[str, float]

    @staticmethod
    def read(lake: Lake) -> "GraspCosts":
        """Read what the grasps of this lake have taken, the failed ones too."""
        sql = "SELECT version_id, sum(cpu_s) AS cpu_s, count(*) AS n FROM simulations WHERE cpu_s > 0 GROUP BY 1"
        spent = {row["version_id"]: (row["cpu_s"], row["n"]) for row in lake.query(sql).to_pylist()}
        total, count = defaultdict[str, float](float), Counter[str]()
        rows = lake.records(SimulatorVersionRow, version_id=list(spent)) if spent else []
        for row in rows:
            if row.tier != "imported":
                cpu_s, n = spent[row.version_id]
                kind = name_kind(row.version)
                total[kind] += cpu_s
                count[kind] += n
        return GraspCosts({kind: total[kind] / count[kind] for kind in total})

    def of(self, version: SimulatorVersion) -> float | None:
        """Return the CPU seconds of a grasp with a version; None if no such grasp is known."""
        return self.cpu_s.get(name_kind(version))


@dataclass(frozen=True)
class Cost:
    """Grasps to simulate and their CPU seconds; None where a kind of them has never been measured."""

    n_grasps: int
    cpu_s: float | None


def name_kind(version: SimulatorVersion) -> str:
    """Name what a simulator version is but for theta and effects."""
    return canonical_json(version.model_copy(update={"theta": Theta(), "effects": ()}).model_dump(mode="json"))


def estimate_cost(lake: Lake, plans: Sequence[SimulationPlan], costs: GraspCosts) -> Cost:
    """Estimate the cost of what the lake lacks of plans."""
    missing = [
        (costs.of(version), len(objects)) for plan in plans for (_, version), objects in missing_objects(lake, plan)
    ]
    known = [cpu_s * n for cpu_s, n in missing if cpu_s is not None]
    return Cost(sum(n for _, n in missing), sum(known) if len(known) == len(missing) else None)


def plan_probe(lake: Lake, plans: Sequence[SimulationPlan], costs: GraspCosts) -> tuple[SimulationPlan, ...]:
    """Plan the few grasps that tell what is unknown of the cost of plans: of each kind, on two designs and objects."""
    found: dict[str, SimulationPlan] = {}
    for plan in plans:
        by_kind: dict[str, list[tuple[Design, SimulatorVersion]]] = defaultdict(list)
        for point, _ in missing_objects(lake, plan):
            if costs.of(point[1]) is None:
                by_kind[name_kind(point[1])].append(point)
        for kind, points in by_kind.items():
            same = [point for point in points if point[1] == points[0][1]]
            probed = _spread(same, _PROBED_DESIGNS)
            objects = _spread(plan.object_ids, _PROBED_OBJECTS)
            same_way = replace(plan, points=tuple(probed), object_ids=tuple(objects))
            found.setdefault(kind, same_way)
    return tuple(found.values())


def choose_largest_bank() -> BankPlan:
    """Choose a bank as large as any around a fitted theta, for its cost alone: at a theta where the wide one is not.

    Runs at fitted parameters count, too: here, between those of the bank and no effect.
    """
    most = sorted(CATALOGUE, key=lambda name: -len(CATALOGUE[name].bank_runs))[:MOST_EFFECTS]
    theta = np.array(list(CENTRE.model_dump().values())) * np.array([1.01, 1.0, 1.0])
    halves = [{name: 0.5 * value for name, value in row.items()} for row in CATALOGUE[most[0]].bank_runs[:MOST_RUNS]]
    runs = tuple(EffectValue(effect=most[0], parameters=row) for row in halves)
    return replace(BankPlan.around(theta, theta[None, 1:], most), runs=runs)


def _spread(values: Sequence[_T], n: int) -> list[_T]:
    """Return at most n of the values: the first, and others at equal steps."""
    return list(values[:: max(len(values) // n, 1)][:n])
