"""Which versions' results are one another's up to Young's modulus; `test_effects` simulates what each effect claims."""

from fast.models.records import EffectValue, Theta
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.effects.scaling import force_ratio, scales_with_modulus
from fast.models.simulation.version import SimulatorVersion

PARAMETERS = {"force_limited_closing": {"max_force_n": 6.0}}


def version(young_modulus_mpa: float, *effects: EffectValue, friction: float = 0.56) -> SimulatorVersion:
    theta = Theta(young_modulus_mpa=young_modulus_mpa, friction=friction)
    return SimulatorVersion(theta=theta, effects=effects)


def switched_on(effect: str) -> EffectValue:
    medians = {p.name: p.prior_median for p in CATALOGUE[effect].parameters}
    return EffectValue(effect=effect, parameters=PARAMETERS.get(effect, medians))


def test_an_effect_that_breaks_the_scaling_counts_only_away_from_neutral() -> None:
    neutral = CATALOGUE["force_limited_closing"].neutral
    assert scales_with_modulus(version(8.0, neutral))
    assert scales_with_modulus(version(8.0, EffectValue(effect="force_limited_closing")))
    assert not scales_with_modulus(version(8.0, switched_on("force_limited_closing")))
    assert not scales_with_modulus(version(8.0, switched_on("load_cell_lag"), switched_on("shear_adhesion")))


def test_only_young_modulus_may_differ() -> None:
    lag = switched_on("load_cell_lag")
    assert force_ratio(version(8.0, lag), version(4.0, lag)) == 0.5
    assert force_ratio(version(8.0, lag), version(8.0)) is None
    assert force_ratio(version(8.0), version(8.0, friction=0.5)) is None
    limited = switched_on("force_limited_closing")
    assert force_ratio(version(8.0, limited), version(8.0, limited)) == 1.0


def test_an_effect_nobody_has_judged_is_taken_to_break_the_scaling() -> None:
    assert not scales_with_modulus(SimulatorVersion(effects=(EffectValue(effect="not_yet_known"),)))
