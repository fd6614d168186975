"""What the lab's page asks of a bench that a person moves by hand, one small step after the other.

`hardware.by_hand` (the gantry) and `hardware.arm.by_hand` are two. The checks are the same for both: a step is
refused where something could fall or be hit.
"""

from dataclasses import dataclass
from typing import Literal, Protocol

from pydantic import Field

from fast.hardware.grasp_bench import Leave
from fast.hardware.parts.safe_state import Verb
from fast.models.errors import UsageError
from fast.models.records import Record

StepVerb = Literal["home", "tare", "jog", "open", "close", "park", "recover"]
LONGEST_STEP_MM = {"x": 100.0, "y": 100.0, "z": 20.0}
LOW_STEP_MM = 5.0  # of x and y with the fingers among the objects
HELD_MM = 0.5  # above where the gripper was closed, from which on something hangs in the air


class HandStep(Record):
    """One step by hand."""

    verb: StepVerb
    axis: Literal["x", "y", "z"] = "z"
    distance_mm: float = Field(default=0.0, description="of a jog; up is positive")
    is_held: bool = Field(default=False, description="a person holds what hangs in the gripper")


@dataclass(frozen=True)
class BenchReading:
    """What the bench shows now."""

    x_mm: float
    """Of the head in the box, from the left."""
    y_mm: float
    """From the front."""
    z_mm: float
    """Up."""
    force_n: float
    """Net force of the load cell."""
    pressure_psi: float | None
    """Of the gripper; None where nothing measures it."""
    is_gripping: bool
    """The gripper valve is on."""
    has_tool: bool
    """A tool hangs on the head."""
    fault: str
    """Why it stands in its safe state; empty: it may move."""


@dataclass(frozen=True)
class Stand:
    """What bounds the next step; places in mm, x, y, z."""

    place_mm: tuple[float, float, float]
    """Where the head or flange is."""
    low_mm: tuple[float, float, float]
    """Of the box in which it may move."""
    high_mm: tuple[float, float, float]
    """The opposite corner."""
    free_z_mm: float
    """From this height on it goes sideways over everything."""
    is_gripping: bool
    """The gripper is closed."""
    rest_z_mm: float | None
    """Where the gripper closed; None: not by hand."""
    part: str = "head"
    """What moves, in a sentence."""
    box: str = "the box"
    """What the box is."""
    below: str = "where long fingers meet objects"
    """What it is like below `free_z_mm`."""


def check_released(verb: str, is_gripping: bool) -> None:
    """Raise UsageError where what is to be done needs an open gripper; nothing has moved then."""
    if is_gripping:
        raise UsageError(f"the gripper is closed; open it before you {verb}. Nothing was moved.")


def check_jog(step: HandStep, stand: Stand) -> None:
    """Raise UsageError where a jog is too long, leaves the box or could hit something; nothing has moved then."""
    axis, longest_mm = step.axis, LONGEST_STEP_MM[step.axis]
    place = "xyz".index(axis)
    here_mm, low_mm, high_mm = stand.place_mm[place], stand.low_mm[place], stand.high_mm[place]
    target_mm = here_mm + step.distance_mm
    outside_mm, was_outside_mm = (max(low_mm - at_mm, at_mm - high_mm, 0.0) for at_mm in (target_mm, here_mm))
    if not 0 < abs(step.distance_mm) <= longest_mm:
        raise UsageError(f"a step along {axis} is at most {longest_mm:g} mm, and not 0; nothing was moved.")
    if outside_mm > 0 and outside_mm >= was_outside_mm:  # whoever stands outside may come back
        raise UsageError(
            f"{axis} {target_mm:.1f} mm is outside {stand.box}, {low_mm:g} to {high_mm:g} mm; nothing was moved."
        )
    if axis != "z" and stand.is_gripping:
        raise UsageError(f"the closed gripper may hold what stands on a mount; {axis} does not move.")
    z_mm, free_mm = stand.place_mm[2], stand.free_z_mm
    if axis != "z" and z_mm < free_mm - 0.01 and abs(step.distance_mm) > LOW_STEP_MM:
        raise UsageError(
            f"the {stand.part} is at z {z_mm:.1f} mm, {stand.below}: raise it to {free_mm:g} mm or move {axis} at most "
            f"{LOW_STEP_MM:g} mm at once. Nothing was moved."
        )


def check_lowered(stand: Stand) -> None:
    """Raise UsageError where something may hang in the closed gripper; nothing has moved then."""
    z_mm, rest_z_mm = stand.place_mm[2], stand.rest_z_mm
    if rest_z_mm is None or z_mm > rest_z_mm + HELD_MM:
        where = f"to z {rest_z_mm:.1f} mm, where it closed" if rest_z_mm is not None else "onto something"
        raise UsageError(
            f"something may hang in the closed gripper at z {z_mm:.1f} mm: lower it {where}, or say that you hold it. "
            "Nothing was moved."
        )


class Hand(Protocol):
    """A connected bench that a person moves step by step; a campaign's plan is not touched by it."""

    def set_leave(self, leave: Leave) -> None:
        """Have `leave` asked before every motion from now on."""
        ...

    def ask(self, verb: Verb) -> None:
        """Stop now, from any thread."""
        ...

    def pass_time(self, duration_s: float) -> None:
        """Let the time of a bench pass that moves only while somebody waits; does nothing elsewhere."""
        ...

    def read(self) -> BenchReading:
        """Read place, force, pressure and sensors as they are now.

        Raises:
            DeviceError: a device does not answer.
        """
        ...

    def do(self, step: HandStep) -> str:
        """Make a step; a sentence says what was done.

        Raises:
            UsageError: something could fall or be hit; nothing moved.
            DeviceError: the bench could not, and stands in its safe state.
        """
        ...
