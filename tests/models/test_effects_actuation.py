import numpy as np
import pytest

from models.design_space import BEST_PUBLISHED
from models.fem.grasp import simulate_grasp
from models.objects.catalogue import get_object
from models.records import EffectValue, GraspSetup, SimulatorVersion, Theta

SHORT_LIFT = GraspSetup(max_lift_mm=4)


def grasp(max_force_n: float | None, young_modulus_mpa: float = 11.5):
    effects = ()
    if max_force_n is not None:
        effects = (EffectValue(effect="force_limited_closing", parameters={"max_force_n": max_force_n}),)
    theta = Theta(young_modulus_mpa=young_modulus_mpa)
    return simulate_grasp(BEST_PUBLISHED, get_object(2), SimulatorVersion(theta=theta, effects=effects), SHORT_LIFT)


def test_unlimited_jaws_change_nothing():
    with_effect, without = grasp(1e6), grasp(None)
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
