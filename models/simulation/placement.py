"""Where the object stands between the fingers: its primitives there, the symmetry that is left, and places that fail.

Three symmetries save work. In the mirror y = 0 half a finger is enough. In the mirror x = 0, and by the half turn
about z, the left finger is the right one again, so one finger is solved and counts twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fast.models.errors import SimulationFailed
from fast.models.objects.primitives import bounds, moved, rotated, turn_about_z
from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, GraspSetup, Placement

Side = Literal["right", "left"]

CENTRED = Placement()
AXES = "xyz"
ALLOWED_OVERLAP_MM = 0.02  # a finger this near to the object counts as touching it


@dataclass(frozen=True)
class GraspSymmetry:
    """Of object, placement and rolled fingers together.

    `mirror_x`, `mirror_y`: in the plane x = 0, y = 0. `half_turn`: by 180 deg about the vertical axis.
    """

    mirror_x: bool
    mirror_y: bool
    half_turn: bool

    @property
    def sides(self) -> tuple[Side, ...]:
        """The fingers that must be solved: the right one alone where the left one is the right one again."""
        return ("right",) if self.mirror_x or self.half_turn else ("right", "left")

    @property
    def is_only_half_turn(self) -> bool:
        """True if the left finger is the right one after a half turn, but not its mirror image."""
        return self.half_turn and not self.mirror_x


def find_symmetry(obj: RigidObject, placement: Placement) -> GraspSymmetry:
    """Find what the placement leaves of the object's symmetry.

    A roll turns both fingers the same way, so no mirror maps one on the other, but the half turn does.
    """
    is_straight = placement.roll_deg == 0.0 and (placement.yaw_deg == 0.0 or obj.is_round)
    is_middle_x, is_middle_y = placement.offset_x_mm == 0.0, placement.offset_y_mm == 0.0
    return GraspSymmetry(
        mirror_x=obj.mirror_x and is_straight and is_middle_x,
        mirror_y=obj.mirror_y and is_straight and is_middle_y,
        half_turn=obj.mirror_x and obj.mirror_y and is_middle_x and is_middle_y,
    )


def needs_full_width(obj: RigidObject, placement: Placement = CENTRED) -> bool:
    """Return whether half a finger is not enough: the grasp is not its own mirror image in y = 0."""
    return not find_symmetry(obj, placement).mirror_y


def place(obj: RigidObject, placement: Placement) -> np.ndarray:
    """Place the object's primitives (n_rows, N_COLUMNS) where it stands: turned about its own axis, then shifted."""
    rows = obj.primitives
    if placement.yaw_deg != 0.0 and not obj.is_round:
        rows = rotated(rows, turn_about_z(placement.yaw_deg))
    return moved(rows, offset_mm(placement))


def offset_mm(placement: Placement) -> np.ndarray:
    """Return the shift (3) of the object."""
    return np.array([placement.offset_x_mm, placement.offset_y_mm, placement.offset_z_mm])


def describe_placement(placement: Placement) -> str:
    """Describe what is not at its nominal place, such as ` at yaw_deg 5, offset_y_mm 1`; empty if nothing is."""
    moved_from = {name: value for name, value in placement.model_dump().items() if value != 0.0}
    return " at " + ", ".join(f"{name} {value:g}" for name, value in moved_from.items()) if moved_from else ""


def check_reach(obj: RigidObject, placement: Placement, design: Design, setup: GraspSetup) -> None:
    """Refuse an offset that takes the object out of the space between the open fingers, so that they close on nothing.

    That space reaches from finger to finger in x, over the width of the fingers in y, and from their tips to their
    bases in z. Boxes round object and fingers decide. An object that the fingers miss at its nominal place too (above
    a flat one, say) is a legal grasp.

    Raises:
        SimulationFailed: reason `object_outside`.
    """
    roll = np.radians(abs(placement.roll_deg))
    half_width_mm = 0.5 * (design.width_mm * np.cos(roll) + design.length_mm * np.sin(roll))
    half = np.array([0.5 * setup.open_gap_mm, half_width_mm])
    space_low = np.array([*-half, -setup.tip_below_mm])
    space_high = np.array([*half, design.height_mm - setup.tip_below_mm])
    shift = offset_mm(placement)
    low, high = bounds(place(obj, placement))
    for axis, name in enumerate(AXES):
        least, most = space_low[axis] - high[axis] + shift[axis], space_high[axis] - low[axis] + shift[axis]
        if least < shift[axis] < most or not least < 0.0 < most:
            continue
        raise SimulationFailed(
            f"Object {obj.object_id} ({obj.name}) is outside the fingers: with offset_{name}_mm {shift[axis]:g} it "
            f"reaches from {low[axis]:.1f} to {high[axis]:.1f} mm in {name}, they from {space_low[axis]:.1f} to "
            f"{space_high[axis]:.1f} mm, so they would close on nothing; take an offset between {least:.1f} and "
            f"{most:.1f} mm.",
            reason="object_outside",
        )


def check_overlap(obj: RigidObject, placement: Placement, setup: GraspSetup, gaps_mm: Sequence[float]) -> None:
    """Refuse a grasp that begins with a finger inside the object; `gaps_mm`: of each open finger, negative inside.

    Raises:
        SimulationFailed: reason `overlap_at_start`.
    """
    depth = -min(gaps_mm)
    if depth <= ALLOWED_OVERLAP_MM:
        return
    remedy = "" if placement == CENTRED else "bring the object nearer to its nominal place, or "
    raise SimulationFailed(
        f"A finger and object {obj.object_id} ({obj.name}{describe_placement(placement)}) overlap by {depth:.2f} mm "
        f"before closing, at most {ALLOWED_OVERLAP_MM:g} mm is allowed; open_gap_mm is {setup.open_gap_mm:g}; {remedy}"
        f"open the jaws to {setup.open_gap_mm + 2.0 * depth:.1f} mm or more.",
        reason="overlap_at_start",
    )
