"""Virtual CLICK PLC: the memory map on Modbus TCP, and a ladder that scans it.

Hosts write requests (C) and registers; each scan the ladder decides the outputs (Y), so a Y written by a host reads
back for a moment and is then overwritten. Without a heartbeat for two seconds the ladder closes the supply and drops
the motor enable, and holds lock and grip: an object in the air must not fall because a host died.

In STOP the port still answers, outputs are off and nothing scans. Lock and gripper valves are bistable and stay.
"""

import random
import threading
from collections.abc import Callable

from fast.hardware.click import tags
from fast.hardware.click.codec import BLOCKS, Space, Value, pack_value, parse_address, unpack_value
from fast.hardware.virtual.modbus_pdu import ALL_FUNCTIONS
from fast.hardware.virtual.modbus_server import ModbusServerThread
from fast.hardware.virtual.world.state import WorldState, slots_full
from fast.models.records import GraspSetup

SCAN_PERIOD_S = 0.01
SCAN_JITTER = 0.2  # of the period, either way
_SHORTEST_SCAN_S, _SCAN_SPREAD_S = (1 - SCAN_JITTER) * SCAN_PERIOD_S, 2 * SCAN_JITTER * SCAN_PERIOD_S
MOST_CONNECTIONS = 3  # further ones are hung up
IDLE_TIME_OUT_S = 60.0  # of the bench's clock, then the PLC hangs up (SD200 and following)
CONNECTION_LIMIT_BIT = "SC92"  # on while every connection is in use
_IDLE_LOOK_S = 1.0
_COUNTER_END = 30_000
_NO_HEARTBEAT = 1
_ESTOP = 2

_OUTPUTS = (
    tags.LOCK_OUTPUT,
    tags.GRIP_OUTPUT,
    tags.SUPPLY_OUTPUT,
    tags.MOTOR_ENABLE_OUTPUT,
    tags.UNLOCK_OUTPUT,
    tags.VENT_OUTPUT,
)

_Memory = dict[tuple[Space, int], int]
_SCAN_COUNTER: tuple[Space, int] = ("holding", parse_address(tags.SCAN_COUNTER_REGISTER).wire)


def _wires(space: Space, only_writable: bool = False) -> frozenset[int]:
    return frozenset(
        block.wire_of(number) + word
        for block in BLOCKS.values()
        if block.space == space
        for first, last in block.ranges
        for number in range(first, last + 1, block.step)
        if block.can_write(number) or not only_writable
        for word in range(block.width)
    )


_LEGAL: dict[Space, frozenset[int]] = {
    "coil": _wires("coil") | _wires("discrete"),  # FC01 also answers for inputs
    "discrete": _wires("discrete"),
    "holding": _wires("holding"),
    "input": _wires("input"),
}
_WRITABLE: dict[Space, frozenset[int]] = {
    space: _wires(space, only_writable=True) for space in ("coil", "discrete", "holding")
}


