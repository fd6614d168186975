"""What a campaign asks of a bench, and no more: whoever has these methods can be driven by it.

`hardware.bench.Bench` (the gantry) and `hardware.arm.bench.ArmBench` are two; `docs/how-to/write-a-bench-driver.md`
says how to write another, and `tests/hardware/arm/bench_contract.py` tests one.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

from fast.hardware.parts.safe_state import Verb
from fast.hardware.questions import Ask
from fast.hardware.station.recorder import GraspInView
from fast.hardware.station.station import Item, MeasuredGrasp
from fast.models.records import GraspSetup

Leave = Callable[[], None]
"""Raises when this process may no longer move the bench, because another one has taken it over."""


class GraspBench(Protocol):
    """An open bench with its tools in the rack."""

    @property
    def wire_session(self) -> str | None:
        """Name of the logs of what was said to the devices in this session; None where there are none."""
        ...

    def set_leave(self, leave: Leave) -> None:
        """Have `leave` asked before every motion from now on."""
        ...

    def set_ask(self, ask: Ask) -> None:
        """Have a person asked with `ask(question)` from now on, where the bench cannot decide by itself."""
        ...

    def ask(self, verb: Verb) -> None:
        """Stop or abort now, from any thread: what is under way ends in the safe state with `StopAskedError`."""
        ...

    def measure_tool(
        self,
        slot: int,
        plan: Sequence[Item],
        setup: GraspSetup,
        on_grasp: Callable[[MeasuredGrasp], None],
        should_stop: Callable[[], bool],
    ) -> None:
        """Take the tool of a slot, make the planned grasps in order, hang the tool back.

        `on_grasp` gets each grasp as soon as it is measured, a failed one with its reason; `should_stop` is asked
        before each and ends the plan early, with the tool hung back. Take each grasp from `plan` when the one before it
        is over: what a person leaves out meanwhile is then passed over.

        Raises:
            UsageError: the plan cannot be carried out; nothing has moved.
            DeviceError: the bench cannot go on and stands in its safe state; the grasp in progress was given to
                `on_grasp` as failed by the bench.
        """
        ...

    def present_grasp(self) -> GraspInView | None:
        """Return the grasp that is made now, or the last one; asked some ten times a second, from any thread."""
        ...

    def check_position(self) -> tuple[float, float, float]:
        """Check how far the head is from where it is believed to be, x, y, z in mm.

        Raises:
            DeviceError: too far; `LostStepsError` where the grasps since the last check are suspect.
        """
        ...
