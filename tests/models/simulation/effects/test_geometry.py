"""Geometry effects: what is printed instead of what was drawn."""

import numpy as np
import pytest

from fast.models.design.fin_ray import cavity_share, planar_profile, rib_centres
from fast.models.design.space import BEST_PUBLISHED, random_designs
from fast.models.objects.catalogue import get_object
from fast.models.records import Design, GraspSetup
from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.effects.geometry import RibImperfection, WallThicknessOffset
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.version import MeshSettings


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


def rib_bow_mm(design: Design, bow_mm: float) -> np.ndarray:
    """How far each rib's middle is from where it is drawn, across the rib."""
    centres = rib_centres(design)
    angle = np.radians(design.rib_angle_deg)
    moved = RibImperfection(bow_mm).modify_section(centres, design) - centres
    return np.asarray(moved @ [-np.sin(angle), np.cos(angle)])


def test_ribs_are_bowed_in_the_middle_each_to_its_own_side_and_repeatably() -> None:
    bow = rib_bow_mm(BEST_PUBLISHED, 0.3)
    assert np.allclose(np.abs(bow), 0.3, atol=1e-3)
    assert np.array_equal(bow, rib_bow_mm(BEST_PUBLISHED, 0.3))
    signs = {tuple(np.sign(rib_bow_mm(d, 0.3))) for d in random_designs(8, np.random.default_rng(0))}
    assert len(signs) > 4


@pytest.mark.parametrize("seed", range(4))
def test_bows_leave_walls_tip_and_base_in_place_and_elements_sound(seed: int) -> None:
    design = random_designs(1, np.random.default_rng(seed))[0]
    straight, bowed = (build_mesh(design, MeshSettings(), effects=[RibImperfection(bow)]) for bow in (0.0, 0.5))
    moved = np.linalg.norm(bowed.nodes - straight.nodes, axis=1)
    share = cavity_share(straight.nodes[:, [0, 2]], design)
    in_wall = (share == 0.0) | (share == 1.0) | (straight.nodes[:, 2] > design.height_mm - design.tip_length_mm)
    assert moved[in_wall].max() < 1e-12
    assert moved[straight.base_nodes].max() == 0.0
    assert moved.max() == pytest.approx(0.5, abs=0.1)
    volume_mm3 = planar_profile(design).area * 0.5 * design.width_mm
    body = ElasticBody(bowed, bowed.nodes, Material(11.5, 0.45))  # refuses inverted elements
    assert body.lumped_volume().sum() == pytest.approx(volume_mm3, rel=0.02)


def test_a_bow_softens_a_rib_under_compression() -> None:
    stroke = GraspSetup(max_lift_mm=1)
    forces = [
        simulate_grasp(BEST_PUBLISHED, get_object(2), setup=stroke, effects=[RibImperfection(bow)]).contact_force_n
        for bow in (0.0, 0.25, 0.5)
    ]
    assert forces[0] > forces[1] > forces[2] > 0.7 * forces[0]
