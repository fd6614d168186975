import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED
from fast.models.objects.catalogue import get_object
from fast.models.records import EffectValue, GraspSetup, Theta
from fast.models.simulation.actuation import ClosingStall, Jaw
from fast.models.simulation.effects.actuation import BaseCompliance
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.solver.stepping import Step
from fast.models.simulation.version import MeshSettings, SimulatorVersion

SHORT_LIFT = GraspSetup(max_lift_mm=4)
COARSE = MeshSettings(edge_mm=12)  # jaws and springs are the same on every mesh


def grasp(max_force_n: float | None, young_modulus_mpa: float = 11.5):
    effects = ()
    if max_force_n is not None:
        effects = (EffectValue(effect="force_limited_closing", parameters={"max_force_n": max_force_n}),)
    version = SimulatorVersion(theta=Theta(young_modulus_mpa=young_modulus_mpa), effects=effects, mesh=COARSE)
    return simulate_grasp(BEST_PUBLISHED, get_object(2), version, SHORT_LIFT)


def test_jaws_that_do_not_stall_change_nothing():
    with_effect, without = grasp(100.0), grasp(None)
    # Only the steps of the closing differ.
    assert with_effect.contact_force_n == pytest.approx(without.contact_force_n, rel=1e-3)
    assert with_effect.peak_force_n == pytest.approx(without.peak_force_n, rel=0.01)


def test_limited_jaws_stall_at_their_force_and_hold_less():
    free, limited = grasp(None), grasp(12.0)
    assert free.contact_force_n > 15
    assert limited.contact_force_n == pytest.approx(12.0, rel=0.02)
    assert limited.peak_force_n < 0.9 * free.peak_force_n
    assert np.all(np.diff(limited.trace.time_s) > 0)


def test_a_stiffer_finger_gains_little_where_the_jaw_limits():
    soft, stiff = grasp(12.0, 11.5), grasp(12.0, 23.0)
    assert stiff.contact_force_n == pytest.approx(soft.contact_force_n, rel=0.02)
    assert stiff.peak_force_n < 1.5 * soft.peak_force_n


def on_a_spring(compliance_mm_per_n, **setup):
    effects = [BaseCompliance(compliance_mm_per_n)]
    return simulate_grasp(
        BEST_PUBLISHED,
        get_object(2),
        SimulatorVersion(mesh=COARSE),
        setup=SHORT_LIFT.model_copy(update=setup),
        effects=effects if compliance_mm_per_n else [],
    )


@pytest.mark.parametrize("compliance_mm_per_n", [0.01, 0.05, 0.1])
def test_a_compliant_base_closes_less_by_its_force_times_compliance(compliance_mm_per_n):
    soft = on_a_spring(compliance_mm_per_n)
    behind_mm = compliance_mm_per_n * soft.contact_force_n
    shorter = on_a_spring(0.0, closed_gap_mm=SHORT_LIFT.closed_gap_mm + 2 * behind_mm)
    assert soft.contact_force_n == pytest.approx(shorter.contact_force_n, rel=0.005)
    assert soft.peak_force_n == pytest.approx(shorter.peak_force_n, rel=0.02)


def test_a_jaw_may_stall_and_give_way():
    limited = Jaw(max_force_n=10.0, compliance_mm_per_n=0.1)
    stall = ClosingStall(limited, stroke_mm=4.0, longest_mm=2.0)
    travel, stiffness = 0.0, 3.0
    for _ in range(20):
        travel += stall.longest_step_mm(travel)
        if stall.has_stalled(Step(travel, None, np.array([-stiffness * travel, 0.0, 0.0]), None, None, 0.0)):
            break
    # The spring takes 4 - 3.08 mm at 9.2 N, before the force limit is met.
    assert travel == pytest.approx(4.0 / (1.0 + 0.1 * stiffness), abs=0.02)
    assert Jaw().is_rigid
    assert not limited.is_rigid
