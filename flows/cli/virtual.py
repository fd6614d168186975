"""`fast virtual`: a virtual bench that stays up, for drivers and programs outside FAST."""

import signal
import threading
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from flows.cli.common import say

if TYPE_CHECKING:
    from hardware.tools import MountedTool

Designs = Annotated[list[Path] | None, Parameter(negative="", help="JSON designs for slots 0, 1, ...")]

app = App(name="virtual", help="A virtual bench that stays up.")


@app.command
def start(
    world: Path,
    *,
    design: Designs = None,
    speed_up: Annotated[float, Parameter(help="how much faster than real time")] = 1.0,
    plc_port: Annotated[int, Parameter(help="port of the PLC; 0 takes a free one")] = 0,
    transmitter_port: Annotated[int, Parameter(help="port of the load-cell transmitter; 0 takes a free one")] = 0,
) -> None:
    """Serve a world's gantry, PLC and load cell on a pty and two loopback ports until Ctrl-C.

    Without --design, every slot of the rack holds the best published design.
    """
    from flows.launch import read_world
    from hardware.bench import open_virtual_servers
    from hardware.clock import ScaledClock
    from hardware.world.physics import simulate_request

    spec, tools, clock = read_world(world), rack(design), ScaledClock(speed_up)
    with open_virtual_servers(
        spec, tools, simulate_request, clock, plc_port=plc_port, transmitter_port=transmitter_port
    ) as bench:
        for name, address in asdict(bench.endpoints).items():
            say(f"{name:<18} {address}")
        say("Ctrl-C stops the bench")
        wait_for_signal()


def rack(designs: list[Path] | None) -> "dict[int, MountedTool]":
    """Tools of a rack from design files, or ten of the best published design."""
    from flows.cli.simulate import read_design
    from hardware.tools import MountedTool
    from models.ids import tool_label

    chosen = [read_design(path) for path in designs] if designs else [read_design(None)] * 10
    return {slot: MountedTool(tool_id=tool_label(0, slot), design=design) for slot, design in enumerate(chosen)}


def wait_for_signal() -> None:
    """Block until SIGINT or SIGTERM, so that the caller's clean-up runs on either."""
    asked = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.set())
    while not asked.wait(1.0):
        pass
