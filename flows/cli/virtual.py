"""`fast virtual`: a virtual bench that stays up, for drivers and programs outside FAST."""

import signal
import threading
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from flows.cli.common import say

app = App(name="virtual", help="A virtual bench that stays up.")


@app.command
def start(
    world: Path,
    *,
    design: Annotated[list[Path] | None, Parameter(negative="", help="JSON designs for slots 0, 1, ...")] = None,
    speed_up: Annotated[float, Parameter(help="how much faster than real time")] = 1.0,
) -> None:
    """Serve a world's gantry, PLC and load cell on a pty and two loopback ports until Ctrl-C.

    Without --design, every slot of the rack holds the best published design.
    """
    from flows.cli.simulate import read_design
    from flows.launch import read_world
    from hardware.bench import MountedTool, open_virtual_bench
    from models.ids import tool_label

    designs = [read_design(path) for path in design] if design else [read_design(None)] * 10
    tools = {slot: MountedTool(tool_id=tool_label(0, slot), design=d) for slot, d in enumerate(designs)}
    with open_virtual_bench(read_world(world), tools, clock="real", speed_up=speed_up) as bench:
        for name, address in bench.endpoints.items():
            say(f"{name:<12} {address}")
        say("Ctrl-C stops the bench")
        wait_for_signal()


def wait_for_signal() -> None:
    """Block until SIGINT or SIGTERM, so that the caller's clean-up runs on either."""
    asked = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.set())
    while not asked.wait(1.0):
        pass
