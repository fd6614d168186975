"""Effects with a memory: nothing in the first grasp, saturation in the end, each on its own count."""

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED
from fast.models.records import GraspContext, GraspSetup, Theta
from fast.models.simulation.effects.actuation import PressureDroop
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.contact import FrictionWear, VelocityStrengtheningFriction
from fast.models.simulation.effects.material import BatchAgeing, MullinsSoftening, TemperatureSoftening

NONE, SETUP = np.zeros(0), GraspSetup()


def after(effect: Effect, setup: GraspSetup = SETUP, **count: float) -> Effect:
    return effect.in_grasp(BEST_PUBLISHED, setup, GraspContext.model_validate(count))


def modulus(effect: Effect) -> float:
    return effect.modify_theta(Theta(young_modulus_mpa=10.0), BEST_PUBLISHED).young_modulus_mpa


def test_the_first_grasp_is_that_of_a_new_tool() -> None:
    assert modulus(after(MullinsSoftening(0.2, 2.0))) == modulus(after(TemperatureSoftening(0.2, 600.0))) == 10.0
    assert after(FrictionWear(0.3, 50.0)).friction_factor(NONE, NONE) == 1.0
    assert after(PressureDroop(1.0, 100.0)).modify_setup(SETUP, BEST_PUBLISHED) == SETUP


def test_mullins_softening_goes_with_the_repeats_only() -> None:
    law = MullinsSoftening(0.2, 2.0)
    assert modulus(after(law, repeat=2)) == pytest.approx(10.0 * (1 - 0.2 * (1 - np.exp(-1.0))))
    assert modulus(after(law, repeat=1000)) == pytest.approx(8.0)
    assert modulus(after(law, tool_grasps=500, batch_grasps=900, clock_s=9000.0)) == 10.0


def test_temperature_goes_with_the_clock_only_and_may_fall() -> None:
    law = TemperatureSoftening(0.1, 3600.0)
    assert modulus(after(law, clock_s=3600.0)) == pytest.approx(10.0 * (1 - 0.1 * (1 - np.exp(-1.0))))
    assert modulus(after(law, repeat=9, tool_grasps=500)) == 10.0
    assert modulus(after(TemperatureSoftening(-0.1, 600.0), clock_s=1e6)) == pytest.approx(11.0)


def test_wear_goes_with_the_grasps_of_the_tool() -> None:
    law = FrictionWear(0.4, 50.0)
    assert after(law, tool_grasps=50).friction_factor(NONE, NONE) == pytest.approx(1 - 0.4 * (1 - np.exp(-1.0)))
    assert after(law, tool_grasps=10**6).friction_factor(NONE, NONE) == pytest.approx(0.6)
    assert after(law, repeat=5, batch_grasps=500).friction_factor(NONE, NONE) == 1.0


def test_droop_takes_stroke_from_each_jaw_with_the_grasps_of_the_batch() -> None:
    law = PressureDroop(1.5, 100.0)
    late = after(law, batch_grasps=10**6).modify_setup(SETUP, BEST_PUBLISHED)
    assert late.closed_gap_mm == pytest.approx(SETUP.closed_gap_mm + 3.0)
    assert late.model_copy(update={"closed_gap_mm": SETUP.closed_gap_mm}) == SETUP
    narrow = GraspSetup(open_gap_mm=20, closed_gap_mm=19)
    assert after(law, narrow, batch_grasps=10**6).modify_setup(narrow, BEST_PUBLISHED).closed_gap_mm == 20.0


def test_ageing_is_a_factor_on_the_tool_modulus() -> None:
    assert modulus(after(BatchAgeing(0.15))) == pytest.approx(11.5)


def test_friction_grows_with_the_speed_of_the_lift() -> None:
    law = VelocityStrengtheningFriction(0.1, 2.0)
    factor = [after(law, GraspSetup(lift_speed_mm_per_s=v)).friction_factor(NONE, NONE) for v in (1e-6, 2.0, 20.0)]
    assert factor == pytest.approx([1.0, 1.0 + 0.1 * np.log(2.0), 1.0 + 0.1 * np.log(11.0)])
