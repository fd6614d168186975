"""The section of a finger as a mesh of its own: what the extruded mesher sweeps over the width, not swept."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.effects.base import Effect
from models.geometry.profile import BASE_HEIGHT_MM
from models.mesh.build import printed_profile
from models.mesh.extrude import PLANE_TOLERANCE_MM, contact_edges
from models.mesh.planar import PlanarMesh
from models.mesh.section import planar_mesh
from models.records import Design, MeshSettings


@dataclass(frozen=True)
class PlaneMesh:
    """Quadratic mesh of the section in the finger frame's (x, z) plane, mm.

    It stands for `width_mm` in y: from 0 on if `is_half`, else half to each side. `half_wave_mm` is the length over
    which the walls bend (see `models.fem.plane_width`).

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
    is_half: bool
    half_wave_mm: float

    @property
    def connectivities(self) -> tuple[np.ndarray, ...]:
        """The elements of each kind that occurs."""
        return tuple(part for part in (self.triangles, self.quadrilaterals) if len(part))


def plane_mesh(
    design: Design, settings: MeshSettings, *, full_width: bool = False, effects: Sequence[Effect] = ()
) -> PlaneMesh:
    """The section of a finger; arguments as `models.mesh.build.build_mesh`.

    Raises:
        MeshingFailed: `empty` when the elements do not cover the profile.
    """
    planar = planar_mesh(printed_profile(design, settings, effects), settings.edge_mm, settings.refine)
    free_length_mm = design.height_mm - design.tip_length_mm - BASE_HEIGHT_MM
    return section(planar, design.width_mm, half_wave_mm=free_length_mm, full_width=full_width)


def section(planar: PlanarMesh, width_mm: float, *, half_wave_mm: float, full_width: bool = False) -> PlaneMesh:
    """A planar mesh with its base and contact edges; `width_mm` is that of the whole finger."""
    z = planar.points[:, 1]
    return PlaneMesh(
        nodes=planar.points,
        triangles=planar.triangles.astype(np.int32),
        quadrilaterals=planar.quadrilaterals.astype(np.int32),
        base_nodes=np.flatnonzero(z < z.min() + PLANE_TOLERANCE_MM).astype(np.int32),
        contact_edges=contact_edges(planar).astype(np.int32),
        width_mm=width_mm if full_width else 0.5 * width_mm,
        is_half=not full_width,
        half_wave_mm=half_wave_mm,
    )
