"""How far the tip of a finger turns about the finger's long axis in a grasp: torsional slip."""

import numpy as np

from fast.models.simulation.mesh.solid import SolidMesh


def rotation_between(rest: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Find the rotation (3, 3) that brings points (n, 3) nearest to those now (n, 3), least squares (Kabsch 1976)."""
    u, _, vt = np.linalg.svd((rest - rest.mean(axis=0)).T @ (now - now.mean(axis=0)))
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return np.asarray((u @ handed @ vt).T)


def twist_about_z_deg(rotation: np.ndarray) -> float:
    """Return the part of a rotation (3, 3) about z, counter-clockwise, that is left after the axis's shortest tilt.

    Of the quaternion (w, x, y, z) of the rotation, 2 atan(z / w): bending about x or y does not count.
    """
    # w and z up to one common factor: 4 w^2 = 1 + trace and 4 w z = R10 - R01.
    return float(np.degrees(2.0 * np.arctan2(rotation[1, 0] - rotation[0, 1], 1.0 + np.trace(rotation))))


class TwistGauge:
    """Follows the twist of the tip of one finger; half a finger cannot twist.

    `largest_deg`: size of the largest twist so far.
    """

    def __init__(self, mesh: SolidMesh, rest_nodes: np.ndarray, tip_length_mm: float) -> None:
        """Take `mesh` in the finger frame, `rest_nodes` (n, 3), the undeformed finger, in the calculation's."""
        self.largest_deg = 0.0
        self._tip = np.flatnonzero(_is_tip(mesh, tip_length_mm) & (not mesh.is_half))
        self._rest = rest_nodes[self._tip]

    def add(self, nodes: np.ndarray) -> None:
        """Take note of the deformed nodes (n, 3) of a step."""
        if len(self._tip):
            twist = twist_about_z_deg(rotation_between(self._rest, nodes[self._tip]))
            self.largest_deg = max(self.largest_deg, abs(twist))


def _is_tip(mesh: SolidMesh, tip_length_mm: float) -> np.ndarray:
    z = mesh.nodes[:, 2]
    return np.asarray(z > z.max() - tip_length_mm)
