"""The catalogue of effects: its entries, its errors, and every effect at amplitude zero."""

from functools import cache

import numpy as np
import pytest

from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import ConfigError, UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import EffectValue, GraspContext, GraspSetup, GraspSimulation, Theta
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.catalogue import CATALOGUE, build_effects
from fast.models.simulation.effects.material import StressRelaxation
from fast.models.simulation.effects.scaling import scales_with_modulus
from fast.models.simulation.effects.sensor import LoadCellGain, LoadCellLag
from fast.models.simulation.effects.spec import LAYERS, EffectSpec
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.version import MeshSettings, SimulatorVersion
from fast.models.units import unit_of
from tests.synthetic.simulation import replayed

EVERY = sorted(CATALOGUE)
CUBE = get_object(30)
# Late in a batch, so that effects with a memory act; a short lift over which the fingers slip.
LATE = GraspContext(repeat=2, tool_grasps=60, batch_grasps=300, clock_s=5400.0)
SHORT = GraspSetup(max_lift_mm=4)
COARSE = MeshSettings(edge_mm=12)  # what is compared holds on every mesh
# Where the prior median does not act on this grasp.
STRONG = {
    "force_limited_closing": {"max_force_n": 10.0},
    "hyperelastic_stiffening": {"stiffening": 10.0},
    "rib_imperfection": {"bow_mm": 0.5},
}


def strong(spec: EffectSpec) -> EffectValue:
    """The effect at its prior median, or a deviation from it where the median is neutral."""
    values = {}
    for p in spec.parameters:
        values[p.name] = p.prior_median if p.prior_median != p.neutral else min(p.neutral + p.prior_sd, p.upper)
    return EffectValue(effect=spec.effect, parameters=values | STRONG.get(spec.effect, {}))


def grasp(*effects: EffectValue, young_modulus_mpa: float = 11.5) -> GraspSimulation:
    theta = Theta(young_modulus_mpa=young_modulus_mpa)
    version = SimulatorVersion(theta=theta, mesh=COARSE, effects=effects)
    return simulate_grasp(BEST_PUBLISHED, CUBE, version, SHORT, context=LATE)


@cache
def grasp_with_strong(effect: str) -> GraspSimulation:
    return grasp(strong(CATALOGUE[effect]))


@pytest.fixture(scope="module")
def plain() -> GraspSimulation:
    return grasp()


@pytest.mark.parametrize("effect", EVERY)
def test_amplitude_zero_is_identical_to_without(effect: str, plain: GraspSimulation) -> None:
    neutral = grasp(CATALOGUE[effect].neutral)
    assert np.array_equal(neutral.trace.force_n, plain.trace.force_n)
    assert np.array_equal(neutral.trace.time_s, plain.trace.time_s)
    assert np.array_equal(neutral.trace.lift_mm, plain.trace.lift_mm)
    assert neutral.contact_force_n == plain.contact_force_n
    assert neutral.mesh_id == plain.mesh_id


@pytest.mark.parametrize("effect", EVERY)
def test_force_scales_with_the_modulus_exactly_where_an_effect_says_so(effect: str) -> None:
    value = strong(CATALOGUE[effect])
    single, double = grasp_with_strong(effect).trace, grasp(value, young_modulus_mpa=23.0).trace
    scales = np.array_equal(double.lift_mm, single.lift_mm) and np.allclose(double.force_n, 2.0 * single.force_n, 1e-9)
    claimed = scales_with_modulus(SimulatorVersion(effects=(value,)))
    assert scales == CATALOGUE[effect].scales_with_modulus == claimed


@pytest.mark.parametrize("effect", EVERY)
def test_effects_are_visible_and_those_of_cost_p_need_no_simulation(effect: str, plain: GraspSimulation) -> None:
    value, simulated = strong(CATALOGUE[effect]), grasp_with_strong(effect).trace
    common = np.interp(plain.trace.time_s, simulated.time_s, simulated.force_n)
    assert np.abs(common - plain.trace.force_n).max() > 0.003 * plain.peak_force_n
    if CATALOGUE[effect].cost == "P":
        effects = [e.in_grasp(BEST_PUBLISHED, SHORT, LATE) for e in build_effects([value])]
        again = replayed(plain.trace, effects, BEST_PUBLISHED, Theta())
        assert np.allclose(again.force_n, simulated.force_n, rtol=1e-12)
        assert np.allclose(again.time_s, simulated.time_s, rtol=1e-12)


@pytest.mark.parametrize("effect", EVERY)
def test_catalogue_entries_are_complete(effect: str) -> None:
    spec = CATALOGUE[effect]
    assert spec.effect == effect
    assert all(other in CATALOGUE and other != effect for other in spec.confusable_with)
    assert all(parameter.name in spec.formula for parameter in spec.parameters)
    assert spec.source
    assert spec.family
    for parameter in spec.parameters:
        assert parameter.lower <= parameter.neutral <= parameter.upper
        assert parameter.lower <= parameter.prior_median <= parameter.upper
        assert parameter.prior_sd > 0
        assert unit_of(parameter.name) in {"mm", "s", "N", "MPa", "mm/N", "mm/s", None}


def test_the_first_release_is_complete() -> None:
    layers = [LAYERS.index(spec.layer) for spec in CATALOGUE.values()]
    assert layers == sorted(layers)
    codes = {spec.code for spec in CATALOGUE.values()}
    assert len(codes) == len(CATALOGUE)
    first_release = "M1 M2 M3 M5 M7 C1 C4 C5 C7 C8 C9 C11 G1 G2 G5 A1 A3 A5 S1 S2 S3 S4 S5 S6"
    assert codes >= set(first_release.split())
    aliases = {spec.code: spec.alias_of for spec in CATALOGUE.values() if spec.alias_of}
    assert aliases == {"C2": "friction", "S1": "young_modulus_mpa", "M6": "tool_modulus"}


def test_unknown_names_and_values_are_sentences() -> None:
    with pytest.raises(ConfigError, match="Unknown effect `load_cell_lagg`; did you mean `load_cell_lag`"):
        build_effects([EffectValue(effect="load_cell_lagg")])
    with pytest.raises(ConfigError, match="no parameter `time_constant`; did you mean `time_constant_s`"):
        build_effects([EffectValue(effect="load_cell_lag", parameters={"time_constant": 1.0})])
    with pytest.raises(ConfigError, match="`gain` is 3.0, it must be within 0.8 to 1.25"):
        build_effects([EffectValue(effect="load_cell_gain", parameters={"gain": 3.0})])


def test_effects_act_layer_by_layer_and_else_in_their_order() -> None:
    names = ["load_cell_gain", "load_cell_lag", "stress_relaxation"]
    effects = build_effects([EffectValue(effect=name) for name in names])
    assert [type(effect) for effect in effects] == [StressRelaxation, LoadCellGain, LoadCellLag]


def test_an_effect_that_needs_a_simulation_is_not_replayed(plain: GraspSimulation) -> None:
    class Stiffer(Effect):
        def modify_theta(self, theta: Theta, design: object) -> Theta:
            return theta.model_copy(update={"poisson_ratio": 0.49})

    with pytest.raises(UsageError, match="simulate the grasp with it"):
        replayed(plain.trace, [Stiffer()], BEST_PUBLISHED, Theta())
