"""The meshes of the solver's design study, to compare with: sharp corners, wedges on boundary points only."""

import numpy as np
import shapely
from shapely.geometry.polygon import orient

from models.design.profile import planar_profile
from models.records import Design
from models.simulation.mesh.extrude import extrude
from models.simulation.mesh.planar import add_middles, split
from models.simulation.mesh.solid import SolidMesh

EDGE_MM = 6.0
NO_QUADRILATERALS = np.zeros((0, 4), dtype=int)


def wedge_mesh(design: Design, *, refine: int, full_width: bool) -> SolidMesh:
    """One quadratic layer of 15-node wedges over the half width; `refine` divides every triangle into four."""
    profile = orient(shapely.segmentize(planar_profile(design, fillet_mm=0.0), EDGE_MM))
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(profile))
    parts = parts[shapely.area(parts) > 1e-9]
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3].reshape(-1, 2)
    vertices, inverse = np.unique(np.round(corners, 9), axis=0, return_inverse=True)
    planar = add_middles(vertices, _counter_clockwise(vertices, inverse.reshape(-1, 3)), NO_QUADRILATERALS)
    for _ in range(refine):
        planar = split(planar)
    half = 0.5 * design.width_mm
    levels = np.array([-half, 0.0, half] if full_width else [0.0, half])
    return extrude(planar, levels, symmetric=not full_width)


def _counter_clockwise(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return np.where((area > 0)[:, None], triangles, triangles[:, ::-1])
