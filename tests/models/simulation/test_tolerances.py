"""The scatter of a simulated peak between prints and mountings."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import SimulationFailed
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup
from fast.models.simulation import scatter
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.scatter import find_scatter
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


def test_what_cannot_be_simulated_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def peak(grasp: GraspInputs) -> float:
        if grasp.placement.offset_z_mm > 0.0:
            raise SimulationFailed("it took too long", "time_out")
        return fake_peak(grasp)

    monkeypatch.setattr(scatter, "_find_peak", peak)
    found = find_scatter(GRASP, Tolerances())
    assert (found.sd_n, found.missing) == (pytest.approx(3.0), ("offset_z_mm",))
    assert Tolerances().describe(found.missing) == "wall offset 0.1 mm, closed gap 0.2 mm"
    assert find_scatter(GRASP, Tolerances(wall_offset_mm=0.0, closed_gap_mm=0.0)) == (None, ("offset_z_mm",))


def test_the_scatter_is_that_of_simulated_copies() -> None:
    """Of one tolerance and eight copies, to keep it short: so few know their own spread to a quarter."""
    assert find_scatter(GRASP, Tolerances(wall_offset_mm=0.0, closed_gap_mm=0.0)).sd_n == pytest.approx(
        np.std([scatter._find_peak(copy) for copy in _copies()], ddof=1), rel=0.5
    )


def _copies() -> list[GraspInputs]:
    heights_mm = 0.2 * np.random.default_rng(1).normal(size=8)
    placed = [GRASP.placement.model_copy(update={"offset_z_mm": float(z)}) for z in heights_mm]
    return [GraspInputs(GRASP.design, GRASP.obj, GRASP.version, GRASP.setup, placement) for placement in placed]
