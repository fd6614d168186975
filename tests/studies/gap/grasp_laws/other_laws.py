"""A second law for each effect that acts in a grasp: neither the catalogue's nor the first hidden one."""

from typing import ClassVar

import numpy as np
from shapely.geometry import MultiPolygon, Polygon
from shapely.ops import unary_union

from fast.models.design.fin_ray import cavity_share, is_in_rib, rib_centres, take_fin_ray
from fast.models.objects.rigid import RigidObject
from fast.models.records import Design
from fast.models.simulation.effects.base import Effect
from tests.studies.gap.grasp_laws.parts import find_ribs, list_sizes_mm, with_rounder_edges

USUAL_HEIGHT_MM = 105.0  # of a finger; of designs it is 90 to 120
USUAL_THICKNESS_MM = 2.5  # of walls and ribs; of designs it is 2 to 3


class LinearSlipFriction(Effect):
    """C1: friction that falls in proportion to the slip s, mu [1 - (1 - r) min(s / 2 s0, 1)], and then stays.

    `kinetic_ratio` r, `slip_scale_mm` s0 the slip at which half the change has happened (Andrews 1976).
    """

    def __init__(self, kinetic_ratio: float, slip_scale_mm: float) -> None:
        self.kinetic_ratio = kinetic_ratio
        self.slip_scale_mm = slip_scale_mm

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray:
        """Factor (n) on the friction coefficient."""
        share = np.minimum(np.abs(slip_mm) / (2.0 * self.slip_scale_mm), 1.0)
        return np.asarray(1.0 - (1.0 - self.kinetic_ratio) * share)


class FadingFriction(Effect):
    """C4: mu(p) = mu [1 + a (exp(-p / p0) - 1 / e)], `strength` a and p0 = 50 kPa: high pressure adds nothing more."""

    scales_with_modulus: ClassVar[bool] = False
    reference_mpa = 0.05

    def __init__(self, strength: float) -> None:
        self.strength = strength

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray:
        """Factor (n) on the friction coefficient."""
        fading = np.exp(-np.maximum(pressure_mpa, 0.0) / self.reference_mpa)
        return np.asarray(1.0 + self.strength * (fading - np.exp(-1.0)))


class SpotAdhesion(Effect):
    """C5: shear stress tau0 p / (p + p0) on top of Coulomb's: spots that touch leave less and less room for others.

    `shear_strength_mpa` tau0, p0 = 40 kPa; `friction` is the coefficient it comes on top of.
    """

    scales_with_modulus: ClassVar[bool] = False
    half_full_mpa = 0.04

    def __init__(self, shear_strength_mpa: float, friction: float) -> None:
        self.shear_strength_mpa = shear_strength_mpa
        self.friction = friction

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray:
        """Factor (n) on the friction coefficient that gives the sum of both."""
        room_mpa = np.maximum(pressure_mpa, 0.0) + self.half_full_mpa
        return np.asarray(1.0 + self.shear_strength_mpa / (self.friction * room_mpa))


class TumbledEdges(Effect):
    """C8: objects smoothed in a tumbler: large ones roll harder, so their edges get rounder, and no face moves.

    `extra_radius_mm` on an object whose smallest length is 30 mm, in proportion to that length on others.
    """

    usual_mm = 30.0

    def __init__(self, extra_radius_mm: float) -> None:
        self.extra_radius_mm = extra_radius_mm

    def modify_object(self, obj: RigidObject) -> RigidObject:
        """The object after the tumbler."""
        return with_rounder_edges(obj, self.extra_radius_mm * min(list_sizes_mm(obj).values()) / self.usual_mm)


class WarpedFingers(Effect):
    """C9: fingers that warped towards each other in the print, the more the taller: `half_gap_mm` (h / 105 mm)^2."""

    def __init__(self, half_gap_mm: float, design: Design) -> None:
        self.half_gap_mm = half_gap_mm * (design.height_mm / USUAL_HEIGHT_MM) ** 2

    def finger_stop_mm(self) -> float:
        """Distance of the stop from the plane between the fingers, mm."""
        return self.half_gap_mm


