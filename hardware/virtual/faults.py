"""Every fault that the virtual bench can be given, by name.

A name says what is wrong with the bench, not what the host should do; that is asserted in
`tests/hardware/safety/test_scenarios.py`, one scenario for each.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from fast.hardware.virtual.click import VirtualClick
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.virtual.laumas import VirtualLaumas
from fast.hardware.virtual.modbus_server import ModbusServerThread
from fast.hardware.virtual.world.state import WorldState
from fast.models.errors import UsageError
from fast.models.validation import closest


class FaultyBench(Protocol):
    """The devices of a virtual bench that faults act on."""

    grbl: VirtualGrbl
    plc: VirtualClick
    transmitter: VirtualLaumas
    state: WorldState
    is_lockstep: bool


Act = Callable[[FaultyBench], None]


@dataclass(frozen=True)
class BenchFault:
    """One fault: what it is, how it begins, and how it ends (None: it happens once, or only a new bench helps)."""

    meaning: str
    inject: Act
    end: Act | None = None

    def clear(self, bench: FaultyBench) -> None:
        """End it, if it is one that lasts."""
        if self.end is not None:
            self.end(bench)


def _grbl(meaning: str, name: str, lasts: bool = False, **how: float | str) -> BenchFault:
    return BenchFault(
        meaning,
        lambda bench: bench.grbl.inject(name, **how),
        (lambda bench: bench.grbl.clear(name)) if lasts else None,
    )


def _world(meaning: str, name: str) -> BenchFault:
    return BenchFault(meaning, lambda bench: bench.state.inject(name), lambda bench: bench.state.clear(name))


def _switch_plc_to_stop(bench: FaultyBench) -> None:
    bench.plc.is_running = False


def _switch_plc_to_run(bench: FaultyBench) -> None:
    bench.plc.is_running = True


def _restart_plc(bench: FaultyBench) -> None:
    bench.plc.restart()


def _unplug(server: ModbusServerThread, is_lockstep: bool) -> None:
    """Take a server from the network; its own thread may be the one that moves the world."""
    if is_lockstep:
        server.stop()
    else:
        threading.Thread(target=server.stop, name="unplug", daemon=True).start()


def _unplug_plc(bench: FaultyBench) -> None:
    _unplug(bench.plc.server, bench.is_lockstep)


def _unplug_transmitter(bench: FaultyBench) -> None:
    _unplug(bench.transmitter.server, bench.is_lockstep)


def _press_estop(bench: FaultyBench) -> None:
    """Press the button, which opens the PLC's input and takes the controller's power."""
    bench.state.inject("estop_pressed")
    bench.grbl.inject("power_cut")


def _release_estop(bench: FaultyBench) -> None:
    bench.state.clear("estop_pressed")
    bench.grbl.clear("power_cut")


FAULTS: dict[str, BenchFault] = {
    # Gantry
    "usb_unplugged": _grbl("the line to the gantry hangs up; the machine runs on", "unplug"),
    "grbl_silent": _grbl("the gantry neither hears nor answers", "silent", lasts=True),
    "grbl_reset": _grbl("somebody presses the controller's reset button", "reset"),
    "grbl_power_loss": _grbl("the controller loses its power", "power_cut", lasts=True),
    "hard_limit": _grbl("a limit switch closes in motion (ALARM:1)", "limit", lasts=True),
    "soft_limit": _grbl("a move beyond the box reaches the controller (ALARM:2)", "typed", line="G90 G0 X20"),
    "dead_switch": _grbl("a homing switch does not answer (ALARM:9)", "limit_dead", lasts=True),
    "bad_line": _grbl("the head of the next line to the controller is lost (error:N)", "cut_line", count=1),
    "feed_hold": _grbl("somebody presses feed hold: the move never ends", "hold"),
    "stray_move": _grbl("another program moves the carriage by a millimetre", "typed", line="G91 G1 X1 F6000"),
    "lost_steps": _grbl("the carriage slips by half a millimetre", "nudge", axis="x", distance_mm=0.5),
    # PLC
    "plc_unplugged": BenchFault("the PLC is gone from the network", _unplug_plc),
    "plc_stop": BenchFault("the PLC's switch is turned to STOP", _switch_plc_to_stop, _switch_plc_to_run),
    "plc_restart": BenchFault("the PLC loses its power for a moment", _restart_plc),
    # Air
    "low_air": _world("the mains has 20 psi and its pressure switch opens", "low_air"),
    "leak": _world("the closed gripper loses 3 psi/s", "leak"),
    "grip_valve_stuck": _world("the gripper valve is on and no pressure comes", "grip_valve_stuck"),
    "vent_valve_stuck": _world("the gripper valve is off and the pressure stays", "vent_valve_stuck"),
    # Tool and object
    "lock_sensor_dead": _world("the lock-closed input stays off", "lock_sensor_dead"),
    "slots_empty": _world("the presence inputs of the dock are off", "slots_empty"),
    "tool_lost": _world("the tool falls off the head", "tool_lost"),
    "tool_heavy": _world("the tool weighs 8 % more than the table says", "tool_heavy"),
    "part_dropped": _world("a piece of 50 g falls off the tool", "part_dropped"),
    "object_missing": _world("nothing stands on the mount", "object_missing"),
    "object_slips": _world("the object slips out of the closed fingers", "object_slips"),
    "object_sticks": _world("an object of 200 g hangs on the open fingers", "object_sticks"),
    # Load cell
    "cell_unplugged": _world("the cell's cable is off (status bit 0)", "cell_unplugged"),
    "cell_saturated": _world("the reading is at the rail (status bit 4)", "cell_saturated"),
    "overload": _world("250 N pull the gripper down", "overload"),
    "zero_drift": _world("the free-hanging reading creeps by 0.02 N/s", "zero_drift"),
    "transmitter_frozen": _world("the readings stand still", "transmitter_frozen"),
    "transmitter_unplugged": BenchFault("the transmitter is gone from the network", _unplug_transmitter),
    # People
    "estop": BenchFault(
        "the emergency stop is pressed: PLC input and power of the gantry", _press_estop, _release_estop
    ),
}


def find_fault(name: str) -> BenchFault:
    """Find the fault of a name.

    Raises:
        UsageError: there is none.
    """
    if name not in FAULTS:
        raise UsageError(f"The virtual bench has no fault `{name}`; {closest(name, list(FAULTS))}")
    return FAULTS[name]
