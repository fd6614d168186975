"""What must hold after the kills of `tests.studies.crash.server_kills`, and what of it does not."""

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from fast.flows.server.crashed_runs import ACTIVE
from fast.lake.maintenance import check
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ProposalRow, Row, SimulationRow
from fast.models.errors import LakeError
from fast.models.records import BENCH_FAULT
from tests.studies.benchmarks.made_up_campaign import N_SIMULATIONS, N_TOOLS, OBJECTS, labels_of, world_of
from tests.studies.crash.labels import SparseTraceError, label_problem

N_SIMULATED = (N_SIMULATIONS + N_TOOLS) * len(OBJECTS)


@dataclass(frozen=True)
class Progress:
    """How far a campaign is."""

    n_rows: int
    is_complete: bool

    @classmethod
    def of(cls, lake: Lake, name: str) -> "Progress":
        """From the lake as it is now; a campaign is complete when its last words are there."""
        try:
            grasps = lake.query("SELECT count(*) AS n FROM grasps WHERE campaign_id = ?", [name])
            simulations = lake.query(_OWN_SIMULATIONS.format("count(*) AS n"), [name])
            ended = lake.query("SELECT count(*) AS n FROM events WHERE campaign_id = ? AND kind = 'completed'", [name])
        except LakeError:  # a file that is being merged away
            return cls(0, False)
        counts = [table.column("n")[0].as_py() for table in (grasps, simulations, ended)]
        return cls(counts[0] + counts[1], counts[2] > 0)


_OWN_SIMULATIONS = """
    SELECT {} FROM simulations WHERE design_id IN (SELECT design_id FROM proposals WHERE campaign_id = ?)
"""


def judge_campaign(lake: Lake, name: str) -> list[str]:
    """Everything wrong with a campaign that is complete: lost, double or mislabelled grasps and simulations."""
    grasps = lake.rows(GraspRow, campaign_id=name)
    good = [grasp for grasp in grasps if grasp["status"] == "ok"]
    wanted, found = set(labels_of(name)), Counter((g["tool_id"], g["object_id"], g["repeat"]) for g in good)
    problems = [f"{label} is missing" for label in sorted(wanted - set(found))]
    problems += [f"{label} is there {n} times" for label, n in found.items() if n > 1 or label not in wanted]
    problems += [
        f"{grasp['grasp_id']} failed: {grasp['reason']}"
        for grasp in grasps
        if grasp["status"] != "ok" and BENCH_FAULT not in grasp["details_json"]
    ]
    world = world_of(name)
    for grasp in good:
        with suppress(SparseTraceError):
            label = (grasp["tool_id"], grasp["object_id"], grasp["repeat"])
            problems.append(label_problem(world, label, lake.trace(grasp["grasp_id"])))
    designs = {row["design_id"] for row in lake.rows(ProposalRow, campaign_id=name)}
    simulated = Counter((r["design_id"], r["object_id"]) for r in lake.rows(SimulationRow) if r["design_id"] in designs)
    if len(simulated) != N_SIMULATED or set(simulated.values()) != {1}:
        problems.append(f"{name}: {len(simulated)} different simulations of {N_SIMULATED}, {simulated.total()} rows")
    problems += [f"{_n_written(lake, kind)} rows of {kind.table} were written for {n}" for kind, n in _doubles(lake)]
    # A kill in the middle of a write leaves its temporary file; its rows were never visible.
    problems += [finding.message for finding in check(lake) if finding.kind != "leftover"]
    return [f"{name}: {problem}" for problem in problems if problem]


def judge_server(ask: Callable[[str, dict[str, Any]], Any]) -> list[str]:
    """Flow runs that the server, asked so, still holds for active, though nothing runs any more."""
    question = {"flow_runs": {"state": {"type": {"any_": list(ACTIVE)}}}}
    runs = ask("/flow_runs/filter", question)
    return [f"the flow run {run['name']} is still {run['state']['name']}" for run in runs]


def _doubles(lake: Lake) -> list[tuple[type[Row], int]]:
    """Tables with more rows written than there are, and how many there are: something was made twice."""
    counts = [(kind, len(lake.ids(kind))) for kind in (GraspRow, SimulationRow)]
    return [(kind, n) for kind, n in counts if _n_written(lake, kind) != n]


def _n_written(lake: Lake, kind: type[Row]) -> int:
    """Rows in the files, with those that a later one replaced."""
    table = lake.query(f"SELECT count(*) AS n FROM raw_{kind.table}")
    return int(table.column("n")[0].as_py())
