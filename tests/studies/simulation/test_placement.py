"""The study of misplaced objects: its changes by hand, its failures, and what it moves."""

from typing import Any

import numpy as np
import pytest

from fast.models.errors import SimulationFailed
from fast.models.records import GraspSimulation, Placement, Trace
from tests.studies.benchmarks.base import Options
from tests.studies.simulation import placement as study


def test_changes_are_shares_of_the_peak_and_failures_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A constant force that a shift along x lowers by 3 % of itself, and a turned object that fails on one of two."""

    def simulate(design: Any, obj: Any, *, placement: Placement, deadline_s: float) -> GraspSimulation:
        if placement.yaw_deg == study.TURN_DEG and obj.object_id == 10:
            raise SimulationFailed("made up", "indefinite")
        force_n = 10.0 - placement.offset_x_mm
        trace = Trace(np.array([0.0, 2.0]), np.array([0.0, 10.0]), np.array([force_n, force_n]))
        return GraspSimulation(trace, force_n, 1.0, 0.1, 1, 1, 1, 0.5 if placement == Placement() else 1.0)

    monkeypatch.setattr(study, "simulate_grasp", simulate)
    (rows,) = study.measure_placement(Options(designs=1, objects=(1, 10))).values()
    by_name = {row["object"]: row for row in rows}
    assert list(by_name) == list(study.PLACEMENTS)
    shifted, turned = by_name["x, closing direction"], by_name["turned about z"]
    assert (shifted["grasps"], shifted["failed"], shifted["median_cost_ratio"]) == (2, 0, 2.0)
    assert shifted["median_percent"] == pytest.approx(3.0)
    assert (turned["grasps"], turned["failed"], turned["worst_percent"]) == (1, 1, 0.0)


def test_every_direction_is_moved_once_alone() -> None:
    """And x, y and the turn together."""
    moved = [{name for name, value in one.model_dump().items() if value != 0.0} for one in study.PLACEMENTS.values()]
    assert moved[:4] == [{"offset_x_mm"}, {"offset_y_mm"}, {"offset_z_mm"}, {"yaw_deg"}]
    assert moved[4] == {"offset_x_mm", "offset_y_mm", "yaw_deg"}
