"""The section of a finger as a mesh of its own: what the extruded mesher sweeps over the width, not swept."""

from dataclasses import dataclass

import numpy as np

from models.mesh.wedge import PlanarMesh, add_middles, contact_edges, split, triangulate

from shapely.geometry import Polygon

BASE_TOLERANCE_MM = 1e-6


@dataclass(frozen=True)
class PlaneMesh:
    """Quadratic mesh of the section in the finger frame's (x, z) plane, mm; `width_mm` thick in y.

    Attributes:
        nodes: n x 2.
        triangles: m x 6 (CPE6), corners then middles of sides 01, 12, 20.
        quadrilaterals: m x 8 (CPE8R), corners then middles of sides 01, 12, 23, 30.
        base_nodes: nodes on the clamped line on top of the rigid base.
        contact_edges: e x 3, edges of the front wall and of the tip: two ends, then the middle.
    """

    nodes: np.ndarray
    triangles: np.ndarray
    quadrilaterals: np.ndarray
    base_nodes: np.ndarray
    contact_edges: np.ndarray
    width_mm: float

    @property
    def connectivities(self) -> tuple[np.ndarray, ...]:
        """The elements of each kind that occurs."""
        return tuple(part for part in (self.triangles, self.quadrilaterals) if len(part))


def plane_mesh(profile: Polygon, width_mm: float, edge_mm: float, *, refine: int = 0) -> PlaneMesh:
    """Mesh a planar profile (x, z in mm); arguments as `models.mesh.wedge.wedge_mesh`.

    Raises:
        MeshingFailed: `empty` when the profile has no usable triangulation.
    """
    vertices, triangles = triangulate(profile, edge_mm)
    for _ in range(refine):
        vertices, triangles = split(vertices, triangles)
    return section(add_middles(vertices, triangles), width_mm)


def section(planar: PlanarMesh, width_mm: float) -> PlaneMesh:
    """A planar mesh with its base and contact edges."""
    z = planar.points[:, 1]
    return PlaneMesh(
        nodes=planar.points,
        triangles=planar.triangles.astype(np.int32),
        quadrilaterals=np.zeros((0, 8), np.int32),
        base_nodes=np.flatnonzero(z < z.min() + BASE_TOLERANCE_MM).astype(np.int32),
        contact_edges=contact_edges(planar).astype(np.int32),
        width_mm=width_mm,
    )
