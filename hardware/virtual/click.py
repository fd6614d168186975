"""Virtual CLICK PLC: the memory map on Modbus TCP, and a ladder that scans it.

Hosts write requests (C) and registers; each scan the ladder decides the outputs (Y), so a Y written by a host reads
back for a moment and is then overwritten. Without a heartbeat for two seconds the ladder closes the supply and drops
the motor enable, and holds lock and grip: an object in the air must not fall because a host died.
"""

import threading
from collections.abc import Callable

from hardware.click import tags
from hardware.click.codec import BANKS, Space, Value, pack_value, parse_address, unpack_value
from hardware.virtual.modbus import ModbusServerThread
from hardware.virtual.pdu import ALL_FUNCTIONS
from hardware.world.state import WorldState, slots_full
from models.records import GraspSetup

SCAN_PERIOD_S = 0.01
_NO_HEARTBEAT = 1
_ESTOP = 2

_Memory = dict[tuple[Space, int], int]
_SCAN_COUNTER: tuple[Space, int] = ("holding", parse_address(tags.SCAN_COUNTER_REGISTER).wire)


def _wires(space: Space) -> frozenset[int]:
    return frozenset(
        bank.wire_of(number) + word
        for bank in BANKS.values()
        if bank.space == space
        for first, last in bank.ranges
        for number in range(first, last + 1)
        for word in range(bank.width)
    )


_LEGAL: dict[Space, frozenset[int]] = {
    "coil": _wires("coil") | _wires("discrete"),  # FC01 also answers for inputs
    "discrete": _wires("discrete"),
    "holding": _wires("holding"),
    "input": _wires("input"),
}


