"""Which versions' results are one another's up to Young's modulus: claimed per effect, and checked by simulating."""

import numpy as np
import pytest

from models.design_space import BEST_PUBLISHED
from models.effects.catalogue import CATALOGUE, scales_with_modulus
from models.effects.scaling import force_ratio
from models.fem.grasp import simulate_grasp
from models.objects.catalogue import get_object
from models.records import EffectValue, SimulatorVersion, Theta

PARAMETERS = {"force_limited_closing": {"max_force_n": 6.0}}


def version(young_modulus_mpa: float, *effects: EffectValue, friction: float = 0.56) -> SimulatorVersion:
    theta = Theta(young_modulus_mpa=young_modulus_mpa, friction=friction)
    return SimulatorVersion(theta=theta, effects=effects, tier="screening")


def switched_on(effect: str) -> EffectValue:
    medians = {p.name: p.prior_median for p in CATALOGUE[effect].parameters}
    return EffectValue(effect=effect, parameters=PARAMETERS.get(effect, medians))


@pytest.mark.parametrize("effect", ["static_kinetic_friction", "load_cell_lag", "force_limited_closing"])
def test_forces_scale_where_it_is_claimed_and_only_there(effect: str) -> None:
    old, new = (version(modulus, switched_on(effect)) for modulus in (8.0, 12.0))
    forces = [simulate_grasp(BEST_PUBLISHED, get_object(14), v).trace.force_n for v in (old, new)]
    is_exact = len(forces[0]) == len(forces[1]) and np.allclose(1.5 * forces[0], forces[1], rtol=1e-9, atol=1e-9)
    assert is_exact == (force_ratio(old, new) == 1.5) == scales_with_modulus(new)


def test_only_young_modulus_may_differ() -> None:
    lag = switched_on("load_cell_lag")
    assert force_ratio(version(8.0, lag), version(4.0, lag)) == 0.5
    assert force_ratio(version(8.0, lag), version(8.0)) is None
    assert force_ratio(version(8.0), version(8.0, friction=0.5)) is None
    limited = switched_on("force_limited_closing")
    assert force_ratio(version(8.0, limited), version(8.0, limited)) == 1.0


def test_an_effect_nobody_has_judged_is_taken_to_break_the_scaling() -> None:
    assert not scales_with_modulus(SimulatorVersion(effects=(EffectValue(effect="not_yet_known"),)))
