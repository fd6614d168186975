"""Shape functions and quadrature of the solid elements, in the node order of Abaqus and CalculiX."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

ElementKind = Literal["C3D4", "C3D10", "C3D15", "C3D20R"]

N_NODES: dict[ElementKind, int] = {"C3D4": 4, "C3D10": 10, "C3D15": 15, "C3D20R": 20}

# Corner pairs of the mid-side nodes, in node order.
TETRAHEDRON_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
WEDGE_EDGES = ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))
HEXAHEDRON_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0)),
    *((4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
_HEXAHEDRON_CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float
)

_GAUSS = {
    1: (np.array([0.0]), np.array([2.0])),
    2: (np.array([-1.0, 1.0]) / np.sqrt(3.0), np.array([1.0, 1.0])),
    3: (np.array([-1.0, 0.0, 1.0]) * np.sqrt(0.6), np.array([5.0, 8.0, 5.0]) / 9.0),
}


@dataclass(frozen=True)
class Quadrature:
    """Points (q, 3) and weights (q) on a reference element."""

    points: np.ndarray
    weights: np.ndarray


def wedge_quadrature(n_axial: int) -> Quadrature:
    """Return three triangle points times `n_axial` (1-3) Gauss points along the axis; 3 x 3 is CalculiX's C3D15."""
    triangle = np.array([[1 / 6, 1 / 6], [2 / 3, 1 / 6], [1 / 6, 2 / 3]])
    axial, weight = _GAUSS[n_axial]
    points = [[*point, t] for t in axial for point in triangle]
    return Quadrature(np.array(points), np.repeat(weight, 3) / 6.0)


def centroid_quadrature() -> Quadrature:
    """Return the one point of C3D4, where its strain is constant."""
    return Quadrature(np.full((1, 3), 0.25), np.full(1, 1.0 / 6.0))


def tetrahedron_quadrature() -> Quadrature:
    """Return the four-point rule of C3D10 (degree 2)."""
    near, far = (5.0 + 3.0 * np.sqrt(5.0)) / 20.0, (5.0 - np.sqrt(5.0)) / 20.0
    points = np.full((4, 3), far)
    points[np.arange(1, 4), np.arange(3)] = near
    return Quadrature(points, np.full(4, 1.0 / 24.0))


def hexahedron_quadrature(n_axial: int) -> Quadrature:
    """Return 2 x 2 Gauss points across the axis times `n_axial` (1-3) along it; 2 x 2 x 2 is CalculiX's C3D20R."""
    across = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(3.0)
    axial, weight = _GAUSS[n_axial]
    points = [[*point, t] for t in axial for point in across]
    return Quadrature(np.array(points), np.repeat(weight, 4))


def quadrature_of(kind: ElementKind, n_axial: int = 3) -> Quadrature:
    """Return the quadrature of an element kind; `n_axial` only matters for wedges and hexahedra.

    The axis of swept elements is the width of the finger. There a single layer takes the indentation by an object
    that touches in the middle: with 2 points it is up to 10 % too soft. Across the walls hexahedra keep 2 x 2
    points, which is what frees them of shear and volumetric locking in bending.
    """
    if kind == "C3D15":
        return wedge_quadrature(n_axial)
    if kind == "C3D20R":
        return hexahedron_quadrature(n_axial)
    return tetrahedron_quadrature() if kind == "C3D10" else centroid_quadrature()


