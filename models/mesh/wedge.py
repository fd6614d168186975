"""Wedge meshes: a planar triangulation of the profile, extruded along the width in quadratic layers.

The triangulation is constrained Delaunay on boundary vertices only (GEOS), so a thin wall becomes one strip of
triangle pairs and every one of the nine parameters is meshed the same way, in milliseconds and deterministically.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

from models.errors import MeshingFailed
from models.mesh.solid import ElementBlock, SolidMesh

PLANE_TOLERANCE_MM = 1e-6


@dataclass(frozen=True)
class PlanarMesh:
    """Six-node triangles in the (x, z) plane, counter-clockwise: vertices first, then edge middles.

    `points` (p, 2), `triangles` (t, 6) corners then middles of sides 01, 12, 20; `n_vertices` of the points are
    corners; `edges` (e, 3): two corners and the middle.
    """

    points: np.ndarray
    triangles: np.ndarray
    n_vertices: int
    edges: np.ndarray


def wedge_mesh(
    profile: Polygon, width_mm: float, edge_mm: float, *, refine: int = 0, n_layers: int = 1, full_width: bool = False
) -> SolidMesh:
    """Extrude a planar profile (x, z in mm) into 15-node wedges.

    `refine` splits every triangle into four that many times; `n_layers` quadratic layers lie over the half width
    0..W/2, twice as many over -W/2..W/2 when `full_width`.

    Raises:
        MeshingFailed: `empty` when the profile has no usable triangulation.
    """
    vertices, triangles = triangulate(profile, edge_mm)
    for _ in range(refine):
        vertices, triangles = split(vertices, triangles)
    planar = add_middles(vertices, triangles)
    half = 0.5 * width_mm
    levels = np.linspace(-half, half, 2 * n_layers + 1) if full_width else np.linspace(0.0, half, n_layers + 1)
    return extrude(planar, levels, symmetric=not full_width)


def triangulate(profile: Polygon, edge_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Constrained Delaunay triangles (t, 3) over boundary points (v, 2) at most `edge_mm` apart."""
    divided = orient(shapely.segmentize(profile, edge_mm))
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(divided))
    parts = parts[shapely.area(parts) > 1e-9]
    if not len(parts) or abs(shapely.area(parts).sum() - profile.area) > 1e-6 * profile.area:
        raise MeshingFailed(
            f"The triangulation covers {shapely.area(parts).sum():.3f} of {profile.area:.3f} mm2 of the profile; "
            "change the edge length or the fillet.",
            reason="empty",
        )
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    vertices, inverse = np.unique(np.round(corners.reshape(-1, 2), 9), axis=0, return_inverse=True)
    return vertices, _counter_clockwise(vertices, inverse.reshape(-1, 3))


def split(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Uniform refinement: every triangle into four through its edge middles."""
    planar = add_middles(vertices, triangles)
    a, b, c, ab, bc, ca = planar.triangles.T
    children = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    return planar.points, children.transpose(0, 2, 1).reshape(-1, 3)


def add_middles(vertices: np.ndarray, triangles: np.ndarray) -> PlanarMesh:
    """Add one point in the middle of every edge."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(sides, axis=0, return_inverse=True)
    middles = len(vertices) + np.arange(len(edges))
    points = np.vstack([vertices, 0.5 * (vertices[edges[:, 0]] + vertices[edges[:, 1]])])
    quadratic = np.hstack([triangles, middles[inverse.reshape(-1, 3)]])
    return PlanarMesh(points, quadratic, len(vertices), np.column_stack([edges, middles]))


def extrude(planar: PlanarMesh, levels: np.ndarray, *, symmetric: bool) -> SolidMesh:
    """Wedges between consecutive `levels` of y (mm); the first level is the symmetry plane if `symmetric`.

    Corner levels carry all planar points, the middles of the layers only the vertices (serendipity wedge).
    """
    n_points, n_vertices, n_layers = len(planar.points), planar.n_vertices, len(levels) - 1
    stride = n_points + n_vertices
    full = [_at_level(planar.points, y) for y in levels]
    middle = [_at_level(planar.points[:n_vertices], y) for y in 0.5 * (levels[1:] + levels[:-1])]
    nodes = np.vstack([part for pair in zip(full, middle, strict=False) for part in pair] + [full[-1]])
    # Counter-clockwise in (x, z) looks along -y, so the corners are taken clockwise to extrude towards +y.
    a, b, c, ab, bc, ca = planar.triangles.T
    bottom, sides = np.column_stack([a, c, b]), np.column_stack([ca, bc, ab])
    wedge = np.hstack([bottom, bottom + stride, sides, sides + stride, bottom + n_points])
    elements = np.vstack([wedge + stride * layer for layer in range(n_layers)])
    faces = _extruded_edges(_contact_edges(planar), n_points, stride, n_layers)
    base_z = planar.points[:, 1].min()
    return SolidMesh(
        nodes=nodes,
        blocks=(ElementBlock("C3D15", elements.astype(np.int32)),),
        base_nodes=np.flatnonzero(nodes[:, 2] < base_z + PLANE_TOLERANCE_MM).astype(np.int32),
        symmetry_nodes=np.flatnonzero(nodes[:, 1] == 0.0).astype(np.int32) if symmetric else np.zeros(0, np.int32),
        contact_faces=faces,
    )


def _contact_edges(planar: PlanarMesh) -> np.ndarray:
    """Edges (e, 3) on the front wall x = 0 and on the tip plane z = max."""
    x, z = planar.points[planar.edges].transpose(2, 0, 1)
    apex = planar.points[:, 1].max()
    on_front = (np.abs(x) < PLANE_TOLERANCE_MM).all(axis=1)
    on_tip = (z > apex - PLANE_TOLERANCE_MM).all(axis=1)
    return planar.edges[on_front | on_tip]


def _extruded_edges(edges: np.ndarray, n_points: int, stride: int, n_layers: int) -> np.ndarray:
    """Eight-node faces over each edge and layer."""
    a, b, middle = edges.T
    face = np.column_stack([a, b, b + stride, a + stride, middle, b + n_points, middle + stride, a + n_points])
    return np.vstack([face + stride * layer for layer in range(n_layers)]).astype(np.int32)


def _at_level(points: np.ndarray, y: float) -> np.ndarray:
    return np.column_stack([points[:, 0], np.full(len(points), y), points[:, 1]])


def _counter_clockwise(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return np.where((area > 0)[:, None], triangles, triangles[:, ::-1])
