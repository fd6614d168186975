"""The study of the elastic law: its differences by hand, its failures, and the laws' first two orders."""

from typing import Any

import numpy as np
import pytest

from fast.models.errors import SimulationFailed
from fast.models.records import GraspSimulation, Trace
from fast.models.simulation.body.elasticity import lame_constants
from tests.studies.benchmarks.base import Options
from tests.studies.simulation import material_law


def trace_of(peak_n: float) -> Trace:
    """Closing at no lift, then a force that falls in a straight line to 0 at 10 mm."""
    return Trace(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.0, 10.0]), np.array([-5.0, peak_n, 0.0]))


def grasp_of(peak_n: float) -> GraspSimulation:
    return GraspSimulation(trace_of(peak_n), peak_n, 2.0 * peak_n, 0.005 * peak_n, 1, 1, 1, 0.5)


def test_the_difference_of_two_traces_is_that_of_their_lifts() -> None:
    found = material_law.rms_difference_n(trace_of(10.0), trace_of(13.0))
    assert found == pytest.approx(3.0 / np.sqrt(3.0), rel=0.02)  # of a straight line from 3 to 0
    long = Trace(np.array([0.0, 4.0]), np.array([0.0, 20.0]), np.array([4.0, 4.0]))
    none = Trace(np.array([0.0, 2.0]), np.array([0.0, 10.0]), np.array([4.0, 4.0]))
    assert material_law.rms_difference_n(long, none) == pytest.approx(4.0 / np.sqrt(2.0), rel=0.02)


def test_differences_have_the_sign_of_the_linear_law_and_failures_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def simulate(design: Any, obj: Any, *, numerics: Any, deadline_s: float) -> GraspSimulation:
        is_linear = numerics.material_law == "st_venant_kirchhoff"
        if is_linear and obj.object_id == 10:
            raise SimulationFailed("made up", "indefinite")
        return grasp_of(10.0 if not is_linear else 9.0)

    monkeypatch.setattr(material_law, "simulate_grasp", simulate)
    tables = material_law.measure_material_law(Options(designs=2, objects=(1, 10)))
    assert [row["grasps"] for row in tables["differences"]] == [2, 2, 2, 2]
    peak, work, force, trace = tables["differences"]
    assert [row["bias_percent"] for row in (peak, work, force)] == pytest.approx([-10.0] * 3)
    assert trace["worst_percent"] == pytest.approx(10.0 / np.sqrt(3.0), rel=0.02)
    assert [(row["failed"], row["reasons"]) for row in tables["laws"]] == [(0, ""), (2, "indefinite 2")]
    assert tables["objects"][1]["peak_median_percent"] is None


def bar_stress(law: str, strain: float, poisson_ratio: float = 0.45) -> float:
    """First Piola-Kirchhoff stress over E of a bar under tension, sides free; models.simulation.body.elasticity."""
    lam, mu = lame_constants(1.0, poisson_ratio)
    stretch = 1.0 + strain
    if law == "st_venant_kirchhoff":
        return stretch * 0.5 * (stretch**2 - 1.0)
    side = 1.0 - poisson_ratio * strain
    for _ in range(50):  # mu (s^2 - 1) + lam ln(l s^2) = 0, by Newton's method
        side -= (mu * (side**2 - 1.0) + lam * np.log(stretch * side**2)) / (2.0 * mu * side + 2.0 * lam / side)
    return float(mu * (stretch - 1.0 / stretch) + lam * np.log(stretch * side**2) / stretch)


@pytest.mark.parametrize(("law", "second_order"), [("neo_hookean", -0.94), ("st_venant_kirchhoff", 1.5)])
def test_the_second_order_of_the_laws_is_what_the_page_says(law: str, second_order: float) -> None:
    """docs/explanation/simulator.md, The material as the paper has it."""
    curvature = (bar_stress(law, 1e-3) + bar_stress(law, -1e-3)) / (2.0 * 1e-6)
    assert curvature == pytest.approx(second_order, abs=0.01)
