"""Planar meshes swept over the width in quadratic layers: triangles become wedges, quadrilaterals hexahedra."""

import numpy as np

from fast.models.simulation.mesh.planar import PlanarMesh
from fast.models.simulation.mesh.solid import ElementBlock, SolidMesh

PLANE_TOLERANCE_MM = 1e-6


def extrude(planar: PlanarMesh, levels: np.ndarray, *, symmetric: bool) -> SolidMesh:
    """C3D15 and C3D20R between consecutive `levels` of y (mm); the first is the symmetry plane if `symmetric`.

    Levels between layers carry all planar points, the middles of the layers only the vertices (serendipity).
    """
    n_points, n_vertices, n_layers = len(planar.points), planar.n_vertices, len(levels) - 1
    stride = n_points + n_vertices
    full = [_at_level(planar.points, y) for y in levels]
    middle = [_at_level(planar.points[:n_vertices], y) for y in 0.5 * (levels[1:] + levels[:-1])]
    nodes = np.vstack([part for pair in zip(full, middle, strict=False) for part in pair] + [full[-1]])
    blocks = [
        ElementBlock("C3D15", _stacked(_swept(planar.triangles, n_points, stride), stride, n_layers)),
        ElementBlock("C3D20R", _stacked(_swept(planar.quadrilaterals, n_points, stride), stride, n_layers)),
    ]
    base_z = planar.points[:, 1].min()
    return SolidMesh(
        nodes=nodes,
        blocks=tuple(block for block in blocks if len(block.connectivity)),
        base_nodes=np.flatnonzero(nodes[:, 2] < base_z + PLANE_TOLERANCE_MM).astype(np.int32),
        symmetry_nodes=np.flatnonzero(nodes[:, 1] == 0.0).astype(np.int32) if symmetric else np.zeros(0, np.int32),
        contact_faces=_stacked(_faces(contact_edges(planar), n_points, stride), stride, n_layers),
    )


def contact_edges(planar: PlanarMesh) -> np.ndarray:
    """Edges (e, 3) on the front wall x = 0 and on the tip plane z = max."""
    x, z = planar.points[planar.edges].transpose(2, 0, 1)
    apex = planar.points[:, 1].max()
    on_front = (np.abs(x) < PLANE_TOLERANCE_MM).all(axis=1)
    on_tip = (z > apex - PLANE_TOLERANCE_MM).all(axis=1)
    return planar.edges[on_front | on_tip]


def _swept(elements: np.ndarray, n_points: int, stride: int) -> np.ndarray:
    """Solid elements of one layer from planar ones (m, 2 k): corners and middles below, above, then between."""
    k = elements.shape[1] // 2
    # Counter-clockwise in (x, z) looks along -y, so the corners are taken clockwise to extrude towards +y.
    corners = np.roll(elements[:, :k][:, ::-1], 1, axis=1)
    sides = elements[:, k:][:, ::-1]
    return np.hstack([corners, corners + stride, sides, sides + stride, corners + n_points])


def _faces(edges: np.ndarray, n_points: int, stride: int) -> np.ndarray:
    """Eight-node faces over the edges (e, 3) of one layer."""
    a, b, middle = edges.T
    return np.column_stack([a, b, b + stride, a + stride, middle, b + n_points, middle + stride, a + n_points])


def _stacked(layer: np.ndarray, stride: int, n_layers: int) -> np.ndarray:
    return np.vstack([layer + stride * i for i in range(n_layers)]).astype(np.int32)


def _at_level(points: np.ndarray, y: float) -> np.ndarray:
    return np.column_stack([points[:, 0], np.full(len(points), y), points[:, 1]])
