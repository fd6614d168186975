"""Both meshers over the design space: volume, sets, quality, determinism, failures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import box

from fast.models.design.fin_ray import planar_profile
from fast.models.design.space import BEST_PUBLISHED, PARAMETERS, from_unit, random_designs
from fast.models.errors import MeshingFailed
from fast.models.records import Design
from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.mesh.partition import partition
from fast.models.simulation.mesh.planar import PlanarMesh
from fast.models.simulation.mesh.section import planar_mesh
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.mesh.tetwild import tetrahedralise, tetwild_mesh
from fast.models.simulation.version import MeshSettings

DESIGNS = st.lists(st.floats(0, 1), min_size=len(PARAMETERS), max_size=len(PARAMETERS)).map(
    lambda point: from_unit(np.array([point]))[0]
)


def volume_mm3(mesh: SolidMesh) -> float:
    return float(ElasticBody(mesh, mesh.nodes, Material(11.5, 0.45)).lumped_volume().sum())


def corner_sines(mesh: PlanarMesh) -> np.ndarray:
    """Sine of every corner angle of every element, negative for reflex corners."""
    sines = []
    for corners in (mesh.points[mesh.triangles[:, :3]], mesh.points[mesh.quadrilaterals[:, :4]]):
        forward, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
        cross = forward[..., 0] * back[..., 1] - forward[..., 1] * back[..., 0]
        sines.append((cross / np.linalg.norm(forward, axis=2) / np.linalg.norm(back, axis=2)).ravel())
    return np.concatenate(sines)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(DESIGNS)
def test_every_design_is_meshed_with_its_exact_volume(design: Design) -> None:
    mesh = build_mesh(design, MeshSettings())
    expected = planar_profile(design, MeshSettings().fillet_mm, 1).area * design.width_mm / 2
    assert volume_mm3(mesh) == pytest.approx(expected, rel=1e-6)
    assert set(np.concatenate([block.connectivity.ravel() for block in mesh.blocks])) == set(range(len(mesh.nodes)))
    assert (mesh.nodes[mesh.base_nodes, 2] == 3.0).all()
    assert mesh.is_half


def test_random_designs_give_well_shaped_quadrilaterals_with_few_triangles() -> None:
    n_triangles = n_quads = 0
    for design in random_designs(60, np.random.default_rng(5)):
        section = planar_mesh(planar_profile(design, 0.5, 1), 8.0)
        sines = corner_sines(section)
        assert sines.min() > np.sin(np.radians(3.0)), design
        assert np.quantile(sines, 0.05) > np.sin(np.radians(15.0)), design
        n_triangles, n_quads = n_triangles + len(section.triangles), n_quads + len(section.quadrilaterals)
    assert n_triangles < 0.15 * (n_triangles + n_quads)


def test_sides_of_the_front_wall_are_no_longer_than_asked() -> None:
    section = planar_mesh(planar_profile(BEST_PUBLISHED, 0.5, 1), 4.0)
    front = np.sort(section.points[section.edges[(section.points[section.edges, 0] == 0.0).all(axis=1)], 1])
    assert np.ptp(front, axis=1).max() <= 4.0 + 1e-9


@pytest.mark.parametrize("fillet_mm", [0.0, 0.2, 1.0, 1.5])
def test_any_fillet_can_be_meshed(fillet_mm: float) -> None:
    for design in random_designs(10, np.random.default_rng(6)):
        profile = planar_profile(design, fillet_mm, 2)
        assert planar_mesh(profile, 8.0).points.min() >= -1e-9


def test_a_cell_is_divided_into_the_best_pieces() -> None:
    # An L: two squares and a rectangle need a diagonal cut; the best is two quadrilaterals through the inner corner.
    corners = np.array([[0.0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
    parts = partition(corners)
    assert parts is not None
    triangles, quads = parts
    assert not len(triangles)
    assert {frozenset(quad) for quad in quads.tolist()} == {frozenset({0, 1, 2, 3}), frozenset({0, 3, 4, 5})}
    assert partition(np.array([[0.0, 0], [1, 0], [2, 0]])) is None


def test_a_chamfer_takes_as_much_as_a_round_fillet() -> None:
    fine = planar_profile(BEST_PUBLISHED, 1.0, 16).area
    sharp = planar_profile(BEST_PUBLISHED, 0.0).area
    chamfered = planar_profile(BEST_PUBLISHED, 1.0, 1).area
    assert chamfered - sharp == pytest.approx(fine - sharp, rel=0.02)


def test_full_width_is_twice_the_half() -> None:
    half = build_mesh(BEST_PUBLISHED, MeshSettings())
    full = build_mesh(BEST_PUBLISHED, MeshSettings(), full_width=True)
    assert volume_mm3(full) == pytest.approx(2 * volume_mm3(half))
    assert not full.is_half
    assert np.ptp(full.nodes[:, 1]) == pytest.approx(BEST_PUBLISHED.width_mm)


@pytest.mark.parametrize(("refine", "layers", "factor"), [(1, 1, 4), (0, 2, 2), (2, 1, 16)])
def test_refinement_and_layers_multiply_the_elements(refine: int, layers: int, factor: int) -> None:
    # Without fillets, which refinement draws with more sides.
    coarse = build_mesh(BEST_PUBLISHED, MeshSettings(fillet_mm=0))
    fine = build_mesh(BEST_PUBLISHED, MeshSettings(fillet_mm=0, refine=refine, layers=layers))
    assert fine.n_elements == factor * coarse.n_elements
    assert volume_mm3(fine) == pytest.approx(volume_mm3(coarse))


def test_contact_faces_lie_on_the_front_and_the_tip() -> None:
    mesh = build_mesh(BEST_PUBLISHED, MeshSettings())
    corners = mesh.nodes[mesh.contact_faces[:, :4]]
    on_front = (corners[:, :, 0] == 0.0).all(axis=1)
    on_tip = (corners[:, :, 2] == BEST_PUBLISHED.height_mm).all(axis=1)
    assert (on_front | on_tip).all()
    assert on_front.any()
    assert on_tip.any()


def test_meshing_is_deterministic_and_round_trips() -> None:
    first, second = (build_mesh(BEST_PUBLISHED, MeshSettings()) for _ in range(2))
    assert first.mesh_id == second.mesh_id
    assert SolidMesh.from_arrays(first.to_arrays()).mesh_id == first.mesh_id
    assert build_mesh(BEST_PUBLISHED, MeshSettings(edge_mm=5)).mesh_id != first.mesh_id


@pytest.mark.slow
def test_tetrahedra_fill_the_same_body() -> None:
    mesh = tetwild_mesh(box(0.0, 3.0, 8.0, 30.0), 20.0, 6.0, time_limit_s=100.0)
    assert [block.kind for block in mesh.blocks] == ["C3D10"]
    assert volume_mm3(mesh) == pytest.approx(8.0 * 27.0 * 10.0, rel=1e-3)
    assert len(mesh.base_nodes) > 0
    assert len(mesh.symmetry_nodes) > 0
    assert (mesh.nodes[mesh.contact_faces].transpose(2, 0, 1)[0].max(axis=1) <= 8.0).all()


@pytest.mark.slow
def test_tetrahedra_end_at_their_time_limit_and_on_bad_surfaces() -> None:
    with pytest.raises(MeshingFailed, match="no mesh within 0.01 s") as late:
        tetwild_mesh(planar_profile(BEST_PUBLISHED, 0.0), 30.0, 4.0, time_limit_s=0.01)
    assert late.value.reason == "time_out"
    with pytest.raises(MeshingFailed, match="use the extruded mesher") as bad:
        tetrahedralise(np.zeros((3, 3)), np.array([[0, 1, 2]]), 5.0, 60.0)
    assert bad.value.reason in {"crash", "empty"}
