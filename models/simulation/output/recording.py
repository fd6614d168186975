"""What a grasp looks like from inside: the deformed finger and its contact at every converged step.

`simulate_grasp(..., recorder=recording.add)` fills a `GraspRecording`. Recording changes no number of the grasp, and
costs nothing without a recorder.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fast.models.simulation.contact.law import ContactSurface, Obstacle
from fast.models.simulation.finger import FingerState
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.placement import Side

Phase = Literal["closing", "lift"]
SIDES: tuple[Side, Side] = ("right", "left")


@dataclass(frozen=True)
class Snapshot:
    """One finger at one converged instant, in the object frame (mm, z up) as if it stood on the +x side.

    Stresses and forces belong to the reference modulus; times `scale` they belong to the actual one. Of a half mesh,
    nodes and contact points are those of the half.
    """

    side: Side
    """Finger of the gripper; the left one is solved against the mirrored object."""
    phase: Phase
    """Closing (first the undeformed finger at the first touch), or lift."""
    time_s: float
    """From the start of closing."""
    travel_mm: float
    """Of the jaw from the open gap in the closing, of the head in the lift."""
    mesh: SolidMesh
    """Undeformed, in the finger frame; the same object in every snapshot of a finger."""
    rest_nodes: np.ndarray
    """n x 3, the undeformed finger moved along with its base."""
    nodes: np.ndarray
    """n x 3, deformed."""
    contact_points: np.ndarray
    """c x 3, the points that the object presses on."""
    contact_areas: np.ndarray
    """c, mm2, undeformed."""
    contact_normals: np.ndarray
    """c x 3, outward normals of the object there."""
    pressure: np.ndarray
    """c, MPa, along the normal."""
    traction: np.ndarray
    """c x 3, MPa, friction of the object on the finger."""
    clamp_force: np.ndarray
    """3, N, of the clamp on the whole finger: x < 0 presses it on the object, z > 0 pulls it up."""
    scale: float
    """Actual over reference modulus."""
    is_half_turned: bool = False
    """The other finger, where it is not solved, is this one after a half turn about z, and not in the mirror x = 0."""

    @property
    def lift_mm(self) -> float:
        """Lift of the head; 0 in the closing."""
        return self.travel_mm if self.phase == "lift" else 0.0

    @property
    def displacement_mm(self) -> np.ndarray:
        """Distance (n) of every node from where the undeformed finger would have it."""
        return np.asarray(np.linalg.norm(self.nodes - self.rest_nodes, axis=1))

    @property
    def contact_force(self) -> np.ndarray:
        """Force (c, 3) in N of the object on the finger at every touching point."""
        stress = self.pressure[:, None] * self.contact_normals + self.traction
        return np.asarray(self.contact_areas[:, None] * stress)


Recorder = Callable[[Snapshot], None]


@dataclass(frozen=True)
class Camera:
    """Takes the snapshots of one finger for a recorder; `rest_nodes` (n, 3) are those at base position 0."""

    recorder: Recorder
    side: Side
    mesh: SolidMesh
    rest_nodes: np.ndarray
    surface: ContactSurface
    obstacle: Obstacle
    scale: float

    def take(self, phase: Phase, time_s: float, travel_mm: float, state: FingerState, clamp_force: np.ndarray) -> None:
        """Record an instant; `clamp_force` (3) on the meshed body."""
        contact = state.contact
        points = self.surface.positions_of(contact.points, state.x)
        self.recorder(
            Snapshot(
                side=self.side,
                phase=phase,
                time_s=time_s,
                travel_mm=travel_mm,
                mesh=self.mesh,
                rest_nodes=self.rest_nodes + state.base,
                nodes=state.x.copy(),
                contact_points=points,
                contact_areas=self.surface.areas[contact.points],
                contact_normals=self.obstacle.normal(points),
                pressure=contact.pressure,
                traction=contact.traction,
                clamp_force=(2.0 if self.mesh.is_half else 1.0) * clamp_force,
                scale=self.scale,
            )
        )


@dataclass
class GraspRecording:
    """All snapshots of a grasp, in order, per finger."""

    snapshots: dict[Side, list[Snapshot]] = field(default_factory=lambda: {side: [] for side in SIDES})

    def add(self, snapshot: Snapshot) -> None:
        """Add a snapshot; hand this method to `simulate_grasp` as its recorder."""
        self.snapshots[snapshot.side].append(snapshot)

    def of(self, side: Side) -> list[Snapshot]:
        """Return the snapshots of a finger; where only the right one is solved, it stands for both."""
        return self.snapshots[side] or self.snapshots["right"]

    @property
    def is_empty(self) -> bool:
        """True if nothing was recorded."""
        return not any(self.snapshots.values())
