"""Second laws of effects in a grasp: each vanishes at amplitude zero and does its physics in limits."""

import numpy as np
import pytest
from shapely.geometry import Polygon

from fast.flows.challenge.hidden.panels import UNSCALED
from fast.flows.challenge.hidden.worlds import UNLISTED
from fast.models.design.fin_ray import FinRay, planar_profile, rib_centres
from fast.models.design.space import numbered_design
from fast.models.objects.catalogue import get_object
from fast.models.records import Theta
from tests.studies.gap.grasp_laws.other_laws import (
    CuredStiffening,
    FadingFriction,
    LeaningJaws,
    LinearSlipFriction,
    SaggingRibs,
    SpotAdhesion,
    SquashedLayers,
    StrandedRibs,
    TiltingMount,
    TumbledEdges,
    WarpedFingers,
)
from tests.studies.gap.grasp_laws.truth import (
    GRASP_LAWS,
    OTHER_GRASP_LAWS,
    TrueGrasp,
    hidden_law,
    solve_truth,
    tool_modulus_factor,
    truth_code,
)
from tests.studies.gap.truth import LAWS, OTHER_LAWS, Panel, draw_set

THETA = Theta(young_modulus_mpa=9.2, friction=0.62, poisson_ratio=0.43)
PRESSURES_MPA = np.array([0.0, 0.01, 0.05, 0.2])
NO_SLIP = np.zeros(4)
NO_PRESSURE = np.zeros(3)


def _design(**changes: float) -> FinRay:
    design = numbered_design(3)
    assert isinstance(design, FinRay)
    return design.model_copy(update=changes)


def test_friction_falls_straight_with_slip_and_then_stays() -> None:
    """Half of the change at the slip scale, all of it at twice that."""
    factor = LinearSlipFriction(0.8, 1.5).friction_factor(np.array([0.0, 1.5, 3.0, 30.0]), PRESSURES_MPA)
    assert factor == pytest.approx([1.0, 0.9, 0.8, 0.8])
    assert LinearSlipFriction(1.0, 1.5).friction_factor(np.array([0.0, 9.0]), NO_PRESSURE) == pytest.approx([1.0, 1.0])


def test_friction_fades_with_pressure_and_adhesion_fills_up() -> None:
    """Friction is that of theta at 50 kPa; a shear stress comes on top of Coulomb's, none without pressure."""
    factor = FadingFriction(0.3).friction_factor(NO_SLIP, PRESSURES_MPA)
    assert (np.diff(factor) < 0.0).all()
    assert factor[2] == pytest.approx(1.0)
    assert (FadingFriction(0.0).friction_factor(NO_SLIP, PRESSURES_MPA) == 1.0).all()
    more_mpa = 0.6 * PRESSURES_MPA * (SpotAdhesion(0.002, 0.6).friction_factor(NO_SLIP, PRESSURES_MPA) - 1.0)
    assert more_mpa == pytest.approx([0.0, 0.0004, 0.002 * 5 / 9, 0.002 * 5 / 6])
    assert (SpotAdhesion(0.0, 0.6).friction_factor(NO_SLIP, PRESSURES_MPA) == 1.0).all()


def test_a_tumbler_rounds_edges_by_the_size_and_moves_no_face() -> None:
    """Spheres have no edges, and none gets sharper than the contact resolves."""
    cube = get_object(30)
    tumbled = TumbledEdges(0.9).modify_object(cube)
    assert tumbled.parameters["rounding_mm"] == pytest.approx(1.0 + 0.9 * 40.0 / 30.0)
    assert {**tumbled.parameters, "rounding_mm": 1.0} == cube.parameters
    assert TumbledEdges(-3.0).modify_object(cube).parameters["rounding_mm"] == 0.5
    assert TumbledEdges(0.9).modify_object(get_object(1)) == get_object(1)
    assert TumbledEdges(0.0).modify_object(cube) == cube


def test_tall_fingers_lean_tilt_and_warp_more() -> None:
    """All three go with the height; a finger of 105 mm has the amplitude itself."""
    short, usual, tall = (_design(height_mm=height) for height in (90.0, 105.0, 120.0))
    mounts = [TiltingMount(0.05, design).base_compliance_mm_per_n() for design in (short, usual, tall)]
    stops = [WarpedFingers(7.0, design).finger_stop_mm() for design in (short, usual, tall)]
    jaws = [LeaningJaws(4.0, design).closing_force_limit_n() for design in (short, usual, tall)]
    assert mounts == pytest.approx([0.05 * (6 / 7) ** 2, 0.05, 0.05 * (8 / 7) ** 2])
    assert stops == pytest.approx([7.0 * (6 / 7) ** 2, 7.0, 7.0 * (8 / 7) ** 2])
    assert jaws == pytest.approx([4.0 * (1.0 - 0.15 * share) for share in (6 / 7, 1.0, 8 / 7)])
    assert TiltingMount(0.0, tall).base_compliance_mm_per_n() == 0.0


