"""One bench, real or virtual: the same drivers, connected, homed and closed safely."""

import logging
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from hardware.cell import GraspCell
from hardware.click.driver import ClickPlc
from hardware.clock import Clock, RealClock, ScaledClock, VirtualClock
from hardware.force_sensor import ForceSensor
from hardware.gantry import Gantry
from hardware.heartbeat import BeatingClock, HeartbeatThread
from hardware.laumas.driver import LaumasTransmitter
from hardware.layout import BenchLayout
from hardware.modbus import ModbusLink, rtu_link, tcp_link
from hardware.pneumatics import Pneumatics
from hardware.tool_changer import ToolChanger
from hardware.tools import MountedTool
from hardware.transport import SerialTransport
from hardware.virtual.bench import Endpoints, VirtualBench
from hardware.wire_files import GANTRY, LIMIT_BYTES, LOAD_CELL, PLC, WireFiles
from hardware.world.physics import Physics, simulate_request
from hardware.world.spec import World
from models.errors import DeviceError, FastError, InterlockError
from models.records import Record

logger = logging.getLogger(__name__)

_VIRTUAL_LOG_BYTES = 32_000_000  # of one device: a virtual bench says in a minute what a real one says in hours
_PHYSICS_PATIENCE_S = 1800.0  # real seconds a virtual gripper may wait for its physics


class BenchSettings(Record):
    """Addresses and figures of a real bench; the defaults are the paper's rig."""

    serial_port: str = Field(default="/dev/ttyACM0", description="GRBL on an Arduino Mega")
    plc_host: str = "192.168.0.10"
    plc_port: int = Field(default=502, ge=1, le=65535)
    transmitter_host: str = Field(default="192.168.0.20", description="Modbus TCP; unused with a serial port")
    transmitter_port: int = Field(default=502, ge=1, le=65535)
    transmitter_serial_port: str | None = Field(default=None, description="Modbus RTU instead of TCP")
    transmitter_baud_rate: int = Field(default=115200, ge=2400, le=115200)
    transmitter_filter: int = Field(default=0, ge=0, le=9, description="keypad setting, recorded; 0 or 1 for a lift")
    modbus_time_out_s: float = Field(default=1.0, gt=0, le=30)
    force_rate_hz: float = Field(default=80.0, ge=5, le=300)
    stale_after_s: float | None = Field(default=0.5, gt=0, le=10)
    supply_pressure_psi: float = Field(default=30.0, ge=5, le=60)
    pressure_time_out_s: float = Field(default=2.0, gt=0)
    tool_mass_kg: dict[int, float] = Field(default_factory=dict, description="weighed tools by slot; others estimated")
    layout: BenchLayout = BenchLayout()


@dataclass(frozen=True)
class Bench:
    """Connected devices of one bench.

    `virtual` is the bench behind the wire, or None on real hardware. `wire_session` names the wire logs of this session
    (the beginning of their files), or is None when they are kept in memory only.
    """

    gantry: Gantry
    plc: ClickPlc
    pneumatics: Pneumatics
    changer: ToolChanger
    force: ForceSensor
    cell: GraspCell
    clock: Clock
    settings: BenchSettings
    virtual: VirtualBench | None = None
    wire_session: str | None = None

    @property
    def endpoints(self) -> Endpoints:
        """Addresses the drivers use."""
        s = self.settings
        return Endpoints(
            s.serial_port,
            s.plc_host,
            s.plc_port,
            s.transmitter_host,
            s.transmitter_port,
            s.transmitter_serial_port,
        )


@contextmanager
def open_virtual_bench(
    world: World,
    tools: Mapping[int, MountedTool],
    physics: Physics = simulate_request,
    clock: Literal["lockstep", "real"] = "lockstep",
    speed_up: float = 1.0,
    layout: BenchLayout | None = None,
    log_folder: Path | None = None,
) -> Iterator[Bench]:
    """A virtual bench with its drivers connected and homed; stopped at the end of the `with`.

    `physics` answers one grasp (it is cached here); `clock` "real" runs by itself, `speed_up` times faster than the
    wall, "lockstep" moves only while drivers wait. `log_folder`: where the wire logs go; None keeps them in memory.
    """
    inner: Clock = VirtualClock() if clock == "lockstep" else ScaledClock(speed_up)
    with open_virtual_servers(world, tools, physics, inner, layout) as virtual:
        at = virtual.endpoints
        is_noisy = world.sensor.noise_sd_n >= 0.05  # several counts: identical readings can only be a frozen instrument
        settings = BenchSettings(
            serial_port=at.serial_port,
            plc_host=at.plc_host,
            plc_port=at.plc_port,
            transmitter_host=at.transmitter_host,
            transmitter_port=at.transmitter_port,
            modbus_time_out_s=10.0,
            force_rate_hz=world.sensor.rate_hz,
            stale_after_s=0.5 if is_noisy else None,
            pressure_time_out_s=2.0 if clock == "lockstep" else _PHYSICS_PATIENCE_S * speed_up,
            layout=layout or BenchLayout(),
        )
        with _open(settings, tools, inner, virtual, log_folder=log_folder) as bench:
            yield bench


@contextmanager
def open_virtual_servers(
    world: World,
    tools: Mapping[int, MountedTool],
    physics: Physics,
    clock: Clock,
    layout: BenchLayout | None = None,
    plc_port: int = 0,
    transmitter_port: int = 0,
) -> Iterator[VirtualBench]:
    """Only the devices of a virtual bench, for drivers elsewhere (`fast virtual start`); see `.endpoints`."""
    virtual = VirtualBench(world, tools, physics, clock, layout or BenchLayout())
    virtual.start(plc_port, transmitter_port)
    try:
        yield virtual
    finally:
        virtual.stop()


