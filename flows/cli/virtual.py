"""`fast virtual`: a virtual bench that stays up, for drivers and programs outside FAST."""

import json as json_module
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.common import AsJson, make_app, say
from fast.models.errors import UsageError

if TYPE_CHECKING:
    from fast.hardware.tools.mounted import MountedTool
    from fast.hardware.virtual.world.physics import Physics, PhysicsRequest
    from fast.models.records import GraspSimulation

Designs = Annotated[
    list[Path] | None,
    Parameter(
        negative="",
        help="JSON file of the design in slot 0, then of slot 1, ... Default: the best published in all ten.",
    ),
]

PORT = Number(gte=0, lte=65535)

app = make_app(name="virtual", help="A virtual bench that stays up.")


@app.command
def start(
    world: Annotated[Path, Parameter(help="World file, e.g. worlds/quick.toml.")],
    *,
    design: Designs = None,
    speed_up: Annotated[float, Parameter(help="How much faster than real time.", validator=Number(gt=0))] = 1.0,
    plc_port: Annotated[int, Parameter(help="Port of the PLC; 0 takes a free one.", validator=PORT)] = 0,
    transmitter_port: Annotated[
        int, Parameter(help="Port of the load-cell transmitter; 0 takes a free one.", validator=PORT)
    ] = 0,
    like: Annotated[
        Path | None, Parameter(help="Bench file: the virtual bench has its layout, gantry settings, transmitter mode.")
    ] = None,
    continuous: Annotated[
        bool, Parameter(negative="", help="The transmitter's serial port sends strings instead of Modbus RTU.")
    ] = False,
    fault: Annotated[
        list[str] | None,
        Parameter(negative="", help="NAME@SECONDS: a fault that begins then, e.g. low_air@30; may be repeated."),
    ] = None,
    json: AsJson = False,
) -> None:
    """Serve a world's gantry, PLC and load cell on a pty and two loopback ports until Ctrl-C."""
    from fast.hardware.bench import BenchSettings, open_virtual_servers
    from fast.hardware.clock import ScaledClock
    from fast.tasks.campaign.setup import read_bench, read_world

    spec, tools, clock = read_world(world), rack(design), ScaledClock(speed_up)
    settings = BenchSettings() if like is None else read_bench(like)
    if continuous:
        settings = settings.model_copy(update={"transmitter_mode": "continuous"})
    faults = [read_fault(text) for text in fault or []]
    ports = plc_port, transmitter_port
    with solver() as physics, open_virtual_servers(spec, tools, physics, clock, ports, settings) as bench:
        asked = watch_signals()
        for name, time_s in faults:
            bench.inject_at(name, time_s)
        addresses = asdict(bench.endpoints)
        if json:
            say(json_module.dumps(addresses))
        else:
            lines = [f"{name:<24} {address}" for name, address in addresses.items()]
            say("\n".join([*lines, "Ctrl-C stops the bench"]))
        wait_for(asked)


@app.command
def arm(
    world: Annotated[Path, Parameter(help="World file, e.g. worlds/quick.toml.")],
    *,
    file: Annotated[Path, Parameter(help="Bench file to write, with this arm's address and places.")],
    lake: Annotated[
        str | None, Parameter(help="Lake whose campaign says which tools hang in the rack; default: the designs.")
    ] = None,
    config: Annotated[
        Path | None, Parameter(help="Campaign config whose own objects stand on the bench; default: the 36.")
    ] = None,
    design: Designs = None,
    host: Annotated[str, Parameter(help="Address on this computer; port 30004 must be free there.")] = "127.0.0.1",
    speed_up: Annotated[float, Parameter(help="How much faster than real time.", validator=Number(gt=0))] = 1.0,
    json: AsJson = False,
) -> None:
    """Serve a Universal Robots arm in a world, by RTDE and URScript, until Ctrl-C."""
    from fast.hardware.parts.layout import BenchLayout
    from fast.hardware.virtual.arm.controller import VirtualArm
    from fast.hardware.virtual.arm.server import ArmServer
    from fast.tasks.bench.arm_rack import read_rack, write_bench_file
    from fast.tasks.campaign.config import load_config
    from fast.tasks.campaign.setup import read_world

    fresh = None if lake is None else partial(read_rack, lake)
    layout = BenchLayout() if config is None else load_config(config).objects.stand_on(BenchLayout())
    with solver() as physics:
        asked = watch_signals()
        server = ArmServer(VirtualArm(read_world(world), rack(design), physics, fresh, layout), host, speed_up)
        server.start()
        try:
            write_bench_file(file, server.arm.settings(host, server.script_port))
            addresses = {"host": host, "rtde_port": 30004, "script_port": server.script_port, "file": str(file)}
            words = f"arm at {host}, RTDE port 30004, URScript port {server.script_port}; bench file {file}"
            say(json_module.dumps(addresses) if json else f"{words}\nCtrl-C stops it")
            wait_for(asked)
        finally:
            server.stop()


@contextmanager
def solver() -> "Iterator[Physics]":
    """Run the physics of a virtual bench in a process of its own, compiled before the bench opens.

    A thread that solves slows those of the devices: on a busy machine the first grasp lost the PLC.
    """
    from fast.hardware.virtual.world.physics import simulate_request, solve_elsewhere
    from fast.models.objects.catalogue import get_object
    from fast.models.simulation.grasp import compile_simulator
    from fast.tasks.simulation.pool import Worker

    worker = Worker()

    def solve(request: "PhysicsRequest") -> "GraspSimulation":
        return worker.call(solve_elsewhere, simulate_request, get_object(request.object_id), request)

    try:
        worker.call(compile_simulator)
        yield solve
    finally:
        worker.restart()  # it ignores Ctrl-C, and nobody waits for its answer


def read_fault(text: str) -> tuple[str, float]:
    """Read name and time of a fault given as NAME@SECONDS.

    Raises:
        UsageError: unknown name, or no time.
    """
    from fast.hardware.virtual.faults import find_fault

    name, _, time_s = text.partition("@")
    find_fault(name)
    try:
        return name, float(time_s)
    except ValueError as error:
        raise UsageError(f"`{text}` has no time; write NAME@SECONDS, e.g. {name}@30.") from error


def rack(designs: list[Path] | None) -> "dict[int, MountedTool]":
    """Return the tools of a rack from design files, or ten of the best published design.

    Raises:
        UsageError: a file that is no design, or more designs than slots.
    """
    from fast.flows.cli.simulate import read_design
    from fast.hardware.parts.layout import N_SLOTS
    from fast.hardware.tools.mounted import MountedTool
    from fast.models.ids import tool_label

    chosen = [read_design(path) for path in designs] if designs else [read_design(None)] * N_SLOTS
    if len(chosen) > N_SLOTS:
        raise UsageError(f"{len(chosen)} designs were given, the rack has {N_SLOTS} slots; give fewer --design.")
    return {slot: MountedTool(tool_id=tool_label(0, slot), design=design) for slot, design in enumerate(chosen)}


def watch_signals() -> threading.Event:
    """Return an event that SIGINT and SIGTERM set from now on, so that the caller's clean-up runs on either."""
    asked = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.set())
    return asked


def wait_for(asked: threading.Event) -> None:
    """Block until the event is set."""
    while not asked.wait(1.0):
        pass
