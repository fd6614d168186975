"""The time left of simulations: slow grasps at the end count for what they take."""

from pathlib import Path

import pytest

from fast.flows.progress import UNKNOWN, ProgressReporter
from fast.flows.simulation import progress
from fast.flows.simulation.progress import simulate_missing
from fast.lake.store import Lake
from fast.models.design.space import numbered_design
from fast.models.records import GraspSetup
from fast.models.simulation.version import MeshSettings, SimulatorVersion
from fast.tasks.simulation.plan import PointDone, SimulationPlan

QUICK, SLOW = SimulatorVersion(), SimulatorVersion(mesh=MeshSettings(refine=1))
DESIGNS = [numbered_design(number) for number in range(4)]
COST_S = {QUICK.version_id: 10.0, SLOW.version_id: 70.0}


def tell_times_left(lake: Lake, monkeypatch: pytest.MonkeyPatch, is_known: bool) -> list[str]:
    """What is said after each of four quick and four slow points of one grasp, on a clock that they move."""
    now = [0.0]
    said: list[str] = []

    def simulate_plan(lake: Lake, plan: SimulationPlan, n_workers: int, on_point, should_stop) -> int:  # type: ignore[no-untyped-def]
        for place, (_, version) in enumerate(plan.points):
            now[0] += COST_S[version.version_id]
            on_point(PointDone(0, place + 1, plan.n_grasps))
        return 0

    monkeypatch.setattr(progress, "simulate_plan", simulate_plan)
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    points = tuple((design, version) for version in (QUICK, SLOW) for design in DESIGNS)
    plan = SimulationPlan(points, (1,), GraspSetup())
    cost_s = (lambda version: COST_S[version.version_id]) if is_known else (lambda version: None)
    simulate_missing(lake, [plan], 1, ProgressReporter(said.append, said.append), lambda: False, cost_s)
    return [line.rpartition("|  ")[2] for line in said if "missing grasps" in line]


def test_known_costs_make_the_time_left_true(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    said = tell_times_left(lake, monkeypatch, is_known=True)
    assert said[:3] == [UNKNOWN, UNKNOWN, "5 min left"]
    assert said[3:] == ["5 min left", "4 min left", "2 min left", "70 s left", "0 s left"]


def test_without_costs_a_grasp_is_a_grasp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    assert tell_times_left(lake, monkeypatch, is_known=False)[:3] == [UNKNOWN, UNKNOWN, "50 s left"]
