"""One bench, real or virtual: the same drivers, connected, homed and closed safely."""

import logging
import math
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from fast.hardware.click import tags
from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import Clock, RealClock, ScaledClock, VirtualClock
from fast.hardware.grasp_bench import Leave
from fast.hardware.grbl.profile import (
    FIRST_AXIS_SETTING,
    FIRST_TRAVEL_SETTING,
    LAB_SETTINGS,
    MAX_STEP_RATE_HZ,
    SAFE_SETTINGS,
    Z_AXIS,
    GrblProfile,
)
from fast.hardware.laumas.codec import PLAIN_DIVISIONS, Scale
from fast.hardware.laumas.continuous import ContinuousTransmitter
from fast.hardware.laumas.driver import LaumasTransmitter
from fast.hardware.laumas.source import WeightSource
from fast.hardware.laumas.strings import least_baud_rate
from fast.hardware.parts.force_sensor import FULL_SCALE_KG, ForceSensor
from fast.hardware.parts.gantry import Gantry
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.parts.pneumatics import Pneumatics
from fast.hardware.parts.safe_state import StopAskedError, Verb
from fast.hardware.questions import Ask
from fast.hardware.safety.heartbeat import BeatingClock, HeartbeatThread
from fast.hardware.safety.supervisor import MayVent, Supervisor
from fast.hardware.safety.watches import AirWatch, GraspWatch, ReleaseWatch, TravelWatch, ZeroWatch
from fast.hardware.station.lost_steps import PositionCheck
from fast.hardware.station.recorder import GraspInView
from fast.hardware.station.station import GraspStation, Item, MeasuredGrasp, StationDevices
from fast.hardware.tools.changer import ToolChanger
from fast.hardware.tools.journal import Journal
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.bench import VirtualBench
from fast.hardware.virtual.memory_wires import MemoryTransport, memory_link
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.physics import Physics, simulate_request
from fast.hardware.wire.log_files import GANTRY, LIMIT_BYTES, LOAD_CELL, PLC, WireFiles
from fast.hardware.wire.modbus import ModbusLink, rtu_link, tcp_link
from fast.hardware.wire.serial import PortBusyError, SerialTransport, Transport
from fast.models.errors import ConfigError, DeviceError, FastError
from fast.models.records import GraspSetup, Record
from fast.models.units import force_n_from_kg

logger = logging.getLogger(__name__)

_VIRTUAL_LOG_BYTES = 32_000_000  # of one device: a virtual bench says in a minute what a real one says in hours
_EXIT_OF_A_SIGNAL = 128  # plus its number, as shells say it
_LONGEST_READ_S = tags.HOST_TIME_OUT_S - ClickPlc.heartbeat_period_s  # a read that takes longer costs the heartbeat
_PHYSICS_PATIENCE_S = 1800.0  # real seconds a virtual gripper may wait for its physics


