"""Structured meshes of a block in every element kind, and their equilibrium with prescribed boundary positions."""

from collections.abc import Callable
from itertools import permutations

import numpy as np

from fast.models.simulation.body.assembly import ElasticBody
from fast.models.simulation.body.shape_functions import (
    HEXAHEDRON_EDGES,
    TETRAHEDRON_EDGES,
    WEDGE_EDGES,
    ElementKind,
    face_shape,
)
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh
from tests.models.simulation.dead_load import solve_dead_load

KINDS: tuple[ElementKind, ...] = ("C3D4", "C3D10", "C3D15", "C3D20R")
QUADRATIC: tuple[ElementKind, ...] = KINDS[1:]

Selection = Callable[[np.ndarray], np.ndarray]
Edges = tuple[tuple[int, int], ...]

_EDGES: dict[ElementKind, Edges] = {
    "C3D4": (),
    "C3D10": TETRAHEDRON_EDGES,
    "C3D15": WEDGE_EDGES,
    "C3D20R": HEXAHEDRON_EDGES,
}
# Local nodes of the faces a rigid body can touch: corners, then middles of the sides.
_FACES: dict[ElementKind, list[list[int]]] = {
    "C3D4": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    "C3D10": [[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [2, 0, 3, 6, 7, 9]],
    "C3D15": [[0, 1, 4, 3, 6, 13, 9, 12], [1, 2, 5, 4, 7, 14, 10, 13], [2, 0, 3, 5, 8, 12, 11, 14]],
    "C3D20R": [
        [0, 1, 2, 3, 8, 9, 10, 11],
        [4, 5, 6, 7, 12, 13, 14, 15],
        [0, 1, 5, 4, 8, 17, 12, 16],
        [1, 2, 6, 5, 9, 18, 13, 17],
        [2, 3, 7, 6, 10, 19, 14, 18],
        [3, 0, 4, 7, 11, 16, 15, 19],
    ],
}
# Hexahedra and wedges (two per cell) have their axis along y, as in the extruded finger.
_HEXAHEDRON = ((0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0))
_WEDGES = (
    ((0, 0, 0), (1, 0, 1), (1, 0, 0), (0, 1, 0), (1, 1, 1), (1, 1, 0)),
    ((0, 0, 0), (0, 0, 1), (1, 0, 1), (0, 1, 0), (0, 1, 1), (1, 1, 1)),
)


def nothing(points: np.ndarray) -> np.ndarray:
    """Selects no point."""
    return np.zeros(len(points), dtype=bool)


def everything(points: np.ndarray) -> np.ndarray:
    """Selects every point."""
    return np.ones(len(points), dtype=bool)


def brick(
    kind: ElementKind,
    grid: tuple[np.ndarray, np.ndarray, np.ndarray],
    *,
    place: Callable[[np.ndarray], np.ndarray] | None = None,
    base: Selection = nothing,
    symmetry: Selection = nothing,
    contact: Selection = nothing,
) -> SolidMesh:
    """Mesh the cells between the grid lines along x, y and z; straight edges with their nodes in the middle.

    `place` moves the corners (n, 3) first. The selections take points (n, 3) of the mesh: `base` nodes are clamped,
    `symmetry` nodes do not move in y, faces with all their nodes in `contact` can touch.
    """
    x, y, z = np.meshgrid(*grid, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    corners = _connect(kind, tuple(len(lines) for lines in grid))
    nodes, elements = _add_middles(points if place is None else place(points), corners, _EDGES[kind])
    faces = elements[:, np.array(_FACES[kind])].reshape(-1, len(_FACES[kind][0]))
    touching = contact(nodes)[faces].all(axis=1)
    return SolidMesh(
        nodes=nodes,
        blocks=(ElementBlock(kind, elements),),
        base_nodes=np.flatnonzero(base(nodes)).astype(np.int32),
        symmetry_nodes=np.flatnonzero(symmetry(nodes)).astype(np.int32),
        contact_faces=faces[touching],
    )


def cube_grid(n: int, length: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grid lines of a cube with n cells each way."""
    lines = np.linspace(0.0, length, n + 1)
    return lines, lines, lines


def equilibrium(body: ElasticBody, start: np.ndarray, load: np.ndarray | None = None) -> np.ndarray:
    """Positions (n, 3) in equilibrium with dead loads (n, 3); clamped nodes stay where `start` (n, 3) puts them."""
    load = np.zeros_like(start) if load is None else load
    return start + solve_dead_load(body, start, load)


def _connect(kind: ElementKind, shape: tuple[int, ...]) -> np.ndarray:
    """Corner nodes (m, c) of the elements of a grid with `shape` points."""
    cells = np.array([tuple(element) for element in _pattern(kind)])
    origin = np.stack(np.meshgrid(*[np.arange(n - 1) for n in shape], indexing="ij"), axis=-1).reshape(-1, 1, 1, 3)
    index = (origin + cells[None]).reshape(-1, cells.shape[1], 3)
    return np.ravel_multi_index(tuple(index.transpose(2, 0, 1)), shape)


def _pattern(kind: ElementKind) -> list[tuple[tuple[int, ...], ...]]:
    """Corners of the elements of one cell."""
    if kind == "C3D20R":
        return [_HEXAHEDRON]
    if kind == "C3D15":
        return list(_WEDGES)
    return [_kuhn_tetrahedron(axes) for axes in permutations(range(3))]


def _kuhn_tetrahedron(axes: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """The tetrahedron met by walking from corner 000 to 111 along the axes in this order (Kuhn 1960)."""
    path = np.vstack([np.zeros(3, int), np.cumsum(np.eye(3, dtype=int)[list(axes)], axis=0)])
    is_positive = np.linalg.det(path[1:]) > 0.0
    order = [0, 1, 2, 3] if is_positive else [0, 2, 1, 3]
    return tuple(tuple(int(i) for i in path[k]) for k in order)


def _add_middles(points: np.ndarray, corners: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and elements with one more node in the middle of each edge."""
    if not edges:
        return points, corners.astype(np.int32)
    pairs = np.sort(corners[:, np.array(edges)].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(pairs, axis=0, return_inverse=True)
    nodes = np.vstack([points, points[unique].mean(axis=1)])
    middles = len(points) + inverse.reshape(len(corners), len(edges))
    return nodes, np.hstack([corners, middles]).astype(np.int32)


def face_load(mesh: SolidMesh, traction: np.ndarray) -> np.ndarray:
    """Nodal forces (n, 3) of a uniform traction (3) in MPa on the contact faces."""
    load = np.zeros_like(mesh.nodes)
    line, weight = np.polynomial.legendre.leggauss(3)
    u, v = (grid.ravel() for grid in np.meshgrid(line, line, indexing="ij"))
    weights, points = np.outer(weight, weight).ravel(), np.column_stack([u, v])
    if mesh.contact_faces.shape[1] != 8:  # collapse the square onto the triangle
        a, b = 0.5 * (1.0 + u), 0.5 * (1.0 + v)
        weights, points = 0.25 * weights * (1.0 - a), np.column_stack([a, (1.0 - a) * b])
    values, gradients = face_shape(mesh.contact_faces.shape[1], points)
    tangents = np.einsum("qkc,fki->fqci", gradients, mesh.nodes[mesh.contact_faces])
    areas = np.linalg.norm(np.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=2) * weights
    np.add.at(load, mesh.contact_faces, np.einsum("fq,qk,i->fki", areas, values, traction))
    return load
