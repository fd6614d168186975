"""How far the tip of a finger turns about the finger's long axis in a grasp: torsional slip."""

from dataclasses import dataclass, field

import numpy as np

from models.simulation.output.recording import Recorder, Snapshot
from models.simulation.placement import Side


def rotation_between(rest: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) that brings points (n, 3) nearest to where they are now (n, 3), least squares (Kabsch 1976)."""
    u, _, vt = np.linalg.svd((rest - rest.mean(axis=0)).T @ (now - now.mean(axis=0)))
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return np.asarray((u @ handed @ vt).T)


def twist_about_z_deg(rotation: np.ndarray) -> float:
    """Part of a rotation (3, 3) about z, counter-clockwise, that is left after the shortest tilt of the axis.

    Of the quaternion (w, x, y, z) of the rotation, 2 atan(z / w): bending about x or y does not count.
    """
    # w and z up to one common factor: 4 w^2 = 1 + trace and 4 w z = R10 - R01.
    return float(np.degrees(2.0 * np.arctan2(rotation[1, 0] - rotation[0, 1], 1.0 + np.trace(rotation))))


def tip_twist_deg(snapshot: Snapshot, tip_length_mm: float) -> float:
    """Twist of the solid tip of a full-width finger about its long axis against the undeformed finger, in degrees.

    Counter-clockwise seen from above, for the finger as it stands on the +x side.
    """
    z = snapshot.mesh.nodes[:, 2]
    tip = z > z.max() - tip_length_mm
    return twist_about_z_deg(rotation_between(snapshot.rest_nodes[tip], snapshot.nodes[tip]))


@dataclass
class TwistGauge:
    """A recorder that follows the twist of the tips; half a finger cannot twist. It may pass the snapshots on."""

    tip_length_mm: float
    recorder: Recorder | None = None
    twist_deg: dict[Side, list[float]] = field(default_factory=dict)

    def add(self, snapshot: Snapshot) -> None:
        """Take note of a step."""
        twist = 0.0 if snapshot.mesh.is_half else tip_twist_deg(snapshot, self.tip_length_mm)
        self.twist_deg.setdefault(snapshot.side, []).append(twist)
        if self.recorder is not None:
            self.recorder(snapshot)

    @property
    def largest_deg(self) -> float:
        """Size of the largest twist of any finger so far."""
        return max((abs(twist) for of_side in self.twist_deg.values() for twist in of_side), default=0.0)
