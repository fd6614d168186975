"""What the lab's page asks of a bench that a person moves by hand, one small step after the other.

`hardware.by_hand` (the gantry) and `hardware.arm.by_hand` are two; each refuses a step where something could fall or be
hit.
"""

from dataclasses import dataclass
from typing import Literal, Protocol

from pydantic import Field

from fast.hardware.grasp_bench import Leave
from fast.hardware.parts.safe_state import Verb
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
        """Place, force, pressure and sensors as they are now.

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
