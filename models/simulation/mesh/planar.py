"""Quadratic planar meshes of triangles and quadrilaterals: the section that is swept over the width."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PlanarMesh:
    """Elements in the (x, z) plane, counter-clockwise: vertices first, then edge middles, which lie on the chord.

    `points` (p, 2) mm, of which the first `n_vertices` are corners; `triangles` (t, 6): corners, then middles of
    the sides 01, 12, 20; `quadrilaterals` (q, 8): corners, then middles of 01, 12, 23, 30; `edges` (e, 3): two
    corners and the middle.
    """

    points: np.ndarray
    triangles: np.ndarray
    quadrilaterals: np.ndarray
    n_vertices: int
    edges: np.ndarray


def add_middles(vertices: np.ndarray, triangles: np.ndarray, quadrilaterals: np.ndarray) -> PlanarMesh:
    """Make quadratic elements from corners (v, 2), (t, 3) and (q, 4): one more point in the middle of every edge."""
    sides = [_sides(triangles), _sides(quadrilaterals)]
    edges, inverse = np.unique(np.vstack(sides), axis=0, return_inverse=True)
    middles = len(vertices) + inverse.ravel()
    points = np.vstack([vertices, 0.5 * (vertices[edges[:, 0]] + vertices[edges[:, 1]])])
    return PlanarMesh(
        points=points,
        triangles=np.hstack([triangles, middles[: len(sides[0])].reshape(-1, 3)]),
        quadrilaterals=np.hstack([quadrilaterals, middles[len(sides[0]) :].reshape(-1, 4)]),
        n_vertices=len(vertices),
        edges=np.column_stack([edges, len(vertices) + np.arange(len(edges))]),
    )


def split(mesh: PlanarMesh) -> PlanarMesh:
    """Split every element uniformly into four, through its edge middles and the centre of a quadrilateral."""
    a, b, c, ab, bc, ca = mesh.triangles.T
    triangles = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]).transpose(0, 2, 1).reshape(-1, 3)
    a, b, c, d, ab, bc, cd, da = mesh.quadrilaterals.T
    centre = len(mesh.points) + np.arange(len(a))
    quads = np.stack([[a, ab, centre, da], [ab, b, bc, centre], [centre, bc, c, cd], [da, centre, cd, d]])
    centres = mesh.points[mesh.quadrilaterals[:, :4]].mean(axis=1)
    return add_middles(np.vstack([mesh.points, centres]), triangles, quads.transpose(0, 2, 1).reshape(-1, 4))


def _sides(elements: np.ndarray) -> np.ndarray:
    """List the sides (m k, 2) of elements (m, k), the lower vertex first."""
    return np.sort(np.stack([elements, np.roll(elements, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
