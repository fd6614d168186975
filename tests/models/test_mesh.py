"""Both meshers over the design space: volume, sets, quality, determinism, failures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import box

from models.design_space import BEST_PUBLISHED, PARAMETERS, from_unit
from models.errors import MeshingFailed
from models.fem.assembly import ElasticBody, Material
from models.geometry.profile import planar_profile
from models.mesh.build import build_mesh, resolved_fillet_mm
from models.mesh.solid import SolidMesh
from models.mesh.tetwild import tetrahedralise, tetwild_mesh
from models.mesh.wedge import wedge_mesh
from models.records import Design, MeshSettings

DESIGNS = st.lists(st.floats(0, 1), min_size=len(PARAMETERS), max_size=len(PARAMETERS)).map(
    lambda point: from_unit(np.array([point]))[0]
)


def volume_mm3(mesh: SolidMesh) -> float:
    return float(ElasticBody(mesh, mesh.nodes, Material(11.5, 0.45)).lumped_volume().sum())


@settings(max_examples=25, deadline=None, derandomize=True)
@given(DESIGNS)
def test_every_design_is_meshed_with_its_exact_volume(design: Design) -> None:
    mesh = build_mesh(design, MeshSettings())
    expected = planar_profile(design, 0.0).area * design.width_mm / 2
    assert volume_mm3(mesh) == pytest.approx(expected, rel=1e-6)
    assert set(np.concatenate([block.connectivity.ravel() for block in mesh.blocks])) == set(range(len(mesh.nodes)))
    assert (mesh.nodes[mesh.base_nodes, 2] == 3.0).all()
    assert mesh.is_half


def test_full_width_is_twice_the_half() -> None:
    half = build_mesh(BEST_PUBLISHED, MeshSettings())
    full = build_mesh(BEST_PUBLISHED, MeshSettings(), full_width=True)
    assert volume_mm3(full) == pytest.approx(2 * volume_mm3(half))
    assert not full.is_half
    assert np.ptp(full.nodes[:, 1]) == pytest.approx(BEST_PUBLISHED.width_mm)


@pytest.mark.parametrize(("refine", "layers", "factor"), [(1, 1, 4), (0, 2, 2), (2, 1, 16)])
def test_refinement_and_layers_multiply_the_elements(refine: int, layers: int, factor: int) -> None:
    profile = planar_profile(BEST_PUBLISHED, 0.0)
    coarse = wedge_mesh(profile, 30.0, 6.0)
    fine = wedge_mesh(profile, 30.0, 6.0, refine=refine, n_layers=layers)
    assert fine.n_elements == factor * coarse.n_elements
    assert volume_mm3(fine) == pytest.approx(volume_mm3(coarse))


def test_contact_faces_lie_on_the_front_and_the_tip() -> None:
    mesh = wedge_mesh(planar_profile(BEST_PUBLISHED, 0.0), 30.0, 6.0)
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


def test_fillets_are_meshed_only_when_the_mesh_can_show_them() -> None:
    assert resolved_fillet_mm(MeshSettings(edge_mm=6, fillet_mm=0.5)) == 0.0
    assert resolved_fillet_mm(MeshSettings(edge_mm=6, refine=2, fillet_mm=0.5)) == 0.5


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
    with pytest.raises(MeshingFailed, match="use the wedge mesher") as bad:
        tetrahedralise(np.zeros((3, 3)), np.array([[0, 1, 2]]), 5.0, 60.0)
    assert bad.value.reason in {"crash", "empty"}
