"""The section of a finger as a mesh of its own: what the extruded mesher sweeps over the width, not swept."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import shapely

from models.design.profile import BASE_HEIGHT_MM
from models.records import Design, MeshSettings
from models.simulation.effects.base import Effect
from models.simulation.mesh.build import printed_profile, printed_section
from models.simulation.mesh.extrude import PLANE_TOLERANCE_MM, contact_edges, extrude
from models.simulation.mesh.planar import PlanarMesh
from models.simulation.mesh.section import planar_mesh
from models.simulation.mesh.solid import SolidMesh


@dataclass(frozen=True)
class PlaneMesh:
    """A planar mesh in the finger frame's (x, z) plane, mm, for plane strain (CPE6 and CPE8R in Abaqus' names).

    It stands for `width_mm` in y: from 0 on if `is_half`, else half to each side. `half_wave_mm` is the length over
    which the walls bend (see `models.simulation.plane_width`).
    """

    planar: PlanarMesh
    width_mm: float
    is_half: bool
    half_wave_mm: float

    @property
    def nodes(self) -> np.ndarray:
        """Nodes (n, 2)."""
        return self.planar.points

    @cached_property
    def connectivities(self) -> tuple[np.ndarray, ...]:
        """The triangles (m, 6) and quadrilaterals (m, 8), as far as there are any."""
        parts = self.planar.triangles, self.planar.quadrilaterals
        return tuple(np.ascontiguousarray(part, dtype=np.int32) for part in parts if len(part))

    @cached_property
    def base_nodes(self) -> np.ndarray:
        """Nodes on the clamped line on top of the rigid base."""
        z = self.nodes[:, 1]
        return np.flatnonzero(z < z.min() + PLANE_TOLERANCE_MM).astype(np.int32)

    @cached_property
    def contact_edges(self) -> np.ndarray:
        """Edges (e, 3) of the front wall and of the tip: two ends, then the middle."""
        return contact_edges(self.planar).astype(np.int32)

    @cached_property
    def mesh_id(self) -> str:
        """Id derived from the content."""
        digest = hashlib.sha256(repr((self.width_mm, self.is_half, self.half_wave_mm)).encode())
        for array in (self.nodes, *self.connectivities):
            digest.update(np.ascontiguousarray(array).tobytes())
        return "P" + digest.hexdigest()[:12]

    def swept(self) -> tuple[SolidMesh, np.ndarray]:
        """The solid with one layer of elements that deforms like the section, and the section's node of each node."""
        start = 0.0 if self.is_half else -0.5 * self.width_mm
        solid = extrude(self.planar, np.array([start, start + self.width_mm]), symmetric=self.is_half)
        every = np.arange(len(self.nodes))
        return solid, np.concatenate([every, every[: self.planar.n_vertices], every])


def plane_mesh(
    design: Design, settings: MeshSettings, *, full_width: bool = False, effects: Sequence[Effect] = ()
) -> PlaneMesh:
    """The section of a finger; arguments as `models.simulation.mesh.build.build_mesh`.

    Raises:
        MeshingFailed: `empty` when the elements do not cover the profile.
    """
    profile = printed_profile(design, settings, effects)
    return PlaneMesh(
        planar=printed_section(_meshed(shapely.to_wkb(profile), settings.edge_mm, settings.refine), design, effects),
        width_mm=design.width_mm if full_width else 0.5 * design.width_mm,
        is_half=not full_width,
        half_wave_mm=design.height_mm - design.tip_length_mm - BASE_HEIGHT_MM,
    )


@lru_cache(maxsize=2)
def _meshed(profile: bytes, edge_mm: float, refine: int) -> PlanarMesh:
    """Meshing takes a fifth of a grasp, so it is kept for the next object."""
    return planar_mesh(shapely.from_wkb(profile), edge_mm, refine)
