"""Snapshots of a section: it is shown as the solid that it sweeps over the width."""

from dataclasses import dataclass, replace

import numpy as np

from models.simulation.contact.law import Obstacle
from models.simulation.finger import FingerState
from models.simulation.output.recording import Camera, Phase, Recorder, Side
from models.simulation.section.contact import PlaneSurface
from models.simulation.section.finger import PlaneFinger


@dataclass(frozen=True)
class _SweptSurface:
    """The contact points of a section, given the nodes of the solid, of which its own come first."""

    section: PlaneSurface
    n_nodes: int

    @property
    def areas(self) -> np.ndarray:
        return self.section.areas

    def positions(self, x: np.ndarray) -> np.ndarray:
        return self.section.points(np.ascontiguousarray(x[: self.n_nodes, [0, 2]]))


@dataclass(frozen=True)
class SectionCamera(Camera):
    """A camera whose `mesh` is the solid that a section sweeps; `node_of` (n): the section's node of each node."""

    node_of: np.ndarray

    def take(self, phase: Phase, time_s: float, travel_mm: float, state: FingerState, clamp_force: np.ndarray) -> None:
        """Record an instant; `clamp_force` (3) on the meshed body."""
        super().take(phase, time_s, travel_mm, replace(state, x=self.swept(state.x)), clamp_force)

    def swept(self, x: np.ndarray) -> np.ndarray:
        """Nodes (n, 3) of the solid for nodes x (m, 2) of the section, in the object frame."""
        return np.column_stack([x[self.node_of, 0], -self.mesh.nodes[:, 1], x[self.node_of, 1]])


def section_camera(
    finger: PlaneFinger, recorder: Recorder, side: Side, obstacle: Obstacle, scale: float
) -> SectionCamera:
    """A camera on a section; arguments as `Camera`."""
    solid, node_of = finger.body.mesh.swept()
    surface = _SweptSurface(finger.surface, len(finger.nodes))
    camera = SectionCamera(recorder, side, solid, np.zeros((0, 3)), surface, obstacle, scale, node_of)
    return replace(camera, rest_nodes=camera.swept(finger.nodes))