class BenchSettings(Record):
    """Addresses and figures of a real bench; the defaults are the paper's rig."""

    serial_port: str = Field(default="/dev/ttyACM0", min_length=1, description="GRBL on an Arduino Mega")
    serial_baud_rate: int = Field(default=115200, ge=9600, le=2_000_000)
    """Of this port."""
    max_step_rate_hz: float = Field(
        default=MAX_STEP_RATE_HZ, ge=1000, le=1_000_000, description="of the controller; boards of grblHAL make more"
    )
    plc_host: str = Field(default="192.168.0.10", min_length=1)
    """Address of the CLICK."""
    plc_port: int = Field(default=502, ge=1, le=65535)
    """Of Modbus TCP."""
    plc_device_id: int = Field(default=1, ge=0, le=255, description="Modbus unit id")
    transmitter_host: str = Field(
        default="192.168.0.20", min_length=1, description="Modbus TCP; unused with a serial port"
    )
    transmitter_port: int = Field(default=502, ge=1, le=65535)
    """Of Modbus TCP."""
    transmitter_device_id: int = Field(default=1, ge=0, le=255, description="Modbus unit id or serial address")
    transmitter_serial_port: str | None = Field(
        default=None, min_length=1, description="serial line instead of Modbus TCP"
    )
    transmitter_baud_rate: int = Field(default=115200, ge=2400, le=115200)
    """Of the serial line."""
    transmitter_mode: Literal["modbus", "continuous"] = Field(
        default="modbus", description="`continuous`: the serial line sends force_rate_hz strings a second by itself"
    )
    transmitter_division: float = Field(default=0.001, gt=0, description="on the keypad; used in continuous mode")
    transmitter_unit: Literal["kg", "g", "t", "N"] = Field(default="kg", description="as transmitter_division")
    full_scale_kg: float = Field(
        default=FULL_SCALE_KG, gt=0, le=1000, description="of the load cell; a lift ends there"
    )
    transmitter_filter: int = Field(default=0, ge=0, le=9, description="keypad setting, recorded; 0 or 1 for a lift")
    modbus_time_out_s: float = Field(default=_LONGEST_READ_S, gt=0, le=30, description="of a read with its repeats")
    force_rate_hz: float = Field(default=80.0, ge=5, le=300)
    """Readings of the load cell."""
    stale_after_s: float = Field(default=0.5, ge=0, le=10)
    """Identical readings for so long mean a frozen transmitter; 0: they may be real."""
    supply_pressure_psi: float = Field(default=30.0, ge=5, le=60)
    """Of the gripper's air."""
    pressure_time_out_s: float = Field(default=2.0, gt=0)
    """Until the pressure switch must be on."""
    tool_mass_kg: dict[int, Annotated[float, Field(gt=0)]] = Field(
        default_factory=dict, description="weighed tools by slot; others estimated"
    )
    layout: BenchLayout = BenchLayout()
    """Places of objects, tools and head."""
    gantry_settings: dict[int, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(
        default_factory=dict, description="lines of `$$` that are others on this machine than in the profile, by number"
    )
    journal: str | None = Field(default=None, description="file of the tool changer's journal; default beside this one")

    @property
    def gantry_profile(self) -> GrblProfile:
        """Settings that this bench's controller must have."""
        return GrblProfile(max_step_rate_hz=self.max_step_rate_hz).with_settings(self.gantry_settings)

    @model_validator(mode="after")
    def _check_gantry_settings(self) -> "BenchSettings":
        """Check that what the driver relies on stays, Z homes upwards, and the box lies within the travel."""
        own = self.gantry_settings
        for number in own:
            if number in SAFE_SETTINGS or number not in LAB_SETTINGS:
                free = ", ".join(map(str, sorted(LAB_SETTINGS.keys() - SAFE_SETTINGS)))
                raise ValueError(f"gantry_settings has {number}, which no machine may have its own; it may have {free}")
            if number >= FIRST_AXIS_SETTING and not own[number]:
                raise ValueError(f"gantry_settings.{number} is 0, it must be above 0; give what `$$` shows")
        try:
            profile = self.gantry_profile
        except ConfigError as error:
            raise ValueError(f"gantry_settings: {error}") from error
        if not profile.homes_to_plus_end(Z_AXIS):
            raise ValueError(
                f"gantry_settings.23 is {own[23]:g}: Z would home down onto the bench; clear its bit 2 (4)"
            )
        for axis, size_mm in enumerate(self.layout.workspace_mm):
            usable_mm = profile.travel_mm[axis] - profile.pull_off_mm
            if size_mm > usable_mm:
                raise ValueError(
                    f"layout.workspace_mm is {size_mm:g} mm in {'xyz'[axis]}, the controller reaches {usable_mm:g} mm "
                    f"(travel ${FIRST_TRAVEL_SETTING + axis} less pull-off $27); make it smaller, or correct "
                    "gantry_settings"
                )
        return self

    @model_validator(mode="after")
    def _check_continuous_mode(self) -> "BenchSettings":
        if self.transmitter_mode == "modbus":
            return self
        if self.transmitter_serial_port is None:
            raise ValueError("transmitter_mode `continuous` needs transmitter_serial_port; name the serial line")
        if self.transmitter_division not in PLAIN_DIVISIONS:
            raise ValueError(
                f"transmitter_division is {self.transmitter_division:g}; set the keypad to one of "
                f"{', '.join(f'{division:g}' for division in sorted(PLAIN_DIVISIONS))}"
            )
        if self.transmitter_baud_rate < least_baud_rate(self.force_rate_hz):
            raise ValueError(
                f"{self.force_rate_hz:g} strings a second need {least_baud_rate(self.force_rate_hz)} baud, "
                f"transmitter_baud_rate is {self.transmitter_baud_rate}; raise it here and on the keypad"
            )
        return self


@dataclass(frozen=True)
class Bench:
    """Connected devices of one bench."""

    gantry: Gantry
    """Moves the head."""
    plc: ClickPlc
    """Outputs and inputs of the CLICK."""
    pneumatics: Pneumatics
    """Jaws and air supply."""
    changer: ToolChanger
    """Picks and docks tools."""
    force: ForceSensor
    """The load cell."""
    supervisor: Supervisor
    """Brings the bench to its safe state."""
    station: GraspStation
    """Makes grasps."""
    position: PositionCheck
    """Finds lost steps."""
    clock: Clock
    """The bench's time."""
    settings: BenchSettings
    """Addresses and limits."""
    virtual: VirtualBench | None = None
    """The bench behind the wire; None on real hardware."""
    wire_session: str | None = None
    """Name of the wire logs of this session (the beginning of their files); None: kept in memory only."""

    # What a campaign asks of any bench (`hardware.grasp_bench.GraspBench`)

    def set_leave(self, leave: Leave) -> None:
        """Have `leave` asked before every motion from now on."""
        self.gantry.require_leave = leave

    def set_ask(self, ask: Ask) -> None:
        """Have a person asked whether a tool that weighs what it should not is that tool."""
        self.changer.ask = ask

    def ask(self, verb: Verb) -> None:
        """Stop or abort now, from any thread."""
        self.supervisor.ask(verb)

    def measure_tool(
        self,
        slot: int,
        plan: Sequence[Item],
        setup: GraspSetup,
        on_grasp: Callable[[MeasuredGrasp], None],
        should_stop: Callable[[], bool],
    ) -> None:
        """Take the tool of a slot, make the planned grasps in order, hang the tool back; see `GraspStation`."""
        self.station.measure_tool(slot, plan, setup, on_grasp, should_stop)

    def present_grasp(self) -> GraspInView | None:
        """Return the grasp that is made now, or the last one."""
        return self.station.present

    def check_position(self) -> tuple[float, float, float]:
        """Check the slip of the gantry by axis, mm; see `PositionCheck`."""
        return self.position.run()


@dataclass(frozen=True)
class LogFolders:
    """Where wire logs go: of every session, and of one that ends with an error; None keeps them in memory."""

    always: Path | None = None
    on_a_fault: Path | None = None


IN_MEMORY = LogFolders()


@contextmanager
def open_virtual_bench(
    world: World,
    tools: Mapping[int, MountedTool],
    physics: Physics = simulate_request,
    speed_up: float | None = None,
    wires: Literal["lines", "memory"] = "lines",
    logs: LogFolders = IN_MEMORY,
    layout: BenchLayout = BenchLayout(),  # noqa: B008 - frozen record
) -> Iterator[Bench]:
    """Open a virtual bench with its drivers connected and homed; it is stopped at the end of the `with`.

    `physics` answers one grasp (it is cached here). Time is in lockstep: it moves only while drivers wait; with
    `speed_up` it runs by itself, so many times faster than the wall. `wires` "memory" hands over the bytes of pty and
    sockets directly, opens no port, and makes a grasp several times cheaper; only lockstep allows it. `logs`:
    where the wire logs go.
    """
    clock: Clock = VirtualClock() if speed_up is None else ScaledClock(speed_up)
    is_in_memory = wires == "memory"
    ports = (None, None) if is_in_memory else (0, 0)
    with open_virtual_servers(world, tools, physics, clock, ports, BenchSettings(layout=layout)) as virtual:
        at = virtual.endpoints
        is_noisy = world.sensor.noise_sd_n >= 0.05  # several counts: identical readings can only be a frozen instrument
        settings = BenchSettings(
            serial_port=at.serial_port,
            plc_host=at.plc_host,
            transmitter_host=at.transmitter_host,
            modbus_time_out_s=10.0,
            force_rate_hz=world.sensor.rate_hz,
            stale_after_s=0.5 if is_noisy else 0.0,
            pressure_time_out_s=2.0 if speed_up is None else _PHYSICS_PATIENCE_S * speed_up,
            layout=layout,
        )
        if not is_in_memory:
            found = {"plc_port": at.plc_port, "transmitter_port": at.transmitter_port}
            settings = settings.model_copy(update=found)
        with _open(settings, tools, clock, virtual, is_in_memory=is_in_memory, logs=logs) as bench:
            yield bench


@contextmanager
def open_virtual_servers(
    world: World,
    tools: Mapping[int, MountedTool],
    physics: Physics,
    clock: Clock,
    ports: tuple[int | None, int | None] = (0, 0),
    like: BenchSettings = BenchSettings(),  # noqa: B008 - frozen record
) -> Iterator[VirtualBench]:
    """Open only the devices of a virtual bench, for drivers elsewhere (`fast virtual start`); see `.endpoints`.

    `ports`: of PLC and transmitter; 0 takes a free one, None opens none. `like`: whose layout and gantry settings the
    bench has; with its continuous mode the serial port sends strings by itself instead of speaking Modbus RTU.
    """
    scale = Scale(like.transmitter_division, like.transmitter_unit)
    strings = scale if like.transmitter_mode == "continuous" else None
    virtual = VirtualBench(world, tools, physics, clock, like.layout, strings, like.gantry_profile)
    virtual.start(*ports)
    try:
        yield virtual
    finally:
        virtual.stop()


@contextmanager
def open_real_bench(
    settings: BenchSettings,
    tools: Mapping[int, MountedTool],
    clock: Clock | None = None,
    may_vent: MayVent = False,
    log_folder: Path | None = None,
) -> Iterator[Bench]:
    """Open the bench at these addresses, drivers connected and homed. The caller has asked for leave to move.

    `clock` is the machine's; a virtual bench that runs faster in another process needs a `ScaledClock` as fast.
    `may_vent`: a person has looked at a gripper that an earlier host left closed, and lets it open before homing; or
    what asks a person, given what was found.
    `log_folder`: where the wire logs go; None keeps them in memory.

    Raises:
        InterlockError: emergency stop pressed, or the gripper is closed; nothing has moved.
        DeviceError: names every device that did not connect.
    """
    if clock is None and settings.modbus_time_out_s > _LONGEST_READ_S:
        logger.warning("modbus_time_out_s is %g s: a read that the PLC does not answer outlasts its watchdog of %g s, "
                       "which then takes the motor enable; keep it at %g s", settings.modbus_time_out_s,
                       tags.HOST_TIME_OUT_S, _LONGEST_READ_S)  # fmt: skip
    weighed = {
        slot: MountedTool(tool.tool_id, tool.design, settings.tool_mass_kg.get(slot, tool.mass_kg))
        for slot, tool in tools.items()
    }
    with _open(settings, weighed, clock or RealClock(), None, may_vent, logs=LogFolders(log_folder)) as bench:
        yield bench


@contextmanager
def _open(
    settings: BenchSettings,
    tools: Mapping[int, MountedTool],
    inner: Clock,
    virtual: VirtualBench | None,
    may_vent: MayVent = False,
    is_in_memory: bool = False,
    logs: LogFolders = IN_MEMORY,
) -> Iterator[Bench]:
    clock = BeatingClock(inner)
    wires = _memory_wires(virtual, clock) if virtual is not None and is_in_memory else wires_to(settings, clock)
    plc = ClickPlc(wires.plc, clock)
    force = ForceSensor(
        wires.transmitter,
        clock,
        settings.force_rate_hz,
        settings.stale_after_s or None,
        settings.transmitter_filter,
        force_n_from_kg(settings.full_scale_kg),
    )
    gantry = Gantry(wires.gantry, clock, settings.gantry_profile, settings.layout.workspace_mm)
    pneumatics = Pneumatics(plc, clock, settings.supply_pressure_psi, settings.pressure_time_out_s)
    journal = Journal(Path(settings.journal) if settings.journal is not None else None)
    changer = ToolChanger(gantry, plc, force, clock, tools, settings.layout, journal)
    recorded: dict[str, float | str] = {
        "transmitter_mode": settings.transmitter_mode,
        "transmitter_filter": float(settings.transmitter_filter),
        "supply_pressure_psi": settings.supply_pressure_psi,
        "force_rate_hz": settings.force_rate_hz,
    }
    watch = GraspWatch(AirWatch(pneumatics, clock), ZeroWatch(force), ReleaseWatch(force, pneumatics, clock))
    supervisor = Supervisor(gantry, plc, pneumatics, settings.layout.top_z_mm)
    travel = TravelWatch(gantry, force, clock, lambda: supervisor.is_ok and supervisor.rest_z_mm is None)
    clock.listen((supervisor.hear, travel.look), lambda: supervisor.is_ok)
    with ExitStack() as stack:
        stack.enter_context(_terminable())
        if logs.on_a_fault is not None:
            stack.enter_context(_kept_on_a_fault(wires, logs.on_a_fault))
        wire_session = None
        if logs.always is not None:
            files = WireFiles(logs.always, LIMIT_BYTES if virtual is None else _VIRTUAL_LOG_BYTES)
            wire_session = recorded["wire_log"] = stack.enter_context(files).session
            wires.write_to(files)
        devices = StationDevices(gantry, pneumatics, changer, force)
        station = GraspStation(devices, supervisor, watch, clock, settings.layout, recorded)
        stack.callback(_close, force, plc, gantry)
        _connect({"gantry": gantry.connect, "PLC": plc.connect, "load cell": force.connect})
        _start_heartbeat(stack, clock, inner, plc)
        supervisor.acknowledge("the person who opened the bench")
        changer.check_may_rise()
        supervisor.make_ready_to_home(may_vent)
        supervisor.home()
        position = PositionCheck(gantry, changer, supervisor)
        yield Bench(
            gantry,
            plc,
            pneumatics,
            changer,
            force,
            supervisor,
            station,
            position,
            clock,
            settings,
            virtual,
            wire_session,
        )


@dataclass(frozen=True)
class Wires:
    """The three lines of a bench; the transmitter's with its driver. Nothing is open yet."""

    plc: ModbusLink
    transmitter: WeightSource
    transmitter_wire: ModbusLink | Transport
    gantry: Transport

    def write_to(self, files: WireFiles) -> None:
        """Have the wire logs of all three written to files."""
        files.follow(self.gantry.log, GANTRY, self.gantry.name)
        files.follow(self.plc.log, PLC, self.plc.name)
        files.follow(self.transmitter_wire.log, LOAD_CELL, self.transmitter_wire.name)


def wires_to(settings: BenchSettings, clock: Clock) -> Wires:
    """Return lines to the addresses of a bench."""
    time_out_s = settings.modbus_time_out_s
    plc = tcp_link("CLICK PLC", settings.plc_host, settings.plc_port, settings.plc_device_id, time_out_s)
    gantry = SerialTransport(settings.serial_port, settings.serial_baud_rate)
    if settings.transmitter_mode == "continuous":
        line = SerialTransport(str(settings.transmitter_serial_port), settings.transmitter_baud_rate)
        scale = Scale(settings.transmitter_division, settings.transmitter_unit)
        return Wires(plc, ContinuousTransmitter(line, clock, scale, settings.force_rate_hz), line, gantry)
    link = _transmitter_link(settings)
    return Wires(plc, LaumasTransmitter(link, clock), link, gantry)


def _memory_wires(virtual: VirtualBench, clock: Clock) -> Wires:
    plc = memory_link("CLICK PLC in memory", virtual.plc.server)
    link = memory_link("Weight transmitter in memory", virtual.transmitter.server)
    return Wires(plc, LaumasTransmitter(link, clock), link, MemoryTransport(virtual.grbl))


@contextmanager
def _kept_on_a_fault(wires: Wires, folder: Path) -> Iterator[None]:
    """Write what the wire logs hold in memory to files when an error ends the bench; a person's stop is none."""
    try:
        yield
    except StopAskedError:
        raise
    except FastError:
        with WireFiles(folder, _VIRTUAL_LOG_BYTES) as files:
            wires.write_to(files)
        logger.warning("The last traffic with the devices is in %s, session %s", folder, files.session)
        raise


@contextmanager
def _terminable() -> Iterator[None]:
    """End on SIGTERM as on Ctrl-C, in the safe state, where nobody else has taken it: alone it would end nothing."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return

    def terminate(number: int, frame: object) -> None:
        raise SystemExit(_EXIT_OF_A_SIGNAL + number)

    signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _transmitter_link(settings: BenchSettings) -> ModbusLink:
    name, device_id, time_out_s = "Weight transmitter", settings.transmitter_device_id, settings.modbus_time_out_s
    if settings.transmitter_serial_port is not None:
        port, baud_rate = settings.transmitter_serial_port, settings.transmitter_baud_rate
        return rtu_link(name, port, baud_rate, device_id, time_out_s)
    return tcp_link(name, settings.transmitter_host, settings.transmitter_port, device_id, time_out_s)


def _start_heartbeat(stack: ExitStack, clock: BeatingClock, inner: Clock, plc: ClickPlc) -> None:
    if math.isinf(inner.wall_s(1.0)):
        clock.start(plc)
        stack.callback(clock.stop)
    else:
        heartbeat = HeartbeatThread(plc, clock)
        heartbeat.start()
        stack.callback(heartbeat.stop)


def _connect(connects: Mapping[str, Callable[[], object]]) -> None:
    """Connect every device; report all that failed in one message.

    The gantry's port, which one program can have, comes first: where another has it, the PLC would believe that this
    one has taken its bench over, and stop it.
    """
    failures: list[str] = []
    first: FastError | None = None
    for name, connect in connects.items():
        try:
            connect()
        except PortBusyError as error:
            raise DeviceError(f"{name}: {error}") from error
        except FastError as error:
            failures.append(f"{name}: {error}")
            first = first or error
    if failures:
        raise DeviceError(" ".join(failures)) from first


def _close(force: ForceSensor, plc: ClickPlc, gantry: Gantry) -> None:
    for close in (gantry.close, force.close, plc.close):
        try:
            close()
        except FastError as error:
            logger.warning("While closing the bench: %s", error)