def shape_of(kind: ElementKind, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values (q, k) and reference gradients (q, k, 3) of the shape functions at points (q, 3)."""
    return _SHAPES[kind](points)


def face_shape(n_nodes: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values (q, k) and gradients (q, k, 2) on a face: 8-node quadrilateral, 6-node or 3-node triangle."""
    return _FACES[n_nodes](points)


def _barycentric(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    dim = points.shape[1]
    values = np.column_stack([1.0 - points.sum(axis=1), points])
    return values, np.vstack([-np.ones((1, dim)), np.eye(dim)])


def _simplex(points: np.ndarray, edges: tuple[tuple[int, int], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the quadratic Lagrange functions of a simplex: L (2 L - 1) at corners, 4 L_i L_j at mid-sides."""
    bary, slope = _barycentric(points)
    corner = bary * (2.0 * bary - 1.0)
    corner_slope = (4.0 * bary - 1.0)[:, :, None] * slope[None]
    first, second = np.array(edges).T
    middle = 4.0 * bary[:, first] * bary[:, second]
    middle_slope = 4.0 * (bary[:, first, None] * slope[None, second] + bary[:, second, None] * slope[None, first])
    return np.hstack([corner, middle]), np.concatenate([corner_slope, middle_slope], axis=1)


def _linear(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the linear functions of a triangle or tetrahedron."""
    values, slope = _barycentric(points)
    return values, np.tile(slope, (len(points), 1, 1))


def _tetrahedron(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return _simplex(points, TETRAHEDRON_EDGES)


def _triangle(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return _simplex(points, TETRAHEDRON_EDGES[:3])


def _wedge(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate a serendipity wedge: (xi, eta) barycentric over the triangle, t in [-1, 1] along the axis."""
    bary, slope = _barycentric(points[:, :2])
    t = points[:, 2:]
    values, gradients = np.zeros((len(points), 15)), np.zeros((len(points), 15, 3))
    for offset, sign in ((0, -1.0), (3, 1.0)):
        a = 1.0 + sign * t
        corner = slice(offset, offset + 3)
        values[:, corner] = 0.5 * bary * a * (2.0 * bary - 2.0 + sign * t)
        gradients[:, corner, :2] = (0.5 * a * (4.0 * bary - 2.0 + sign * t))[:, :, None] * slope[None]
        gradients[:, corner, 2] = 0.5 * bary * sign * (2.0 * bary - 1.0 + 2.0 * sign * t)
        i, j = np.array([0, 1, 2]), np.array([1, 2, 0])
        middle = slice(6 + offset, 9 + offset)
        values[:, middle] = 2.0 * bary[:, i] * bary[:, j] * a
        gradients[:, middle, :2] = (
            2.0 * a[:, :, None] * (bary[:, i, None] * slope[None, j] + bary[:, j, None] * slope[None, i])
        )
        gradients[:, middle, 2] = 2.0 * bary[:, i] * bary[:, j] * sign
    values[:, 12:] = bary * (1.0 - t**2)
    gradients[:, 12:, :2] = (1.0 - t**2)[:, :, None] * slope[None]
    gradients[:, 12:, 2] = -2.0 * bary * t
    return values, gradients


def _quadrilateral(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate an eight-node serendipity quadrilateral on [-1, 1]^2: corners counter-clockwise, then mid-sides."""
    r, s = points[:, 0], points[:, 1]
    values, gradients = np.zeros((len(points), 8)), np.zeros((len(points), 8, 2))
    for i, (a, b) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1))):
        values[:, i] = 0.25 * (1 + a * r) * (1 + b * s) * (a * r + b * s - 1)
        gradients[:, i, 0] = 0.25 * a * (1 + b * s) * (2 * a * r + b * s)
        gradients[:, i, 1] = 0.25 * b * (1 + a * r) * (a * r + 2 * b * s)
    for i, b in ((4, -1), (6, 1)):
        values[:, i] = 0.5 * (1 - r**2) * (1 + b * s)
        gradients[:, i] = np.column_stack([-r * (1 + b * s), 0.5 * b * (1 - r**2)])
    for i, a in ((5, 1), (7, -1)):
        values[:, i] = 0.5 * (1 - s**2) * (1 + a * r)
        gradients[:, i] = np.column_stack([0.5 * a * (1 - s**2), -s * (1 + a * r)])
    return values, gradients


def _hexahedron(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate a 20-node serendipity hexahedron on [-1, 1]^3: corners of the lower and upper face, then mid-sides."""
    corners = _HEXAHEDRON_CORNERS
    middles = corners[np.array(HEXAHEDRON_EDGES)].mean(axis=1)
    p = points[:, None, :]
    factor = 1.0 + p * corners
    reach = (p * corners).sum(axis=2) - 2.0
    product = 0.125 * factor.prod(axis=2)
    corner_slope = corners * _others_product(factor) * 0.125 * reach[:, :, None] + corners * product[:, :, None]
    across = middles == 0.0
    factor = np.where(across, 1.0 - p**2, 1.0 + p * middles)
    slope = np.where(across, -2.0 * p, middles)
    values = np.hstack([product * reach, 0.25 * factor.prod(axis=2)])
    return values, np.concatenate([corner_slope, 0.25 * slope * _others_product(factor)], axis=1)


def _others_product(factor: np.ndarray) -> np.ndarray:
    """Multiply for factors (..., 3) the two others at each place."""
    return np.roll(factor, 1, axis=-1) * np.roll(factor, 2, axis=-1)


_FACES: dict[int, Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]] = {
    3: _linear,
    6: _triangle,
    8: _quadrilateral,
}
_SHAPES: dict[ElementKind, Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]] = {
    "C3D4": _linear,
    "C3D10": _tetrahedron,
    "C3D15": _wedge,
    "C3D20R": _hexahedron,
}
