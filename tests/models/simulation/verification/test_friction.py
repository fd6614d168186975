"""Coulomb friction: a block on a slope rests or slides exactly as it should."""

import numpy as np
import pytest

from tests.models.simulation.verification.slope import GRAVITY_MM_PER_S2, STEP_S, slide

FRICTION = 0.56
CRITICAL = float(np.arctan(FRICTION))


@pytest.mark.parametrize("below_deg", [0.5, 5.0, 20.0])
def test_block_rests_below_the_friction_angle(below_deg: float) -> None:
    angle = CRITICAL - np.radians(below_deg)
    motion = slide(angle, FRICTION)
    assert motion.force_ratio[-1] == pytest.approx(np.tan(angle), rel=1e-6)
    assert motion.travel_mm[-1] == pytest.approx(motion.travel_mm[10], abs=1e-9)  # no creep
    assert motion.travel_mm[-1] < 1e-3  # the elastic give of contact and block


@pytest.mark.parametrize("above_deg", [0.5, 5.0, 15.0])
def test_block_slides_above_the_friction_angle(above_deg: float) -> None:
    angle = CRITICAL + np.radians(above_deg)
    motion = slide(angle, FRICTION)
    acceleration = np.diff(motion.speed_mm_per_s)[-20:] / STEP_S
    expected = GRAVITY_MM_PER_S2 * (np.sin(angle) - FRICTION * np.cos(angle))
    assert acceleration == pytest.approx(expected, rel=1e-4)
    assert motion.force_ratio[-1] == pytest.approx(FRICTION, rel=1e-6)
