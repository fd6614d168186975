"""Hidden laws of finger, jaw, contact and objects: each vanishes at amplitude zero and does its physics in limits."""

import numpy as np
import pytest

from fast.flows.challenge.hidden.lab_laws import tool_draws
from fast.flows.challenge.hidden.panels import UNSCALED
from fast.models.design.space import numbered_design
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup, Theta
from tests.studies.gap.grasp_laws.body_laws import (
    LayeredModulus,
    ScatteredStiffening,
    SlackMount,
    WavyRibs,
    WiderClosing,
)
from tests.studies.gap.grasp_laws.contact_laws import (
    FlashedFingers,
    HertzFriction,
    ObjectSurfaces,
    SaturatingAdhesion,
    ScaledObjects,
    SoftObjects,
    WornEdges,
)
from tests.studies.gap.grasp_laws.truth import (
    GRASP_LAWS,
    TrueGrasp,
    hidden_law,
    solve_truth,
    tool_modulus_factor,
    true_placement,
    truth_code,
)

DESIGN = numbered_design(3)
THETA = Theta(young_modulus_mpa=9.2, friction=0.62, poisson_ratio=0.43)
PRESSURES = np.array([0.0, 0.01, 0.05, 0.2])
NO_SLIP = np.zeros(4)


def test_stiffening_scatters_from_tool_to_tool_and_never_softens() -> None:
    """The mean is what was asked for."""
    values = [ScatteredStiffening(10.0, seed).strain_stiffening() for seed in range(300)]
    assert np.mean(values) == pytest.approx(10.0, rel=0.05)
    assert min(values) >= 0.0
    assert ScatteredStiffening(0.0, 1).strain_stiffening() == 0.0


def test_layers_change_only_the_ribs_and_most_the_level_ones() -> None:
    """The middle of a rib has the factor of its angle; the front wall is left alone."""
    points = np.column_stack([np.linspace(0.0, 20.0, 200), np.full(200, 40.0)])
    assert (LayeredModulus(0.0).stiffness_factor(points, DESIGN) == 1.0).all()
    level = DESIGN.model_copy(update={"rib_angle_deg": 0.0})
    steep = DESIGN.model_copy(update={"rib_angle_deg": 40.0})
    largest = [LayeredModulus(0.4).stiffness_factor(points, design).max() for design in (level, steep)]
    assert largest == pytest.approx([1.4, 1.0 + 0.4 * np.cos(np.radians(40.0)) ** 2], abs=1e-6)
    assert LayeredModulus(0.4).stiffness_factor(np.array([[0.5, 40.0]]), DESIGN)[0] == 1.0


