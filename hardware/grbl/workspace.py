"""Workspace coordinates of the gantry, and their mapping to GRBL's machine coordinates.

Workspace: x 0..1500, y 0..1500, z 0..180 mm, z up, z = 0 lowest. Machine coordinates of a homed GRBL are negative:
an axis at its + end stands at minus the pull-off. The two differ by a shift only: `workspace = MPos - origin`.
With the lab profile (travel 1506 x 1506 x 186, pull-off 3) the origin is (-1503, -1503, -183): the top of each axis
is where homing leaves it.

The box has the size that the bench file says. A controller with less travel has a smaller box, not a shifted one; the
shift is taken from the MPos that the controller shows after homing, since builds differ (HOMING_FORCE_SET_ORIGIN).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from fast.hardware.grbl.messages import Vector
from fast.hardware.grbl.profile import GrblProfile
from fast.models.errors import InterlockError

WORKSPACE_SIZE_MM: Vector = (1500.0, 1500.0, 180.0)
AXIS_NAMES = "xyz"
BOX_SLACK_MM = 1e-6  # rounding


@dataclass(frozen=True)
class Workspace:
    """A box of `size_mm` whose lowest corner is machine position `origin_mm`."""

    origin_mm: Vector
    size_mm: Vector

    @classmethod
    def from_homed(
        cls, profile: GrblProfile, homed_mm: Sequence[float], size_mm: Sequence[float] = WORKSPACE_SIZE_MM
    ) -> "Workspace":
        """Return the box of a controller that shows `homed_mm` after homing."""
        origin, size = [], []
        for axis, homed in enumerate(homed_mm[: len(AXIS_NAMES)]):
            usable = min(size_mm[axis], profile.travel_mm[axis] - profile.pull_off_mm)
            origin.append(homed - usable if profile.homes_to_plus_end(axis) else homed)
            size.append(usable)
        return cls(tuple(origin), tuple(size))

    @classmethod
    def nominal(cls, profile: GrblProfile, size_mm: Sequence[float] = WORKSPACE_SIZE_MM) -> "Workspace":
        """Return the box before homing: MPos as GRBL sets it by default."""
        homed_mm = [
            -profile.pull_off_mm if profile.homes_to_plus_end(axis) else profile.pull_off_mm - profile.travel_mm[axis]
            for axis in range(len(AXIS_NAMES))
        ]
        return cls.from_homed(profile, homed_mm, size_mm)

    def to_machine(self, place_mm: Sequence[float]) -> Vector:
        """Return the machine position of a workspace place."""
        return tuple(place + origin for place, origin in zip(place_mm, self.origin_mm, strict=True))

    def from_machine(self, place_mm: Sequence[float]) -> Vector:
        """Return the workspace place of a machine position (axes beyond z are ignored)."""
        return tuple([place - origin for place, origin in zip(place_mm, self.origin_mm, strict=False)])

    def check(self, place_mm: Sequence[float]) -> None:
        """Refuse a place outside the box.

        Raises:
            InterlockError: names the axis, its value and its limits.
        """
        for name, place, size in zip(AXIS_NAMES, place_mm, self.size_mm, strict=True):
            if not -BOX_SLACK_MM <= place <= size + BOX_SLACK_MM:
                raise InterlockError(
                    f"Target {name} = {place:.3f} mm is outside the workspace 0..{size:g} mm; nothing was sent, "
                    "correct the plan."
                )
