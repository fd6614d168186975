"""What several hidden laws share: ribs of a finger, edges and lengths of an object."""

import numpy as np

from fast.models.design.fin_ray import BASE_HEIGHT_MM, FinRay, rib_centres
from fast.models.objects.rigid import RigidObject

LEAST_RADIUS_MM = 0.5  # contact points cannot resolve a sharper edge
_RIB_REACH_MM = 2.0  # beside a rib, what goes with it


def find_ribs(points: np.ndarray, design: FinRay) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nearest rib of points (n, 2) in mm, how far they go with it, and the direction across the ribs (2).

    The share (n) is 1 in a rib and fades over 2 mm beside it, and towards base and tip, so that no wall moves.
    """
    angle = np.radians(design.rib_angle_deg)
    across = np.array([-np.sin(angle), np.cos(angle)])
    beside_mm = np.abs((points[:, None] - rib_centres(design)) @ across)
    outside_mm = np.maximum(beside_mm.min(axis=1) - 0.5 * design.rib_thickness_mm, 0.0)
    ends_mm = np.minimum(points[:, 1] - BASE_HEIGHT_MM, design.height_mm - design.tip_length_mm - points[:, 1])
    near = np.exp(-((outside_mm / (0.5 * _RIB_REACH_MM)) ** 2)) * np.clip(ends_mm / _RIB_REACH_MM, 0.0, 1.0)
    return np.argmin(beside_mm, axis=1), near, across


def with_rounder_edges(obj: RigidObject, extra_mm: float) -> RigidObject:
    """The object with so much larger a radius of its edges, where they stand; the same one if it has no edges."""
    radius_mm = obj.parameters.get("rounding_mm")
    if radius_mm is None or extra_mm == 0.0:
        return obj
    made_mm = max(radius_mm + extra_mm, LEAST_RADIUS_MM)
    return obj.model_copy(update={"parameters": obj.parameters | {"rounding_mm": made_mm}})


def list_sizes_mm(obj: RigidObject) -> dict[str, float]:
    """Lengths of an object in mm, but for its edge radius and what is zero."""
    return {n: v for n, v in obj.parameters.items() if n.endswith("_mm") and n != "rounding_mm" and v > 0.0}