def test_ribs_are_wavy_only_between_the_walls() -> None:
    """Neither the front wall nor base and tip move; amplitude zero moves nothing."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(0.0, 15.0, 400), rng.uniform(3.0, DESIGN.height_mm, 400)])
    assert np.array_equal(WavyRibs(0.0, 1).modify_section(points, DESIGN), points)
    moved_mm = np.abs(WavyRibs(0.4, 1).modify_section(points, DESIGN) - points).max(axis=1)
    assert 0.05 < moved_mm.max() < 0.4 * 2.6
    assert moved_mm[points[:, 0] < 0.5].max() < 1e-9
    assert moved_mm[points[:, 1] > DESIGN.height_mm - DESIGN.tip_length_mm].max() == 0.0


def test_a_mount_with_play_closes_less_even_without_force() -> None:
    """Slack widens the gap; the spring comes on top."""
    law = SlackMount(0.05)
    assert law.modify_setup(GraspSetup(), DESIGN).closed_gap_mm == pytest.approx(17.0)
    assert law.base_compliance_mm_per_n() == 0.05
    assert SlackMount(0.0).modify_setup(GraspSetup(), DESIGN) == GraspSetup()
    assert WiderClosing(2.0).modify_setup(GraspSetup(), DESIGN).closed_gap_mm == 20.0


def test_friction_by_hertz_falls_with_pressure_and_is_one_at_the_reference() -> None:
    """Bounded at no pressure, where a power law is not."""
    factor = HertzFriction(0.3).friction_factor(NO_SLIP, PRESSURES)
    assert (np.diff(factor) < 0.0).all()
    assert factor[2] == pytest.approx(1.0)
    assert factor[0] == pytest.approx(1.3)
    assert (HertzFriction(0.0).friction_factor(NO_SLIP, PRESSURES) == 1.0).all()


def test_adhesion_adds_its_full_stress_at_high_pressure_only() -> None:
    """The friction limit is mu p + tau0 (1 - exp(-p / p0))."""
    law, friction = SaturatingAdhesion(0.004, 0.6), 0.6
    limit = friction * PRESSURES * law.friction_factor(NO_SLIP, PRESSURES)
    assert limit[3] - friction * 0.2 == pytest.approx(0.004, rel=1e-3)
    assert limit[1] - friction * 0.01 == pytest.approx(0.004 * (1.0 - np.exp(-0.5)))
    assert np.isfinite(law.friction_factor(NO_SLIP, PRESSURES)).all()
    assert (SaturatingAdhesion(0.0, 0.6).friction_factor(NO_SLIP, PRESSURES) == 1.0).all()


def test_worn_edges_are_rounder_on_smaller_bodies_and_leave_spheres_alone() -> None:
    """Objects differ, and none gets a sharper edge than the contact resolves."""
    cube, sphere = get_object(30), get_object(1)
    worn = WornEdges(1.0).modify_object(cube)
    assert 1.3 < worn.parameters["rounding_mm"] < 2.7
    assert worn.parameters["size_x_mm"] == pytest.approx(39.9)
    assert WornEdges(1.0).modify_object(sphere) == sphere
    assert WornEdges(0.0).modify_object(cube) == cube
    assert WornEdges(-2.0).modify_object(cube).parameters["rounding_mm"] == 0.5


def test_flash_and_wrong_scale() -> None:
    """Flash scatters by tool; a wrong scale keeps edges."""
    stops = [FlashedFingers(7.0, seed).finger_stop_mm() for seed in range(200)]
    assert np.mean(stops) == pytest.approx(7.0, rel=0.05)
    scaled = ScaledObjects(1.03).modify_object(get_object(30))
    assert scaled.parameters["size_z_mm"] == pytest.approx(41.2)
    assert scaled.parameters["rounding_mm"] == 1.0


def test_draws_of_a_tool_are_its_own_and_always_the_same() -> None:
    """Clipped at two, reproducible, different by purpose."""
    assert np.array_equal(tool_draws(5, 1, 3), tool_draws(5, 1, 3))
    assert not np.array_equal(tool_draws(5, 1, 3), tool_draws(5, 2, 3))
    assert np.abs(tool_draws(5, 1, 1000)).max() <= 2.0


def test_a_true_grasp_is_known_by_its_content_and_by_the_code_of_its_law() -> None:
    """Another law, another id; placement is the same under all laws; only laws that break scaling carry a modulus."""
    plain = TrueGrasp(theta=THETA, design=0, object_id=1)
    capped = plain.model_copy(update={"law": "force_limited_closing", "parameters": {"max_force_n": 3.0}})
    assert plain.grasp_id != capped.grasp_id
    assert truth_code("") != truth_code("force_limited_closing")
    assert true_placement(plain) == true_placement(capped)
    raised = plain.model_copy(update={"raised_mm": 1.0})
    assert true_placement(raised).offset_z_mm - true_placement(plain).offset_z_mm == pytest.approx(1.0)
    assert tool_modulus_factor(plain) == 1.0
    assert 0.9 < tool_modulus_factor(capped) < 1.1 != tool_modulus_factor(capped)


def test_unknown_law_is_one_sentence() -> None:
    """With what was meant."""
    with pytest.raises(UsageError, match="did you mean `shear_adhesion`"):
        hidden_law("shear_adhesions")


def test_a_truth_closes_with_less_force_where_the_jaws_stall() -> None:
    """Solved with the finite elements: the jaw stops at its force, and the pull-off force goes down with it."""
    free = TrueGrasp(theta=THETA, design=3, object_id=14)
    limit_n = 3.0
    stalled = free.model_copy(update={"law": "force_limited_closing", "parameters": {"max_force_n": limit_n}})
    results = [solve_truth(grasp) for grasp in (free, stalled)]
    assert results[0].contact_force_n > 4.0
    assert limit_n * 0.8 < results[1].contact_force_n < limit_n
    assert results[1].peak_force_n < results[0].peak_force_n


def test_a_weak_finger_takes_half_of_what_two_would() -> None:
    """Solved with the finite elements: the mean of a grasp with both fingers weak and one with none."""
    strong = TrueGrasp(theta=THETA, design=3, object_id=14)
    weak = strong.model_copy(update={"law": "weak_finger", "parameters": {"thinner_mm": 0.3}})
    both = strong.model_copy(update={"law": "wall_thickness_offset", "parameters": {"offset_mm": -0.3}})
    at_mm = np.array([2.0, 10.0, 20.0])
    forces = [
        np.interp(at_mm, trace.lift_mm[trace.is_lift], trace.force_n[trace.is_lift])
        for trace in (solve_truth(grasp).trace for grasp in (strong, both, weak))
    ]
    assert (forces[1] < 0.95 * forces[0]).all()
    assert forces[2] == pytest.approx(0.5 * (forces[0] + forces[1]), rel=1e-6)


def test_soft_objects_give_way_and_their_surfaces_differ() -> None:
    """A foundation in series with the contact; a factor for each object, the same whatever grasps it."""
    soft = SoftObjects(0.1)
    assert soft.in_series(0.1) == pytest.approx(0.05)
    assert soft.in_series(4.8) == pytest.approx(0.1, rel=0.03)
    factors = np.array([ObjectSurfaces(0.1, number).friction_factor(NO_SLIP, PRESSURES) for number in range(36)])
    assert (np.mean(factors), np.std(factors)) == pytest.approx((1.0, 0.1), rel=0.3)
    assert factors[3] == ObjectSurfaces(0.1, 3).friction_factor(NO_SLIP + 5.0, PRESSURES)


@pytest.mark.parametrize("name", sorted(GRASP_LAWS))
def test_every_law_is_built_for_a_grasp(name: str) -> None:
    """With the parameters that the study uses."""
    from tests.studies.gap.truth import LAWS, draw_set

    rng = np.random.default_rng(0)
    parameters = draw_set(name, False, (0.6, 0.4), rng).parameters if name in LAWS else {"wider_mm": 2.0}
    law = hidden_law(name)
    built = law.build(parameters, TrueGrasp(theta=THETA, design=0, object_id=1, law=name, parameters=parameters))
    assert isinstance(built, law.kind)
    assert built.scales_with_modulus or name in UNSCALED
