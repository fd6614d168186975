"""What all grasps of one section share: its mechanics before any object, built once and kept."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.simulation.body.assembly import Material
from models.simulation.contact.law import ContactLaw, Obstacle, PointSpacing
from models.simulation.mesh.plane import PlaneMesh
from models.simulation.model import bytes_of, kept, to_object_frame
from models.simulation.section.body import PlaneBody
from models.simulation.section.contact import PlaneSurface
from models.simulation.section.finger import IN_PLANE, PlaneFinger
from models.simulation.section.linear import PlaneCholesky


@dataclass(frozen=True)
class SectionModel:
    """What the grasps of one section share, as `FingerModel` of the solid; nodes (n, 2), `blocks` (z, 2, 2)."""

    nodes: np.ndarray
    body: PlaneBody
    linear: PlaneCholesky
    blocks: np.ndarray
    law: ContactLaw
    spacing: PointSpacing

    def against(self, obstacle: Obstacle, stop_mm: float = 0.0) -> PlaneFinger:
        """The section before an obstacle, on which its contact points depend; `stop_mm` as in `FingerModel`."""
        surface = PlaneSurface(self.body, self.nodes, self.law, self.spacing, obstacle)
        return PlaneFinger(self.body, surface, self.nodes, stop_mm=stop_mm)


def section_model(
    mesh: PlaneMesh,
    *,
    height_mm: float,
    tip_below_mm: float,
    material: Material,
    law: ContactLaw,
    spacing: PointSpacing,
    factors: Sequence[np.ndarray] | None = None,
) -> SectionModel:
    """The model of a section, from the last few built in this thread or new; `factors`: see `PlaneBody`."""

    def build() -> SectionModel:
        x, z = mesh.nodes.T
        solid = to_object_frame(np.column_stack([x, np.zeros(len(x)), z]), height_mm, tip_below_mm)
        nodes = np.ascontiguousarray(solid[:, IN_PLANE])
        body = PlaneBody(mesh, nodes, material, factors)
        blocks = np.zeros((len(body.pattern.indices), 2, 2))
        return SectionModel(nodes, body, PlaneCholesky(body.pattern), blocks, law, spacing)

    return kept((mesh.mesh_id, height_mm, tip_below_mm, material, law, spacing, bytes_of(factors)), build)