class LeaningJaws(Effect):
    """A1: jaws whose guides jam, the more the taller the finger: F (1 - 0.15 h / 105 mm), `max_force_n` F."""

    jammed_share = 0.15

    def __init__(self, max_force_n: float, design: Design) -> None:
        self.jaw_force_n = max_force_n * (1.0 - self.jammed_share * design.height_mm / USUAL_HEIGHT_MM)

    def closing_force_limit_n(self) -> float:
        """Force that the guides leave, N per jaw."""
        return self.jaw_force_n


class TiltingMount(Effect):
    """G5: a mount that tilts: a finger gives way by C (h / 105 mm)^2 per force, `compliance_mm_per_n` C."""

    scales_with_modulus: ClassVar[bool] = False

    def __init__(self, compliance_mm_per_n: float, design: Design) -> None:
        self.compliance_mm_per_n = compliance_mm_per_n * (design.height_mm / USUAL_HEIGHT_MM) ** 2

    def base_compliance_mm_per_n(self) -> float:
        """How far a finger's base stays behind per force."""
        return self.compliance_mm_per_n


class SquashedLayers(Effect):
    """G1: layers squashed by those above: cavities shrink all around by `offset_mm` (1 - z / 2 h) / 2.

    Outer surfaces stay. z is the middle of a cavity, h the height of the finger. Negative offsets widen the cavities.
    """

    def __init__(self, offset_mm: float) -> None:
        self.offset_mm = offset_mm

    def modify_profile(self, profile: Polygon, design: Design) -> Polygon:
        """Planar profile (mm) as printed."""
        if self.offset_mm == 0.0:
            return profile
        made = []
        for ring in profile.interiors:
            cavity = Polygon(ring)
            fading = 1.0 - 0.5 * cavity.centroid.y / design.height_mm
            made.append(cavity.buffer(-0.5 * self.offset_mm * fading, join_style="mitre"))
        body = Polygon(profile.exterior).difference(unary_union(made))
        return max(body.geoms, key=lambda part: part.area) if isinstance(body, MultiPolygon) else body


class CuredStiffening(Effect):
    """M3: thin walls cure more and stiffen more: `stiffening` times (2.5 mm / t)^2, t the front wall.

    The solver has one stiffening energy, so the law itself is the catalogue's; what differs between tools is not.
    """

    def __init__(self, stiffening: float, design: Design) -> None:
        front_mm = take_fin_ray(design, "the hidden law of curing").front_thickness_mm
        self.stiffening = stiffening * (USUAL_THICKNESS_MM / front_mm) ** 2

    def strain_stiffening(self) -> float:
        """Coefficient of the quadratic energy."""
        return self.stiffening


class StrandedRibs(Effect):
    """M7: ribs of few strands are stiffer than of many: 1 + `excess` (2.5 mm / t)^2, t the rib's thickness."""

    def __init__(self, excess: float) -> None:
        self.excess = excess

    def stiffness_factor(self, points: np.ndarray, design: Design) -> np.ndarray:
        """Factor (n) on the modulus of elements at `points` (n, 2) of the section, mm."""
        design = take_fin_ray(design, "the hidden law of strands")
        excess = self.excess * (USUAL_THICKNESS_MM / design.rib_thickness_mm) ** 2
        return np.asarray(1.0 + excess * is_in_rib(points, design))


class SaggingRibs(Effect):
    """G2: ribs that sag in the print, all of them towards the base: `bow_mm` (L / L0)^2 in the middle of a rib.

    L is how long the rib is, L0 the same of the lowest one; the shape is that of a clamped beam, (1 - cos 2 pi s) / 2.
    """

    def __init__(self, bow_mm: float) -> None:
        self.bow_mm = bow_mm

    def modify_section(self, points: np.ndarray, design: Design) -> np.ndarray:
        """Points (n, 2) of the section as printed, mm."""
        if self.bow_mm == 0.0:
            return points
        design = take_fin_ray(design, "the hidden law of sagging ribs")
        rib, near, across = find_ribs(points, design)
        # The middle of a rib is half way between the walls: how far it is from the front wall goes with its length.
        half_mm = rib_centres(design)[:, 0] - design.front_thickness_mm
        shape = 0.5 * (1.0 - np.cos(2.0 * np.pi * cavity_share(points, design)))
        return np.asarray(points - (self.bow_mm * near * shape * (half_mm / half_mm[0])[rib] ** 2)[:, None] * across)
