"""Laws of contact and objects that a truth may hide, each another than the catalogue's of the same physics."""

from typing import ClassVar

import numpy as np

from fast.flows.challenge.hidden.lab_laws import tool_draws
from fast.models.objects.rigid import RigidObject
from fast.models.simulation.effects.base import Effect
from tests.studies.gap.grasp_laws.parts import list_sizes_mm, with_rounder_edges


class HertzFriction(Effect):
    """mu(p) = mu (1 + a) / (1 + a sqrt(p / p0)), `strength` a and p0 = 50 kPa (C4: a power law in the catalogue).

    Bounded at no pressure, where a power law is cut off.
    """

    scales_with_modulus: ClassVar[bool] = False
    reference_mpa = 0.05

    def __init__(self, strength: float) -> None:
        self.strength = strength

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray:
        """Factor (n) on the friction coefficient."""
        root = np.sqrt(np.maximum(pressure_mpa, 0.0) / self.reference_mpa)
        return np.asarray((1.0 + self.strength) / (1.0 + self.strength * root))


class SaturatingAdhesion(Effect):
    """Shear stress tau0 (1 - exp(-p / p0)) on top of Coulomb's, as contact spots fill (C5: constant in the catalogue).

    `shear_strength_mpa` tau0, p0 = 20 kPa; `friction` is the coefficient it comes on top of.
    """

    scales_with_modulus: ClassVar[bool] = False
    filling_mpa = 0.02
    least_mpa = 1e-4

    def __init__(self, shear_strength_mpa: float, friction: float) -> None:
        self.shear_strength_mpa = shear_strength_mpa
        self.friction = friction

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray:
        """Factor (n) on the friction coefficient that gives the sum of both."""
        pressure = np.maximum(pressure_mpa, self.least_mpa)
        stress = -self.shear_strength_mpa * np.expm1(-pressure / self.filling_mpa)
        return np.asarray(1.0 + stress / (self.friction * pressure))


class WornEdges(Effect):
    """Edges rounder by `extra_radius_mm`, not on all objects alike (30 % sd), and bodies smaller by a tenth of it.

    C8: the catalogue rounds all objects alike and leaves their faces where they are.
    """

    object_sd, shrinking = 0.3, 0.1

    def __init__(self, extra_radius_mm: float) -> None:
        self.extra_radius_mm = extra_radius_mm

    def modify_object(self, obj: RigidObject) -> RigidObject:
        """The object as it was made."""
        if obj.parameters.get("rounding_mm") is None or self.extra_radius_mm == 0.0:
            return obj
        spread = 1.0 + self.object_sd * float(tool_draws(obj.object_id, 0xED6E, 1)[0])
        made = {name: value - self.shrinking * self.extra_radius_mm for name, value in list_sizes_mm(obj).items()}
        shrunk = obj.model_copy(update={"parameters": obj.parameters | made})
        return with_rounder_edges(shrunk, spread * self.extra_radius_mm)


class FlashedFingers(Effect):
    """Flash on the fingers that keeps them apart by `half_gap_mm`, higher or lower by tool (15 % sd) (C9)."""

    tool_sd = 0.15

    def __init__(self, half_gap_mm: float, tool_seed: int) -> None:
        self.half_gap_mm = half_gap_mm * float(1.0 + self.tool_sd * tool_draws(tool_seed, 0xF1A, 1)[0])

    def finger_stop_mm(self) -> float:
        """Distance of the stop from the plane between the fingers, mm."""
        return self.half_gap_mm


class ScaledObjects(Effect):
    """Objects printed by a wrong factor, `scale`: a slip in a slicer that no catalogue of physics lists."""

    def __init__(self, scale: float) -> None:
        self.scale = scale

    def modify_object(self, obj: RigidObject) -> RigidObject:
        """The object with all its sizes scaled; its edges stay as sharp."""
        made = {name: value * self.scale for name, value in list_sizes_mm(obj).items()}
        return obj.model_copy(update={"parameters": obj.parameters | made})


class SoftObjects(Effect):
    """Objects of foam, which give way by their pressure over `foundation_n_per_mm3`; the simulator's are rigid.

    The foundation is in series with the usual contact. How stiff a contact is is a setting of the solver, which
    `tests.studies.gap.grasp_laws.truth` makes for this class.
    """

    def __init__(self, foundation_n_per_mm3: float) -> None:
        self.foundation_n_per_mm3 = foundation_n_per_mm3

    def in_series(self, stiffness_n_per_mm3: float) -> float:
        """Stiffness of a contact of this stiffness on the foundation."""
        return 1.0 / (1.0 / stiffness_n_per_mm3 + 1.0 / self.foundation_n_per_mm3)


class ObjectSurfaces(Effect):
    """Objects of unlike surfaces: friction differs from object to object by `spread` sd, in no relation to shape."""

    def __init__(self, spread: float, object_id: int) -> None:
        self.factor = max(1.0 + spread * float(tool_draws(object_id, 0x50F, 1)[0]), 0.1)

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> float:
        """Factor on the friction coefficient on this object."""
        return self.factor
