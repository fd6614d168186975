"""Hertz contact: a rigid cylinder or sphere of radius R pressed into a large elastic block.

With E* = E / (1 - nu^2) and half-width or radius a of the contact (Johnson 1985, Contact Mechanics, chapter 4):

    cylinder   a^2 = 4 F R / (pi E*) per length,   p(x) = 2 F / (pi a) sqrt(1 - x^2 / a^2)
    sphere     F = 4/3 E* sqrt(R) d^(3/2),  a^2 = R d,  p(r) = 3 F / (2 pi a^2) sqrt(1 - r^2 / a^2)

The indentation d of a cylinder has no limit in a half space, so only its force and pressure are compared. Hertz takes
a / R small (here 0.05) and an endless half space: the block reaches 40 a, where a point load on a half space still
moves the surface by 0.42 a / r of the indentation, so a clamped block is about one percent too stiff.
"""

from dataclasses import dataclass

import numpy as np

from fast.models.simulation.body.assembly import Material
from fast.models.simulation.contact.law import ContactLaw, PointSpacing
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.solver.newton import NewtonSettings
from tests.models.simulation.obstacles import make_ball, make_rod
from tests.models.simulation.verification.bricks import brick, everything
from tests.models.simulation.verification.rig import set_up

RADIUS_MM, CONTACT_MM, REACH_MM = 20.0, 1.0, 40.0
WIDTH_MM, ELEMENT_MM = 0.5, 0.2  # of the cylinder's block, in plane strain
MODULUS_MPA, POISSON = 11.5, 0.45
SPEED_MM_PER_S = 1e-3  # slow enough for the inertia of the block to vanish
PLANE_MODULUS_MPA = MODULUS_MPA / (1.0 - POISSON**2)
# The penalty gives way by 1.5 % of the sphere's indentation.
LAW = ContactLaw(normal_n_per_mm3=600.0, tangential_n_per_mm3=600.0, smoothing_mm=1e-5)


@dataclass(frozen=True)
class Indentation:
    """Force of the whole contact, N or N/mm, and pressure (n) in MPa over distance (n) from the middle in mm."""

    depth_mm: float
    force_n: float
    distance_mm: np.ndarray
    pressure_mpa: np.ndarray


def cylinder_block() -> SolidMesh:
    """One layer of hexahedra in plane strain."""
    half = _lines(ELEMENT_MM, 1.4, 1.6)
    grid = (_mirrored(half), np.array([0.0, WIDTH_MM]), -half[::-1])
    return brick("C3D20R", grid, base=_outside, symmetry=everything, contact=_near_middle)


def sphere_block() -> SolidMesh:
    """Half a block, cut at y = 0."""
    half, depth = _lines(0.4, 1.2, 2.4), _lines(0.4, 0.8, 2.4)
    grid = (_mirrored(half), half, -depth[::-1])
    return brick("C3D20R", grid, base=_outside_half, symmetry=lambda p: p[:, 1] == 0.0, contact=_near_middle)


def press(mesh: SolidMesh, depth_mm: float, *, is_sphere: bool) -> Indentation:
    """Press the block up against the ball without friction."""
    rig = set_up(
        mesh,
        mesh.nodes,
        Material(MODULUS_MPA, POISSON),
        make_ball(np.array([0.0, 0.0, RADIUS_MM]), RADIUS_MM) if is_sphere else make_rod(0.0, RADIUS_MM, RADIUS_MM),
        friction=0.0,
        law=LAW,
        spacing=PointSpacing(0.05, 0.05),
        newton=NewtonSettings(tolerance_n=1e-6),
    )
    start = rig.finger.undeformed(np.zeros(3), np.zeros(3))
    last = rig.walk(start, np.array([0.0, 0.0, 1.0]), depth_mm, depth_mm / 2, SPEED_MM_PER_S)[-1]
    points = rig.surface.positions(last.state.x)
    radius = np.hypot(points[:, 0], points[:, 1] if is_sphere else 0.0)
    whole = 2.0 if is_sphere else 1.0 / WIDTH_MM
    return Indentation(depth_mm, whole * float(last.clamp_n[2]), radius, last.state.contact.spread_pressure())


def line_contact(force_n_per_mm: float) -> tuple[float, float]:
    """Half-width in mm and highest pressure in MPa under the cylinder."""
    a = float(np.sqrt(4.0 * force_n_per_mm * RADIUS_MM / (np.pi * PLANE_MODULUS_MPA)))
    return a, 2.0 * force_n_per_mm / (np.pi * a)


def point_contact(depth_mm: float) -> tuple[float, float]:
    """Force in N and highest pressure in MPa under the sphere."""
    force = 4.0 / 3.0 * PLANE_MODULUS_MPA * float(np.sqrt(RADIUS_MM) * depth_mm**1.5)
    return force, 1.5 * force / (np.pi * RADIUS_MM * depth_mm)


def profile(distance_mm: np.ndarray, half_width_mm: float, highest_mpa: float) -> np.ndarray:
    """Hertz' pressure in MPa at distances (n) from the middle."""
    return highest_mpa * np.sqrt(np.maximum(1.0 - (distance_mm / half_width_mm) ** 2, 0.0))


def _lines(finest_mm: float, fine_to_mm: float, growth: float) -> np.ndarray:
    """Grid lines from the contact outwards: even up to `fine_to_mm`, then growing up to the reach."""
    lines = list(np.linspace(0.0, fine_to_mm, round(fine_to_mm / finest_mm) + 1))
    while (step := growth * (lines[-1] - lines[-2])) < REACH_MM - lines[-1]:
        lines.append(lines[-1] + step)
    return np.array([*lines[:-1], REACH_MM])


def _mirrored(half: np.ndarray) -> np.ndarray:
    return np.concatenate([-half[:0:-1], half])


def _outside(points: np.ndarray) -> np.ndarray:
    return (np.abs(points[:, 0]) == REACH_MM) | (points[:, 2] == -REACH_MM)


def _outside_half(points: np.ndarray) -> np.ndarray:
    return _outside(points) | (points[:, 1] == REACH_MM)


def _near_middle(points: np.ndarray) -> np.ndarray:
    limit = 1.5 * CONTACT_MM
    return (points[:, 2] == 0.0) & (np.abs(points[:, :2]) <= [limit, limit]).all(axis=1)
