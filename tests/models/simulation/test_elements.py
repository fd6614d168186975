"""Shape functions and material laws against closed forms and differences."""

import numpy as np
import pytest

from fast.models.errors import MeshingFailed
from fast.models.simulation.body.assembly import ElasticBody, Material
from fast.models.simulation.body.elasticity import (
    LAW_CODE,
    VECTOR,
    Constants,
    Elements,
    add_forces,
    add_tangents,
    lame_constants,
)
from fast.models.simulation.body.shape_functions import ElementKind, face_shape, quadrature_of, shape_of
from fast.models.simulation.mesh.build import extrude
from fast.models.simulation.mesh.planar import add_middles
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh

CORNERS = {
    "C3D10": np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "C3D15": np.array([[0.0, 0, -1], [1, 0, -1], [0, 1, -1], [0, 0, 1], [1, 0, 1], [0, 1, 1]]),
    "C3D20R": np.array(
        [[-1.0, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]
    ),
}
EDGES = {
    "C3D10": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    "C3D15": [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    "C3D20R": [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)],
}
VOLUME = {"C3D10": 1 / 6, "C3D15": 1.0, "C3D20R": 8.0}
KINDS: tuple[ElementKind, ...] = ("C3D10", "C3D15", "C3D20R")


def reference_nodes(kind: ElementKind) -> np.ndarray:
    corners = CORNERS[kind]
    return np.vstack([corners] + [corners[list(edge)].mean(axis=0) for edge in EDGES[kind]])


@pytest.mark.parametrize("kind", KINDS)
def test_shape_functions_interpolate_their_nodes(kind: ElementKind) -> None:
    nodes = reference_nodes(kind)
    values, _ = shape_of(kind, nodes)
    assert np.allclose(values, np.eye(len(nodes)), atol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
def test_shape_gradients_agree_with_differences(kind: ElementKind) -> None:
    points = np.array([[0.2, 0.3, 0.1], [0.1, 0.15, -0.4]])
    _, gradients = shape_of(kind, points)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-6
        difference = (shape_of(kind, points + step)[0] - shape_of(kind, points - step)[0]) / 2e-6
        assert np.allclose(gradients[:, :, axis], difference, atol=1e-8)


@pytest.mark.parametrize("n_nodes", [6, 8])
def test_face_functions_sum_to_one_and_differentiate(n_nodes: int) -> None:
    points = np.array([[0.3, 0.2], [0.1, 0.6]])
    values, gradients = face_shape(n_nodes, points)
    assert np.allclose(values.sum(axis=1), 1.0)
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = 1e-6
        difference = (face_shape(n_nodes, points + step)[0] - face_shape(n_nodes, points - step)[0]) / 2e-6
        assert np.allclose(gradients[:, :, axis], difference, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_quadrature_integrates_quadratics(kind: ElementKind) -> None:
    rule = quadrature_of(kind)
    exact = {"C3D10": 1 / 60, "C3D15": 1 / 6, "C3D20R": 8 / 3}[kind]  # integral of x^2
    assert rule.weights.sum() == pytest.approx(VOLUME[kind])
    assert (rule.weights * rule.points[:, 0] ** 2).sum() == pytest.approx(exact)


def one_element(kind: ElementKind) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rule = quadrature_of(kind, 3)
    nodes = reference_nodes(kind)
    _, gradients = shape_of(kind, rule.points)
    return nodes, gradients, rule.weights


def of_itself(slopes: np.ndarray, weights: np.ndarray, places: np.ndarray) -> Elements:
    """One element whose reference element is itself, so that dN/dxi are its slopes (q, k, 3)."""
    n_points, k = slopes.shape[:2]
    gradients = np.zeros((n_points, 3, -(-k // VECTOR) * VECTOR))
    gradients[:, :, :k] = slopes.transpose(0, 2, 1)
    inverses = np.tile(np.eye(3).reshape(1, 9, 1), (n_points, 1, 1))
    volumes = weights[:, None]
    elements = np.arange(k, dtype=np.int32)[None]
    return Elements(elements, gradients, inverses, volumes, volumes, np.zeros((n_points, k)), places[None])


def add_one(
    x: np.ndarray, slopes: np.ndarray, weights: np.ndarray, law: int, lam: float, mu: float, c: float, force: np.ndarray
) -> bool:
    """Add the forces of one element whose reference element is itself."""
    part = of_itself(slopes, weights, np.zeros((len(x), len(x)), dtype=np.int32))
    return bool(add_forces(x, part, Constants(law, lam, mu, c), force))


def tangent_of(
    x: np.ndarray, slopes: np.ndarray, weights: np.ndarray, law: int, lam: float, mu: float, c: float
) -> np.ndarray:
    """Tangent (3 k, 3 k) of one element whose reference element is itself."""
    k = len(x)
    places = np.tri(k, dtype=np.int32).cumsum().reshape(k, k).astype(np.int32) - 1
    blocks = np.zeros((k * (k + 1) // 2, 3, 3))
    assert add_tangents(x, of_itself(slopes, weights, places), Constants(law, lam, mu, c), blocks)
    full = np.zeros((k, 3, k, 3))
    for a, b in np.argwhere(np.tri(k)):
        full[a, :, b] = blocks[places[a, b]]
        full[b, :, a] = blocks[places[a, b]].T
    return full.reshape(3 * k, 3 * k)


def force_of(kind: ElementKind, law: int, x: np.ndarray) -> np.ndarray:
    _, slopes, weights = one_element(kind)
    force = np.zeros(x.shape)
    assert add_one(x, slopes, weights, law, *lame_constants(11.5, 0.45), 0.0, force)
    return force


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", sorted(LAW_CODE.values()))
def test_tangent_is_the_derivative_of_the_force(kind: ElementKind, law: int) -> None:
    rng = np.random.default_rng(3)
    x = one_element(kind)[0] @ np.array([[0.9, 0.2, 0], [-0.2, 1.1, 0.1], [0, 0, 1.0]])
    x += 0.02 * rng.standard_normal(x.shape)
    _, slopes, weights = one_element(kind)
    tangent = tangent_of(x, slopes, weights, law, *lame_constants(11.5, 0.45), 0.0)
    direction = rng.standard_normal(x.shape)
    difference = (force_of(kind, law, x + 1e-6 * direction) - force_of(kind, law, x - 1e-6 * direction)) / 2e-6
    assert np.allclose(tangent @ direction.ravel(), difference.ravel(), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("law", sorted(LAW_CODE.values()))
def test_rotation_makes_no_force_and_inversion_is_found(law: int) -> None:
    nodes, slopes, weights = one_element("C3D15")
    lam, mu = lame_constants(11.5, 0.45)
    angle = 1.2
    rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    force = np.zeros((15, 3))
    assert add_one(nodes @ rotation.T + 5.0, slopes, weights, law, lam, mu, 0.0, force)
    assert np.abs(force).max() < 1e-12
    assert not add_one(nodes * [-1.0, 1, 1], slopes, weights, law, lam, mu, 0.0, force)


def test_uniaxial_strain_energy_of_neo_hookean() -> None:
    nodes, slopes, weights = one_element("C3D15")
    lam, mu = lame_constants(10.0, 0.3)
    stretch, force = 1.2, np.zeros((15, 3))
    add_one(nodes * [1, 1, stretch], slopes, weights, 0, lam, mu, 0.0, force)
    log = np.log(stretch)
    stress = mu * stretch + (lam * log - mu) / stretch  # P_zz of W under F = diag(1, 1, stretch)
    assert force[nodes[:, 2] > 0.5, 2].sum() == pytest.approx(0.5 * stress)  # on a triangle of area 1/2


def test_kinds_share_their_nodes_in_one_body() -> None:
    # A quadrilateral and a triangle on it: both blocks must see the same face between them.
    vertices = np.array([[0.0, 0], [2, 0], [2, 1], [0, 1], [1, 2]])
    planar = add_middles(vertices, np.array([[3, 2, 4]]), np.array([[0, 1, 2, 3]]))
    mesh = extrude(planar, np.array([0.0, 1.5]), symmetric=True)
    assert [block.kind for block in mesh.blocks] == ["C3D15", "C3D20R"]
    body = ElasticBody(mesh, mesh.nodes, Material(11.5, 0.45))
    assert body.lumped_volume().sum() == pytest.approx(3.0 * 1.5)
    stretched = mesh.nodes * [1.1, 0.95, 1.05]
    force = body.force(stretched)
    assert force is not None
    inside = [i for i, (x, y, z) in enumerate(mesh.nodes) if z == 1.0 and 0 < x < 2 and 0 < y < 1.5]
    assert np.abs(force[inside]).max(initial=0.0) < 1e-12
    assert force.sum(axis=0) == pytest.approx(0.0, abs=1e-12)


def test_body_volume_and_inverted_mesh() -> None:
    nodes = reference_nodes("C3D15")
    empty = np.zeros(0, np.int32)
    blocks = (ElementBlock("C3D15", np.arange(15)[None]),)
    mesh = SolidMesh(nodes, blocks, np.array([0, 1, 2, 6, 7, 8]), empty, np.zeros((0, 8), np.int32))
    body = ElasticBody(mesh, nodes, Material(11.5, 0.45))
    assert body.lumped_volume().sum() == pytest.approx(1.0)
    assert body.n_dof == 27
    with pytest.raises(MeshingFailed, match="1 of 1 elements are inverted"):
        ElasticBody(mesh, nodes * [-1.0, 1, 1], Material(11.5, 0.45))