def test_squashed_layers_fill_the_lower_cavities_more_and_keep_the_outside() -> None:
    """A negative offset widens them."""
    design = _design(rib_count=4, rib_angle_deg=0.0)
    profile = planar_profile(design)
    squashed = SquashedLayers(0.3).modify_profile(profile, design)
    assert squashed.bounds == pytest.approx(profile.bounds)
    before, after = (
        sorted((Polygon(ring) for ring in one.interiors), key=lambda cavity: cavity.centroid.y)
        for one in (profile, squashed)
    )
    assert len(before) == len(after) >= 2
    inset_mm = [(old.area - new.area) / old.length for old, new in zip(before, after, strict=True)]
    assert 0.15 > inset_mm[0] > inset_mm[-1] > 0.07
    assert SquashedLayers(-0.3).modify_profile(profile, design).area < profile.area
    assert SquashedLayers(0.0).modify_profile(profile, design) is profile


def test_thin_walls_cure_more_and_thin_ribs_are_stiffer() -> None:
    """By the square of the thickness; walls and tip are as they were."""
    values = [CuredStiffening(10.0, _design(front_thickness_mm=t)).strain_stiffening() for t in (2.0, 2.5, 3.0)]
    assert values == pytest.approx([10.0 * 1.25**2, 10.0, 10.0 * (2.5 / 3.0) ** 2])
    design = _design(rib_thickness_mm=2.0)
    points = np.array([*rib_centres(design)[:1], [0.5, 40.0], [2.0, design.height_mm - 5.0]])
    assert StrandedRibs(0.2).stiffness_factor(points, design) == pytest.approx([1.0 + 0.2 * 1.25**2, 1.0, 1.0])
    assert (StrandedRibs(0.0).stiffness_factor(points, design) == 1.0).all()


def test_ribs_sag_towards_the_base_the_lowest_most() -> None:
    """By the square of their length; walls and tip stay where they are."""
    design = _design(rib_angle_deg=0.0, rib_count=4)
    centres = rib_centres(design)
    down_mm = centres[:, 1] - SaggingRibs(0.4).modify_section(centres, design)[:, 1]
    assert down_mm[0] == pytest.approx(0.4)
    lengths_mm = centres[:, 0] - design.front_thickness_mm
    assert down_mm == pytest.approx(0.4 * (lengths_mm / lengths_mm[0]) ** 2)
    walls = np.array([[0.0, 40.0], [design.front_thickness_mm, 40.0], [2.0, design.height_mm - 1.0]])
    assert SaggingRibs(0.4).modify_section(walls, design) == pytest.approx(walls)
    assert SaggingRibs(0.0).modify_section(centres, design) is centres


def test_every_effect_of_the_catalogue_has_a_second_law() -> None:
    """Of another class than the first."""
    assert set(OTHER_GRASP_LAWS) == set(LAWS) - set(UNLISTED)
    assert set(OTHER_LAWS) <= set(OTHER_GRASP_LAWS)
    for name, law in OTHER_GRASP_LAWS.items():
        assert law.kind is not GRASP_LAWS[name].kind
        parameters = draw_set(name, True, (0.6, 0.4), np.random.default_rng(0)).parameters
        grasp = TrueGrasp(theta=THETA, design=0, object_id=1, law=name, is_other=True, parameters=parameters)
        built = law.build(parameters, grasp)
        assert isinstance(built, law.kind)
        assert built.scales_with_modulus or name in UNSCALED
        assert truth_code(name, True) != truth_code(name)
        assert (tool_modulus_factor(grasp) == 1.0) == (name not in UNSCALED)


def test_a_panel_draws_one_of_two_laws() -> None:
    """Both occur; what no catalogue lists has one law. A grasp by the first law keeps its id."""
    drawn = [(one.law, one.is_other) for n in range(12) for one in Panel.draw(f"panel {n}").sets if one.law]
    assert {(name, is_other) for name in OTHER_GRASP_LAWS for is_other in (False, True)} <= set(drawn)
    assert {name for name, is_other in drawn if is_other} == set(OTHER_GRASP_LAWS)
    grasp = TrueGrasp(
        theta=THETA, design=0, object_id=1, law="shear_adhesion", parameters={"shear_strength_mpa": 0.001}
    )
    assert grasp.grasp_id == grasp.model_copy(update={"is_other": False}).grasp_id
    assert grasp.grasp_id != grasp.model_copy(update={"is_other": True}).grasp_id
    assert hidden_law("shear_adhesion", is_other=True).kind is SpotAdhesion


def test_both_laws_change_a_grasp_and_not_alike() -> None:
    """Solved with the finite elements: friction that falls with slip in two ways."""
    parameters = {"kinetic_ratio": 0.8, "slip_scale_mm": 2.0}
    plain = TrueGrasp(theta=THETA, design=3, object_id=14)
    slipping = plain.model_copy(update={"law": "static_kinetic_friction", "parameters": parameters})
    grasps = (plain, slipping, slipping.model_copy(update={"is_other": True}))
    at_mm = np.array([5.0, 15.0, 25.0])
    forces = [
        np.interp(at_mm, trace.lift_mm[trace.is_lift], trace.force_n[trace.is_lift])
        for trace in (solve_truth(grasp).trace for grasp in grasps)
    ]
    for changed in forces[1:]:
        assert (changed < 0.99 * forces[0]).all()
    assert np.abs(forces[2] / forces[1] - 1.0).max() > 0.005
