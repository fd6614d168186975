"""The whole virtual bench: GRBL on a pty, CLICK and Laumas on Modbus TCP (and RTU), coupled to one world."""

import logging
import math
import threading
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from fast.hardware.clock import Clock
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.laumas.codec import Scale
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.click import VirtualClick
from fast.hardware.virtual.faults import find_fault
from fast.hardware.virtual.grbl.server import IN_THE_MIDDLE_MM, VirtualGrbl
from fast.hardware.virtual.laumas import VirtualLaumas
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.physics import Physics, PhysicsCache, PhysicsRequest
from fast.hardware.virtual.world.state import WorldState
from fast.models.errors import SimulationFailed
from fast.models.records import GraspSimulation

logger = logging.getLogger(__name__)

_PARKED_MM = (
    20.0  # before the ends of x and y a session leaves the carriage: whoever waits for homing waits for seconds
)
_TICK_S = 0.01  # real time between looks at a world whose clock runs by itself


@dataclass(frozen=True)
class Endpoints:
    """Where drivers connect. The transmitter answers on Modbus TCP; its serial port is RTU or sends strings."""

    serial_port: str
    plc_host: str
    plc_port: int
    transmitter_host: str
    transmitter_port: int
    transmitter_serial_port: str | None = None


class VirtualBench:
    """Starts and stops the three servers and moves the world.

    With a lockstep clock the world moves inside `clock.sleep`, physics included. With a clock that runs by itself a
    thread moves it, every access of a server brings it up to date first, and physics runs in a worker.

    `strings`: scale of those that the transmitter's serial port sends by itself; None: it speaks Modbus RTU.
    """

    def __init__(
        self,
        world: World,
        tools: Mapping[int, MountedTool],
        physics: Physics,
        clock: Clock,
        layout: BenchLayout,
        strings: Scale | None = None,
        profile: GrblProfile | None = None,
    ) -> None:
        self.is_lockstep = math.isinf(clock.wall_s(1.0))
        self._physics = physics if isinstance(physics, PhysicsCache) else PhysicsCache(physics)
        self._clock = clock
        self._worker: ThreadPoolExecutor | None = None
        self._ticker = threading.Thread(target=self._tick, name="virtual-world", daemon=True)
        self._stopping = threading.Event()
        self._started_at_s = clock.now_s()
        self._due: list[tuple[float, str]] = []
        x_mm, y_mm, _ = layout.workspace_mm
        parked_mm = (x_mm - _PARKED_MM, y_mm - _PARKED_MM, layout.top_z_mm)
        start_mm = IN_THE_MIDDLE_MM if self.is_lockstep else parked_mm
        self.grbl = VirtualGrbl(clock, profile, start_mm, layout.workspace_mm)
        solve = self._solve_now if self.is_lockstep else self._solve_later
        now_s = clock.now_s()
        self.state = WorldState(world, tools, solve, layout, self._head_mm, now_s)
        self.plc = VirtualClick(self.state, clock.lock, now_s, self._refresh)
        if not self.is_lockstep:  # a faster clock does not make the host's threads faster
            self.plc.host_time_out_s *= max(1.0, 1.0 / clock.wall_s(1.0))
        self.transmitter = VirtualLaumas(
            self.state,
            clock.lock,
            strings,
            refresh=self._refresh,
            now_s=now_s,
            strings_clock=None if strings is None else clock,
        )

    def start(self, plc_port: int | None = 0, transmitter_port: int | None = 0) -> Endpoints:
        """Start everything; ports 0 are free ones. None: no port, only this process reaches the device.

        Raises:
            DeviceError: a port is taken; nothing is left running.
        """
        try:
            self.plc.server.start(plc_port)
            self.transmitter.server.start(transmitter_port)
            self.transmitter.serial_server.start()
        except BaseException:
            self.stop()
            raise
        self._clock.add_listener(self._advance)
        if not self.is_lockstep:
            self._ticker.start()
        return self.endpoints

    @property
    def endpoints(self) -> Endpoints:
        """Where drivers connect."""
        plc, transmitter = self.plc.server, self.transmitter.server
        serial_port = self.transmitter.serial_server.port
        return Endpoints(self.grbl.port, plc.host, plc.port, transmitter.host, transmitter.port, serial_port)

    def inject(self, fault: str) -> None:
        """Start a fault of `hardware.virtual.faults.FAULTS`, now.

        Raises:
            UsageError: unknown name.
        """
        logger.info("Virtual bench: fault %s begins", fault)
        find_fault(fault).inject(self)

    def clear(self, fault: str) -> None:
        """End a fault; one that happens once is left alone. Raises UsageError for an unknown name."""
        find_fault(fault).clear(self)

    def inject_at(self, fault: str, time_s: float) -> None:
        """Start a fault when the bench has been up for `time_s`. Raises UsageError for an unknown name."""
        find_fault(fault)
        self._due.append((self._started_at_s + time_s, fault))

    def stop(self) -> None:
        """Stop everything; safe to call twice."""
        self._stopping.set()
        self._clock.remove_listener(self._advance)
        if self._ticker.is_alive():
            self._ticker.join(timeout=10.0)
        self.transmitter.server.stop()
        self.transmitter.serial_server.stop()
        self.plc.server.stop()
        self.grbl.close()
        if self._worker is not None:
            self._worker.shutdown(wait=True, cancel_futures=True)

    def _head_mm(self, now_s: float) -> tuple[float, float, float]:
        return self.grbl.position_mm(now_s)

    def _advance(self, now_s: float) -> None:
        """Bring world, ladder and transmitter to `now_s`; the caller holds the clock's lock."""
        if self._due:
            self._inject_due(now_s)
        self.state.step(now_s)
        self.plc.scan(now_s)
        self.transmitter.step(now_s)
        if self.state.is_motor_enabled != self.grbl.is_motor_enabled:
            if self.state.is_motor_enabled and not self.is_lockstep:
                self.grbl.free_carriage()  # a bench that stays up has nobody to do it between two sessions
            self.grbl.set_motor_enable(self.state.is_motor_enabled)

    def _inject_due(self, now_s: float) -> None:
        due = [entry for entry in self._due if entry[0] <= now_s]
        for entry in due:
            self._due.remove(entry)
            self.inject(entry[1])

    def _refresh(self) -> None:
        if not self.is_lockstep:
            self._advance(self._clock.now_s())

    def _tick(self) -> None:
        while not self._stopping.wait(_TICK_S):
            with self._clock.lock:
                self._refresh()

    def _solve_now(self, request: PhysicsRequest) -> "Future[GraspSimulation]":
        """Solve the physics in the thread that waits on the clock; a defect in it surfaces there."""
        answer: Future[GraspSimulation] = Future()
        try:
            answer.set_result(self._physics(request))
        except SimulationFailed as failure:
            answer.set_exception(failure)
        return answer

    def _solve_later(self, request: PhysicsRequest) -> "Future[GraspSimulation]":
        """Solve the physics in a worker, so that the servers keep answering."""
        if self._worker is None:
            self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="virtual-physics")
        return self._worker.submit(self._solve_guarded, request)

    def _solve_guarded(self, request: PhysicsRequest) -> GraspSimulation:
        """Solve; a defect of the physics must not end the world's thread: it becomes a failed grasp, with traceback."""
        try:
            return self._physics(request)
        except SimulationFailed:
            raise
        except Exception as error:
            logger.exception("Virtual bench: the physics of object %d broke down", request.object_id)
            raise SimulationFailed(f"The physics broke down: {error!r}.", "crash") from error