class VirtualClick:
    """A CLICK PLC in RUN, wired to the virtual world. `is_running` False is the STOP switch.

    `lock` is the clock's; `refresh` brings the world up to date before a read, under that lock.
    """

    functions = ALL_FUNCTIONS

    def __init__(
        self, world: WorldState, lock: threading.RLock, now_s: float, refresh: Callable[[], None] = lambda: None
    ) -> None:
        self.server = ModbusServerThread("CLICK PLC", self)
        self.is_running = True
        self._world = world
        self._lock = lock
        self._refresh = refresh
        self.host_time_out_s = tags.HOST_TIME_OUT_S
        self._memory: _Memory = {}
        self._n_scans = 0
        self._last_scan_s = now_s
        self._last_heartbeat = 0
        self._heartbeat_at_s: float | None = None
        self._n_writes = 0
        self._last_seen: tuple[object, ...] = ()
        self._set(tags.SUPPLY_SETPOINT_REGISTER, 30.0)
        self._write_recipe(GraspSetup())
        self._show_inputs()

    def restart(self) -> None:
        """Power off and on: everything a host wrote is gone; the two bistable valves stay as they are."""
        with self._lock:
            lock, grip = self._get(tags.LOCK_OUTPUT), self._get(tags.GRIP_OUTPUT)
            self._memory.clear()
            self._n_writes += 1
            self._n_scans = self._last_heartbeat = 0
            self._set(tags.LOCK_OUTPUT, lock)
            self._set(tags.GRIP_OUTPUT, grip)
            self._set(tags.SUPPLY_SETPOINT_REGISTER, 30.0)
            self._write_recipe(self._world.setup)
            self._show_inputs()

    # The ladder

    def scan(self, now_s: float) -> None:
        """Run the scans due until `now_s`; inputs are the same for all of them, so one is enough.

        Of the next scan only the counter is, if it would see the same: the ladder is at rest after one scan.
        """
        n_due = int((now_s - self._last_scan_s) / SCAN_PERIOD_S + 1e-9)
        if n_due < 1 or not self.is_running:
            return
        first_due_s = self._last_scan_s + SCAN_PERIOD_S
        self._last_scan_s += n_due * SCAN_PERIOD_S
        self._n_scans = (self._n_scans + n_due) % 30000
        self._memory[_SCAN_COUNTER] = self._n_scans
        seen = (self._n_writes, self._is_host_alive(now_s), *self._world.input_state)
        if seen == self._last_seen:
            return
        self._show_inputs()
        is_host_alive = self._watch_heartbeat(first_due_s, now_s)
        self._last_seen = (self._n_writes, is_host_alive, *self._world.input_state)
        is_estop_ok = bool(self._get(tags.ESTOP_OK_INPUT))
        lock, grip = self._ladder_lock(), self._ladder_grip(is_estop_ok)
        supply = bool(self._get(tags.SUPPLY_REQUEST)) and is_host_alive and is_estop_ok
        self._set(tags.LOCK_OUTPUT, lock)
        self._set(tags.GRIP_OUTPUT, grip)
        self._set(tags.SUPPLY_OUTPUT, supply)
        self._set(tags.MOTOR_ENABLE_OUTPUT, is_host_alive and is_estop_ok)
        # Until the first host the relay stays closed, so that the machine can be set up from a terminal.
        self._world.is_motor_enabled = is_estop_ok and (is_host_alive or self._heartbeat_at_s is None)
        self._set(tags.FAULT_REGISTER, _NO_HEARTBEAT * (not is_host_alive) + _ESTOP * (not is_estop_ok))
        self._world.set_outputs(lock, grip, supply, float(self._get(tags.SUPPLY_SETPOINT_REGISTER)))

    def _ladder_lock(self) -> bool:
        """Bistable: closes on request, opens on request only while the head sits in a dock."""
        if self._get(tags.LOCK_REQUEST):
            return True
        may_open = self._get(tags.UNLOCK_REQUEST) and self._get(tags.HEAD_IN_DOCK_INPUT)
        return bool(self._get(tags.LOCK_OUTPUT)) and not may_open

    def _ladder_grip(self, is_estop_ok: bool) -> bool:
        """Latched: closes on request if nothing forbids it, opens on request, else stays."""
        if self._get(tags.VENT_REQUEST):
            return False
        if self._get(tags.GRIP_REQUEST) and is_estop_ok:
            return True
        return bool(self._get(tags.GRIP_OUTPUT))

    def _watch_heartbeat(self, first_due_s: float, now_s: float) -> bool:
        """Whether the host is alive; what changed since the last scan was seen by the first scan that was due."""
        beat = int(self._get(tags.HEARTBEAT_REGISTER))
        if beat != self._last_heartbeat:
            self._last_heartbeat, self._heartbeat_at_s = beat, first_due_s
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
        """Bits of `coil` or `discrete`."""
        legal = _LEGAL["coil" if space == "coil" else "discrete"]
        wires = range(address, address + count)
        if any(wire not in legal for wire in wires):
            return None
        with self._lock:
            self._refresh()
            spaces: tuple[Space, Space] = ("coil", "discrete")
            return [any(self._memory.get((key, wire), 0) for key in spaces) for wire in wires]

    def read_registers(self, space: str, address: int, count: int) -> list[int] | None:
        """Registers of `holding` or `input`."""
        key: Space = "holding" if space == "holding" else "input"
        wires = range(address, address + count)
        if any(wire not in _LEGAL[key] for wire in wires):
            return None
        with self._lock:
            self._refresh()
            return [self._memory.get((key, wire), 0) for wire in wires]

    def write_bits(self, address: int, values: list[bool]) -> bool:
        """Coils Y and C."""
        wires = range(address, address + len(values))
        if any(wire not in _LEGAL["coil"] or wire in _LEGAL["discrete"] for wire in wires):
            return False
        with self._lock:
            self._n_writes += 1
            self._memory.update({("coil", wire): int(value) for wire, value in zip(wires, values, strict=True)})
        return True

    def write_registers(self, address: int, values: list[int]) -> bool:
        """Holding registers; writing the job label starts the world's next grasp."""
        wires = range(address, address + len(values))
        if any(wire not in _LEGAL["holding"] for wire in wires):
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
        space, kind, wire = address.bank.space, address.bank.kind, address.wire
        if kind == "bit":
            return bool(self._memory.get((space, wire), 0))
        return unpack_value(kind, [self._memory.get((space, wire + i), 0) for i in range(address.bank.width)])

    def _set(self, name: str, value: Value) -> None:
        address = parse_address(name)
        words = [int(value)] if address.bank.kind == "bit" else pack_value(address.bank.kind, value)
        for i, word in enumerate(words):
            self._memory[address.bank.space, address.wire + i] = word


def recipe_values(setup: GraspSetup) -> list[float]:
    """The five recipe registers of a setup, in their order."""
    return [
        setup.open_gap_mm,
        setup.closed_gap_mm,
        setup.close_speed_mm_per_s,
        setup.lift_speed_mm_per_s,
        setup.max_lift_mm,
    ]