class VirtualClick:
    """A CLICK PLC in RUN, wired to the virtual world.

    `lock` is the clock's; `refresh` brings the world up to date before a read, under that lock.
    """

    functions = ALL_FUNCTIONS

    def __init__(
        self,
        world: WorldState,
        lock: threading.RLock,
        now_s: float,
        refresh: Callable[[], None] = lambda: None,
    ) -> None:
        self.server = ModbusServerThread("CLICK PLC", self, MOST_CONNECTIONS)
        self._world = world
        self._lock = lock
        self._refresh = refresh
        self.host_time_out_s = tags.HOST_TIME_OUT_S
        self._memory: _Memory = {}
        self._n_scans = 0
        self._next_scan_s = self._next_idle_look_s = now_s
        self._jitter = random.Random(now_s).random  # a lockstep bench starts at 0: its scans repeat
        self._is_running = self._is_first_scan = True
        self._lock_valve = self._grip_valve = False
        self._last_heartbeat = 0
        self._heartbeat_at_s: float | None = None
        self._had_host = False
        self._n_writes = 0
        self._last_seen: tuple[object, ...] = ()
        self._set(tags.SUPPLY_SETPOINT_REGISTER, 30.0)
        self._write_recipe(GraspSetup())
        self._show_inputs()

    # The RUN/STOP switch and the power

    @property
    def is_running(self) -> bool:
        """The RUN/STOP switch."""
        return self._is_running

    @is_running.setter
    def is_running(self, is_running: bool) -> None:
        with self._lock:
            self._is_first_scan = self._is_first_scan or (is_running and not self._is_running)
            self._is_running = is_running
            if not is_running:
                self._switch_outputs_off()

    def restart(self, is_retentive: bool = False) -> None:
        """Lose and regain power: connections are gone, and so is the memory, except that of a retentive PLC."""
        with self._lock:
            self._switch_outputs_off()
            if not is_retentive:
                self._memory.clear()
            self._is_first_scan = True
            self._n_writes += 1
            self._show_inputs()
        self.server.drop_all()

    def _switch_outputs_off(self) -> None:
        for output in _OUTPUTS:
            self._set(output, False)
        self._world.is_motor_enabled = False
        self._drive(supply=False)

    def _drive(self, supply: bool) -> None:
        """Drive the valves as their coils leave them: bistable ones stay without current."""
        setpoint_psi = float(self._get(tags.SUPPLY_SETPOINT_REGISTER))
        self._world.set_outputs(self._lock_valve, self._grip_valve, supply, setpoint_psi)

    # The ladder

    def scan(self, now_s: float) -> None:
        """Run the scans due until `now_s`; inputs are the same for all of them, so one is enough.

        Of the next scan only the counter is, if it would see the same: the ladder is at rest after one scan.
        """
        if now_s >= self._next_idle_look_s:
            self._next_idle_look_s = now_s + _IDLE_LOOK_S
            self.server.drop_idle(now_s, IDLE_TIME_OUT_S)
        first_due_s, n_due = self._next_scan_s, 0
        while self._next_scan_s <= now_s + 1e-9:
            self._next_scan_s += _SHORTEST_SCAN_S + _SCAN_SPREAD_S * self._jitter()
            n_due += 1
        if n_due < 1 or not self._is_running:
            return
        self._n_scans = (self._n_scans + n_due) % _COUNTER_END
        self._memory[_SCAN_COUNTER] = self._n_scans
        seen = self._sees(now_s)
        if seen == self._last_seen and not self._is_first_scan:
            return
        self._show_inputs()
        if self._is_first_scan:
            self._begin()
        is_host_alive = self._watch_heartbeat(first_due_s, now_s)
        self._last_seen = self._sees(now_s)
        is_estop_ok = bool(self._get(tags.ESTOP_OK_INPUT))
        self._lock_valve, self._grip_valve = self._ladder_lock(), self._ladder_grip(is_estop_ok)
        supply = bool(self._get(tags.SUPPLY_REQUEST)) and is_host_alive and is_estop_ok
        self._set(tags.LOCK_OUTPUT, self._lock_valve)
        self._set(tags.UNLOCK_OUTPUT, not self._lock_valve)
        self._set(tags.GRIP_OUTPUT, self._grip_valve)
        self._set(tags.VENT_OUTPUT, not self._grip_valve)
        self._set(tags.SUPPLY_OUTPUT, supply)
        self._set(tags.MOTOR_ENABLE_OUTPUT, is_host_alive and is_estop_ok)
        # Until the first host the relay stays closed, so that the machine can be set up from a terminal.
        self._world.is_motor_enabled = is_estop_ok and (is_host_alive or not self._had_host)
        self._set(tags.FAULT_REGISTER, _NO_HEARTBEAT * (not is_host_alive) + _ESTOP * (not is_estop_ok))
        self._set(CONNECTION_LIMIT_BIT, self.server.n_connections >= MOST_CONNECTIONS)
        self._drive(supply)

    def _sees(self, now_s: float) -> tuple[object, ...]:
        """Return all that the outcome of a scan depends on."""
        return (self._n_writes, self.server.n_connections, self._is_host_alive(now_s), self._world.input_state)

    def _begin(self) -> None:
        """Do the first scan after power-up or STOP: forget the session and all requests, move no valve."""
        self._is_first_scan = False
        self._n_scans = 0
        self._set(tags.SCAN_COUNTER_REGISTER, 0)
        self._last_heartbeat = int(self._get(tags.HEARTBEAT_REGISTER))
        self._heartbeat_at_s = None
        self._set(tags.SESSION_REGISTER, 0)
        for request in tags.REQUESTS:
            self._set(request, False)
        self._set(tags.LOCK_OUTPUT, bool(self._get(tags.LOCK_CLOSED_INPUT)))
        self._set(tags.GRIP_OUTPUT, bool(self._get(tags.PRESSURE_OK_INPUT)))

    def _ladder_lock(self) -> bool:
        """Decide on the bistable lock: close on request, open on request only while the head sits in a dock."""
        if self._get(tags.LOCK_REQUEST):
            return True
        may_open = self._get(tags.UNLOCK_REQUEST) and self._get(tags.HEAD_IN_DOCK_INPUT)
        return bool(self._get(tags.LOCK_OUTPUT)) and not may_open

    def _ladder_grip(self, is_estop_ok: bool) -> bool:
        """Decide on the latched grip: close on request if nothing forbids it, open on request, else stay."""
        if self._get(tags.VENT_REQUEST):
            return False
        if self._get(tags.GRIP_REQUEST) and is_estop_ok:
            return True
        return bool(self._get(tags.GRIP_OUTPUT))

    def _watch_heartbeat(self, first_due_s: float, now_s: float) -> bool:
        """Return whether the host is alive; the first scan due saw what changed since the last scan."""
        beat = int(self._get(tags.HEARTBEAT_REGISTER))
        if beat != self._last_heartbeat:
            self._last_heartbeat, self._heartbeat_at_s, self._had_host = beat, first_due_s, True
            self._set(tags.HEARTBEAT_ECHO_REGISTER, beat)
        return self._is_host_alive(now_s)

    def _is_host_alive(self, now_s: float) -> bool:
        return self._heartbeat_at_s is not None and now_s - self._heartbeat_at_s <= self.host_time_out_s

    def _show_inputs(self) -> None:
        world = self._world
        self._set(tags.LOCK_CLOSED_INPUT, world.is_lock_closed)
        self._set(tags.LOCK_OPEN_INPUT, world.is_lock_open)
        self._set(tags.TOOL_PRESENT_INPUT, world.is_tool_present)
        self._set(tags.PRESSURE_OK_INPUT, world.is_pressure_ok)
        self._set(tags.ESTOP_OK_INPUT, "estop_pressed" not in world.faults)
        self._set(tags.SUPPLY_OK_INPUT, world.is_supply_ok)
        self._set(tags.HEAD_IN_DOCK_INPUT, world.dock_slot is not None)
        self._set(tags.PRESSURE_REGISTER, world.pressure_psi)
        first = parse_address(tags.FIRST_DOCK_INPUT).wire
        for slot, is_full in enumerate(slots_full(world)):
            self._memory["discrete", first + slot] = int(is_full)

    def _read_recipe(self) -> GraspSetup:
        first = parse_address(tags.FIRST_RECIPE_REGISTER).number
        values = [round(float(self._get(f"DF{first + i}")), 4) for i in range(tags.N_RECIPE)]
        names = ("open_gap_mm", "closed_gap_mm", "close_speed_mm_per_s", "lift_speed_mm_per_s", "max_lift_mm")
        return GraspSetup().model_copy(update=dict(zip(names, values, strict=True)))

    def _write_recipe(self, setup: GraspSetup) -> None:
        first = parse_address(tags.FIRST_RECIPE_REGISTER).number
        for i, value in enumerate(recipe_values(setup)):
            self._set(f"DF{first + i}", value)

    # The Modbus side

    def read_bits(self, space: str, address: int, count: int) -> list[bool] | None:
        """Read bits of `coil` or `discrete`."""
        legal = _LEGAL["coil" if space == "coil" else "discrete"]
        wires = range(address, address + count)
        if any(wire not in legal for wire in wires):
            return None
        with self._lock:
            self._refresh()
            spaces: tuple[Space, Space] = ("coil", "discrete")
            return [any(self._memory.get((key, wire), 0) for key in spaces) for wire in wires]

    def read_registers(self, space: str, address: int, count: int) -> list[int] | None:
        """Read registers of `holding` or `input`."""
        key: Space = "holding" if space == "holding" else "input"
        wires = range(address, address + count)
        if any(wire not in _LEGAL[key] for wire in wires):
            return None
        with self._lock:
            self._refresh()
            return [self._memory.get((key, wire), 0) for wire in wires]

    def write_bits(self, address: int, values: list[bool]) -> bool:
        """Write coils Y and C, and the few system bits that take writes."""
        wires = range(address, address + len(values))
        keys = [self._writable_bit(wire) for wire in wires]
        if None in keys:
            return False
        with self._lock:
            self._n_writes += 1
            self._memory.update({key: int(value) for key, value in zip(keys, values, strict=True) if key is not None})
        return True

    @staticmethod
    def _writable_bit(wire: int) -> tuple[Space, int] | None:
        spaces: tuple[Space, Space] = ("coil", "discrete")
        return next(((space, wire) for space in spaces if wire in _WRITABLE[space]), None)

    def write_registers(self, address: int, values: list[int]) -> bool:
        """Write holding registers; writing the job label starts the world's next grasp."""
        wires = range(address, address + len(values))
        if any(wire not in _WRITABLE["holding"] for wire in wires):
            return False
        with self._lock:
            self._n_writes += 1
            self._memory.update({("holding", wire): value for wire, value in zip(wires, values, strict=True)})
            if parse_address(tags.FIRST_RECIPE_REGISTER).wire in wires:
                self._world.setup = self._read_recipe()
            if parse_address(tags.JOB_REPEAT_REGISTER).wire in wires:
                self._world.start_job(
                    int(self._get(tags.JOB_OBJECT_REGISTER)), int(self._get(tags.JOB_REPEAT_REGISTER))
                )
        return True

    def _get(self, name: str) -> Value:
        address = parse_address(name)
        space, kind, wire = address.block.space, address.block.kind, address.wire
        if kind == "bit":
            return bool(self._memory.get((space, wire), 0))
        return unpack_value(kind, [self._memory.get((space, wire + i), 0) for i in range(address.block.width)])

    def _set(self, name: str, value: Value) -> None:
        address = parse_address(name)
        words = [int(value)] if address.block.kind == "bit" else pack_value(address.block.kind, value)
        for i, word in enumerate(words):
            self._memory[address.block.space, address.wire + i] = word


def recipe_values(setup: GraspSetup) -> list[float]:
    """Return the five recipe registers of a setup, in their order."""
    return [
        setup.open_gap_mm,
        setup.closed_gap_mm,
        setup.close_speed_mm_per_s,
        setup.lift_speed_mm_per_s,
        setup.max_lift_mm,
    ]
