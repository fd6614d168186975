"""Effects of the catalogue: amplitude zero is identical, limit cases agree with closed forms."""

import numpy as np
import pytest

from models.design_space import BEST_PUBLISHED
from models.effects.catalogue import CATALOGUE, build_effects
from models.effects.contact import StaticKineticFriction
from models.effects.geometry import WallThicknessOffset
from models.effects.sensor import LoadCellGain, LoadCellLag
from models.errors import ConfigError
from models.geometry.profile import planar_profile
from models.records import EffectValue, GraspSetup, Theta, Trace
from models.units import unit_of

TIME_S = np.array([0.0, 0.5, 1.0, 1.1, 1.2, 3.0, 8.0])
TRACE = Trace(TIME_S, np.array([0, 0, 0, 0.5, 1.0, 10.0, 35.0]), np.array([0, -4.0, -8, 2, 14, 9, 0.0]))


@pytest.mark.parametrize("effect", sorted(CATALOGUE))
def test_amplitude_zero_changes_nothing(effect: str) -> None:
    (built,) = build_effects([CATALOGUE[effect].neutral])
    profile, theta, setup = planar_profile(BEST_PUBLISHED), Theta(), GraspSetup()
    assert built.modify_profile(profile, BEST_PUBLISHED).equals_exact(profile, 0.0)
    assert built.modify_theta(theta, BEST_PUBLISHED) == theta
    assert built.modify_setup(setup, BEST_PUBLISHED) == setup
    slip = np.linspace(0, 5, 7)
    assert np.all(built.friction_factor(slip, np.ones(7)) == 1.0)
    assert np.array_equal(built.modify_trace(TRACE).force_n, TRACE.force_n)


@pytest.mark.parametrize("effect", sorted(CATALOGUE))
def test_catalogue_entries_are_complete(effect: str) -> None:
    spec = CATALOGUE[effect]
    assert spec.effect == effect
    assert all(other in CATALOGUE for other in spec.confusable_with)
    for parameter in spec.parameters:
        assert parameter.lower <= parameter.neutral <= parameter.upper
        assert parameter.lower <= parameter.prior_median <= parameter.upper
        assert parameter.prior_sd > 0
        assert unit_of(parameter.name) in {"mm", "s", "N", None}


def test_unknown_names_and_values_are_sentences() -> None:
    with pytest.raises(ConfigError, match="Unknown effect `load_cell_lagg`; did you mean `load_cell_lag`"):
        build_effects([EffectValue(effect="load_cell_lagg")])
    with pytest.raises(ConfigError, match="no parameter `time_constant`; did you mean `time_constant_s`"):
        build_effects([EffectValue(effect="load_cell_lag", parameters={"time_constant": 1.0})])
    with pytest.raises(ConfigError, match="`gain` is 3.0, it must be within 0.8 to 1.25"):
        build_effects([EffectValue(effect="load_cell_gain", parameters={"gain": 3.0})])


def test_effects_keep_their_order() -> None:
    values = [EffectValue(effect="load_cell_gain"), EffectValue(effect="load_cell_lag")]
    assert [type(effect) for effect in build_effects(values)] == [LoadCellGain, LoadCellLag]


def test_friction_falls_from_static_to_kinetic() -> None:
    effect = StaticKineticFriction(kinetic_ratio=0.7, slip_scale_mm=1.0)
    factor = effect.friction_factor(np.array([0.0, 1.0, 1e3]), np.zeros(3))
    assert np.allclose(factor, [1.0, 0.7 + 0.3 / np.e, 0.7])


@pytest.mark.parametrize("offset_mm", [0.2, -0.2])
def test_wall_offset_thickens_every_wall_and_keeps_the_planes(offset_mm: float) -> None:
    profile = planar_profile(BEST_PUBLISHED, 0.0)
    printed = WallThicknessOffset(offset_mm).modify_profile(profile, BEST_PUBLISHED)
    assert printed.is_valid
    assert printed.bounds[0] == pytest.approx(0.0, abs=1e-9)
    assert printed.bounds[1] == pytest.approx(profile.bounds[1])
    assert printed.bounds[3] == pytest.approx(profile.bounds[3])
    # A thin body grows by half the offset along its whole boundary, but for the cut ends.
    assert printed.area - profile.area == pytest.approx(0.5 * offset_mm * profile.length, rel=0.05)


def test_wall_offset_vanishes_continuously() -> None:
    profile = planar_profile(BEST_PUBLISHED, 0.0)
    printed = WallThicknessOffset(1e-4).modify_profile(profile, BEST_PUBLISHED)
    assert printed.symmetric_difference(profile).area < 0.1


def test_lag_follows_a_ramp_late_by_its_time_constant() -> None:
    time_s = np.linspace(0, 20, 41)
    ramp = Trace(time_s, 5 * time_s, 3.0 * time_s)
    reported = LoadCellLag(0.4).modify_trace(ramp).force_n
    expected = 3.0 * (time_s - 0.4 * (1 - np.exp(-time_s / 0.4)))
    assert np.allclose(reported, expected)


def test_lag_does_not_depend_on_the_sampling() -> None:
    fine_time = np.unique(np.concatenate([TIME_S, np.linspace(0, 8, 801)]))
    fine = Trace(fine_time, np.interp(fine_time, TIME_S, TRACE.lift_mm), np.interp(fine_time, TIME_S, TRACE.force_n))
    coarse = LoadCellLag(0.3).modify_trace(TRACE)
    resampled = np.interp(TIME_S, fine_time, LoadCellLag(0.3).modify_trace(fine).force_n)
    assert np.allclose(coarse.force_n, resampled, atol=1e-9)


def test_gain_scales_the_force_alone() -> None:
    scaled = LoadCellGain(1.1).modify_trace(TRACE)
    assert np.allclose(scaled.force_n, 1.1 * TRACE.force_n)
    assert np.array_equal(scaled.lift_mm, TRACE.lift_mm)
