"""Rigid obstacles with closed forms: a half space, a rod along y, a ball."""

import numpy as np

from fast.models.objects.primitives import box, capsule, moved, rotated, sphere
from fast.models.simulation.contact.law import Obstacle

FAR_MM = 1000.0  # where a half space and a rod end


def make_half_space(point: np.ndarray, outward: np.ndarray) -> Obstacle:
    """What lies behind the plane through a point (3) with this unit normal (3), which has no y."""
    x, _, z = outward
    turned = rotated(
        box(2.0 * FAR_MM, 2.0 * FAR_MM, 2.0 * FAR_MM, 0.0)[None], np.array([[z, 0, x], [0, 1, 0], [-x, 0, z]])
    )
    return Obstacle(moved(turned, np.asarray(point) - FAR_MM * np.asarray(outward)))


def make_rod(x_mm: float, z_mm: float, radius_mm: float) -> Obstacle:
    """A cylinder along y through (x, z)."""
    ends = np.array([[x_mm, -FAR_MM, z_mm], [x_mm, FAR_MM, z_mm]])
    return Obstacle(capsule(ends[0], ends[1], radius_mm)[None])


def make_ball(centre: np.ndarray, radius_mm: float) -> Obstacle:
    """A sphere about a centre (3)."""
    return Obstacle(moved(sphere(radius_mm)[None], np.asarray(centre)))