@contextmanager
def open_real_bench(
    settings: BenchSettings,
    tools: Mapping[int, MountedTool],
    clock: Clock | None = None,
    may_vent: bool = False,
    log_folder: Path | None = None,
) -> Iterator[Bench]:
    """The bench at these addresses with its drivers connected and homed. The caller has asked for leave to move.

    `clock` is the machine's; a virtual bench that runs faster in another process needs a `ScaledClock` as fast.
    `may_vent`: a person has looked at a gripper that an earlier host left closed, and lets it open before homing.
    `log_folder`: where the wire logs go; None keeps them in memory.

    Raises:
        InterlockError: emergency stop pressed, or the gripper is closed; nothing has moved.
        DeviceError: names every device that did not connect.
    """
    weighed = {
        slot: MountedTool(tool.tool_id, tool.design, settings.tool_mass_kg.get(slot, tool.mass_kg))
        for slot, tool in tools.items()
    }
    with _open(settings, weighed, clock or RealClock(), None, may_vent, log_folder) as bench:
        yield bench


@contextmanager
def _open(
    settings: BenchSettings,
    tools: Mapping[int, MountedTool],
    inner: Clock,
    virtual: VirtualBench | None,
    may_vent: bool = False,
    log_folder: Path | None = None,
) -> Iterator[Bench]:
    clock = BeatingClock(inner)
    plc_link = tcp_link("CLICK PLC", settings.plc_host, settings.plc_port, time_out_s=settings.modbus_time_out_s)
    plc = ClickPlc(plc_link, clock)
    cell_link = transmitter_link(settings)
    transmitter = LaumasTransmitter(cell_link, clock)
    force = ForceSensor(transmitter, clock, settings.force_rate_hz, settings.stale_after_s)
    line = SerialTransport(settings.serial_port)
    gantry = Gantry(line, clock)
    pneumatics = Pneumatics(plc, clock, settings.supply_pressure_psi, settings.pressure_time_out_s)
    changer = ToolChanger(gantry, plc, force, clock, tools, settings.layout)
    recorded: dict[str, float | str] = {
        "transmitter_filter": float(settings.transmitter_filter),
        "supply_pressure_psi": settings.supply_pressure_psi,
        "force_rate_hz": settings.force_rate_hz,
    }
    with ExitStack() as stack:
        files = _write_wires(stack, log_folder, virtual is not None, line, plc_link, cell_link)
        if files is not None:
            recorded["wire_log"] = files.session
        cell = GraspCell(gantry, plc, pneumatics, changer, force, clock, settings.layout, recorded)
        stack.callback(_close, force, plc, gantry)
        _connect({"PLC": plc.connect, "load cell": force.connect, "gantry": gantry.connect})
        _start_heartbeat(stack, clock, inner, plc)
        _make_ready_to_home(pneumatics, may_vent)
        gantry.home()
        wire_session = files.session if files is not None else None
        yield Bench(gantry, plc, pneumatics, changer, force, cell, clock, settings, virtual, wire_session)


def _write_wires(
    stack: ExitStack,
    folder: Path | None,
    is_virtual: bool,
    line: SerialTransport,
    plc_link: ModbusLink,
    cell_link: ModbusLink,
) -> WireFiles | None:
    """Write the logs of all three lines to files until the stack unwinds."""
    if folder is None:
        return None
    files = stack.enter_context(WireFiles(folder, _VIRTUAL_LOG_BYTES if is_virtual else LIMIT_BYTES))
    files.follow(line.log, GANTRY, line.name)
    files.follow(plc_link.log, PLC, plc_link.name)
    files.follow(cell_link.log, LOAD_CELL, cell_link.name)
    return files


def transmitter_link(settings: BenchSettings) -> ModbusLink:
    """The line to the weight transmitter: RTU with a serial port, else TCP."""
    name, time_out_s = "Weight transmitter", settings.modbus_time_out_s
    if settings.transmitter_serial_port is not None:
        return rtu_link(name, settings.transmitter_serial_port, settings.transmitter_baud_rate, time_out_s=time_out_s)
    return tcp_link(name, settings.transmitter_host, settings.transmitter_port, time_out_s=time_out_s)


def _start_heartbeat(stack: ExitStack, clock: BeatingClock, inner: Clock, plc: ClickPlc) -> None:
    if math.isinf(inner.wall_s(1.0)):
        clock.start(plc)
        stack.callback(clock.stop)
    else:
        heartbeat = HeartbeatThread(plc, inner)
        heartbeat.start()
        stack.callback(heartbeat.stop)


def _connect(connects: Mapping[str, Callable[[], object]]) -> None:
    """Connect every device; report all that failed in one message."""
    failures: list[str] = []
    first: FastError | None = None
    for name, connect in connects.items():
        try:
            connect()
        except FastError as error:
            failures.append(f"{name}: {error}")
            first = first or error
    if failures:
        raise DeviceError(" ".join(failures)) from first


def _make_ready_to_home(pneumatics: Pneumatics, may_vent: bool) -> None:
    """Homing lifts the head: a gripper that an earlier host left closed would pull its object along."""
    pneumatics.check_air()
    if not pneumatics.is_gripping():
        return
    if not may_vent:
        raise InterlockError(
            "The gripper is closed from an earlier session, an object may hang in it; nothing was moved. Look, then "
            "let it open with `fast gantry home --vent`."
        )
    pneumatics.vent()


def _close(force: ForceSensor, plc: ClickPlc, gantry: Gantry) -> None:
    for close in (gantry.close, force.close, plc.close):
        try:
            close()
        except FastError as error:
            logger.warning("While closing the bench: %s", error)
