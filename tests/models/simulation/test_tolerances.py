"""The scatter of a simulated peak between prints and mountings."""

from collections.abc import Callable

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import SimulationFailed, UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup
from fast.models.simulation import scatter
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.scatter import find_scatter
from fast.models.simulation.slopes.parameters import Parameter, find_parameters
from fast.models.simulation.tolerances import Tolerances
from fast.models.simulation.version import SimulatorVersion

GRASP = GraspInputs(BEST_PUBLISHED, get_object(30), SimulatorVersion(), GraspSetup())


def fake_peak(grasp: GraspInputs) -> float:
    """30 N per mm of walls, -20 N per mm of height, nothing of closing beyond its ends, where it rises alike."""
    walls_mm = sum(effect.parameters["offset_mm"] for effect in grasp.version.effects)
    closing_mm = grasp.setup.closed_gap_mm - GraspSetup().closed_gap_mm
    return 50.0 + 30.0 * walls_mm - 20.0 * grasp.placement.offset_z_mm + 100.0 * abs(closing_mm)


def test_independent_tolerances_add_as_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scatter, "_find_peak", fake_peak)
    found = find_scatter(GRASP, Tolerances())
    assert found.sd_n == pytest.approx(5.0)  # 3 N of walls, 4 N of height
    assert found.missing == ()
    assert Tolerances().describe() == "wall offset 0.1 mm, offset z 0.2 mm, closed gap 0.2 mm"
    assert find_scatter(GRASP, Tolerances(offset_z_mm=0.0)).sd_n == pytest.approx(3.0)


def lose_copies(monkeypatch: pytest.MonkeyPatch, is_lost: Callable[[float, float], bool]) -> None:
    """Grasps whose walls and height, in standard deviations, are lost cannot be simulated."""

    def peak(grasp: GraspInputs) -> float:
        walls_mm = sum(effect.parameters["offset_mm"] for effect in grasp.version.effects)
        if is_lost(walls_mm / 0.1, grasp.placement.offset_z_mm / 0.2):
            raise SimulationFailed("it took too long", "time_out")
        return fake_peak(grasp)

    monkeypatch.setattr(scatter, "_find_peak", peak)


def test_three_of_four_copies_tell_the_scatter(monkeypatch: pytest.MonkeyPatch) -> None:
    lose_copies(monkeypatch, lambda walls, height: walls > 0 and height > 0)
    found = find_scatter(GRASP, Tolerances())
    assert found.missing == ()
    assert found.sd_n == pytest.approx(5.0, rel=0.35)


def test_fewer_tell_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    lose_copies(monkeypatch, lambda walls, height: height > 0)
    assert find_scatter(GRASP, Tolerances()) == (None, ("wall_offset_mm", "offset_z_mm", "closed_gap_mm"))
    assert find_scatter(GRASP, Tolerances(wall_offset_mm=0.0, closed_gap_mm=0.0)) == (None, ("offset_z_mm",))


def test_what_a_family_does_not_have_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def find(inputs: GraspInputs, name: str) -> dict[str, Parameter]:
        if name == "wall_offset_mm":
            raise UsageError("this family has no walls")
        return find_parameters(inputs, name)

    monkeypatch.setattr(scatter, "find_parameters", find)
    monkeypatch.setattr(scatter, "_find_peak", fake_peak)
    found = find_scatter(GRASP, Tolerances())
    assert (found.sd_n, found.missing) == (pytest.approx(4.0), ("wall_offset_mm",))
    assert Tolerances().describe(found.missing) == "offset z 0.2 mm, closed gap 0.2 mm"


def test_four_grasps_are_simulated_of_three_tolerances_and_two_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    simulated = []
    monkeypatch.setattr(scatter, "_find_peak", lambda grasp: simulated.append(grasp) or 10.0)
    for tolerances, n in (
        (Tolerances(), 4),
        (Tolerances(closed_gap_mm=0.0), 4),
        (Tolerances(offset_z_mm=0.0, closed_gap_mm=0.0), 2),
    ):
        simulated.clear()
        assert find_scatter(GRASP, tolerances).sd_n == 0.0
        assert len(simulated) == n
    assert find_scatter(GRASP, Tolerances(wall_offset_mm=0.0, offset_z_mm=0.0, closed_gap_mm=0.0)) == (None, ())


def test_the_scatter_is_that_of_simulated_copies() -> None:
    """Of one tolerance and eight copies, to keep it short: so few know their own spread to a quarter."""
    assert find_scatter(GRASP, Tolerances(wall_offset_mm=0.0, closed_gap_mm=0.0)).sd_n == pytest.approx(
        np.std([scatter._find_peak(copy) for copy in _copies()], ddof=1), rel=0.5
    )


def _copies() -> list[GraspInputs]:
    heights_mm = 0.2 * np.random.default_rng(1).normal(size=8)
    placed = [GRASP.placement.model_copy(update={"offset_z_mm": float(z)}) for z in heights_mm]
    return [GraspInputs(GRASP.design, GRASP.obj, GRASP.version, GRASP.setup, placement) for placement in placed]
