"""State of the virtual world: head, lock, air and the grasp that couples them to the load cell.

The world is stepped by whoever advances time (`step`); device servers only look at it. In lockstep the physics of a
grasp is computed inside `step`, in the thread that waits on the clock; with a clock that runs by itself it is computed
in a worker, and the gripper's pressure does not come up before the answer is there.
"""

import logging
import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass

from fast.hardware.parts.layout import N_SLOTS, BenchLayout
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.hidden import find_lag
from fast.hardware.virtual.world.physics import GraspCurve, PhysicsRequest, SensorNoise, build_request, grasp_curve
from fast.models.errors import SimulationFailed, UsageError
from fast.models.records import EffectValue, GraspSetup, GraspSimulation
from fast.models.units import force_n_from_kg
from fast.models.validation import closest

logger = logging.getLogger(__name__)

HEAD_MASS_KG = 0.85  # tool changer, valve and bracket that hang from the load cell
LOCK_TRAVEL_S = 0.15
AIR_TIME_CONSTANT_S = 0.05
PRESSURE_OK_SHARE = 0.9  # of the set-point, where the pressure switch closes
RESTING_PRESSURE_PSI = 1.0
USUAL_PRESSURE_PSI = 30.0  # the paper's; the pressure switch and the world's effects are set for it
SETTLED_PSI = 1e-3  # closer to its end than a sensor tells, the pressure is there, and the inputs are at rest

FAULTS = (
    "cell_unplugged",  # status bit 0 of the transmitter
    "cell_saturated",  # status bit 4 of the transmitter
    "overload",  # something pulls the gripper down with 250 N
    "zero_drift",  # the free-hanging reading creeps up, `DRIFT_N_PER_S`
    "transmitter_frozen",  # readings stand still
    "low_air",  # the mains has 20 psi, its pressure switch is off
    "leak",  # the closed gripper loses `LEAK_PSI_PER_S`
    "grip_valve_stuck",  # output on, no pressure
    "vent_valve_stuck",  # output off, the pressure stays
    "lock_sensor_dead",  # lock-closed input stays off
    "slots_empty",  # the dock's presence inputs are off
    "tool_lost",  # the tool falls off the head
    "tool_heavy",  # the tool weighs `HEAVY_SHARE` of what the table says
    "part_dropped",  # a piece of `PART_KG` falls off the tool
    "object_missing",  # nothing on the mount
    "object_slips",  # the object slips out of the closed fingers
    "object_sticks",  # the object hangs on the open fingers
    "estop_pressed",
)
OVERLOAD_N = 250.0
DRIFT_N_PER_S = 0.02
LEAK_PSI_PER_S = 3.0
HEAVY_SHARE = 1.08
PART_KG = 0.05
OBJECT_KG = 0.2
LOW_AIR_PSI = 20.0

Solver = Callable[[PhysicsRequest], "Future[GraspSimulation]"]


@dataclass
class _Grasp:
    """A grasp in progress: solving, then closing, then held."""

    solved: "Future[GraspSimulation] | None"
    """Of the solver; None where nothing is between the jaws."""
    request: PhysicsRequest | None
    """What the solver was asked; None as above."""
    setup: GraspSetup
    """Stroke and speeds."""
    z_mm: float
    """Height of the head when the jaws closed."""
    curve: GraspCurve | None = None
    """Force over lift, once it is solved."""
    is_failed: bool = False
    """The solver gave no result."""
    is_released: bool = False
    """The object has left the fingers."""
    closing_since_s: float | None = None
    """When the jaws began to close; None before."""


class WorldState:
    """Everything on the virtual bench that is not inside a controller. `dock_slot`: where the head sits, or None."""

    def __init__(
        self,
        world: World,
        tools: Mapping[int, MountedTool],
        solver: Solver,
        layout: BenchLayout,
        head_position_mm: Callable[[float], tuple[float, float, float]],
        now_s: float = 0.0,
    ) -> None:
        self.world = world
        self.layout = layout
        self.docked: dict[int, MountedTool] = dict(tools)
        self.tool: MountedTool | None = None
        self.faults: set[str] = set()
        self.is_locked = False
        self.pressure_psi = 0.0
        self.supply_psi = 0.0
        self._closing_psi = closing_psi(0.0)
        self.job = (-1, 0)
        self.setup = GraspSetup()
        self.head_yaw_deg = 0.0  # of the gripper about the vertical axis; a gantry has none
        self.gross_n = 0.0
        self.n_readings = 0
        self.is_motor_enabled = True
        self._drift_n = 0.0
        self._lock_output = self._grip_output = self._supply_output = False
        self._lock_moves_until_s: float | None = None
        self._grasp: _Grasp | None = None
        self._solver = solver
        self._position_of = head_position_mm
        self._now_s = now_s
        self._head = (0.0, 0.0, 0.0)
        self.dock_slot: int | None = None
        self._move_head(now_s)
        self._noise = SensorNoise(world, "none", -1, 0)
        self._lag = find_lag(world.hidden)
        self._last_reading = math.floor(now_s * world.sensor.rate_hz)

    # What the ladder does

    def set_outputs(self, lock: bool, grip: bool, supply: bool, setpoint_psi: float) -> None:
        """Set the valve outputs of the PLC, as of this scan."""
        if lock != self._lock_output:
            self._lock_output = lock
            self._lock_moves_until_s = self._now_s + LOCK_TRAVEL_S
        if grip and not self._grip_output:
            self._grasp = self._begin_grasp()
        self._grip_output, self._supply_output = grip, supply
        self.supply_psi = setpoint_psi if self.is_supply_ok else LOW_AIR_PSI
        self._closing_psi = closing_psi(self.supply_psi)

    def start_job(self, object_id: int, repeat: int) -> None:
        """Start the next grasp, labelled by the host: its noise starts here, so that a resumed bench draws the same."""
        self.job = (object_id, repeat)
        tool_id = self.tool.tool_id if self.tool else "none"
        self._noise = SensorNoise(self.world, tool_id, object_id, repeat)

    def inject(self, fault: str) -> None:
        """Switch a named fault on.

        Raises:
            UsageError: unknown name.
        """
        if fault not in FAULTS:
            raise UsageError(f"The virtual bench has no fault `{fault}`; {closest(fault, list(FAULTS))}")
        self.faults.add(fault)
        if fault == "tool_lost":
            self.tool = None

    def clear(self, fault: str) -> None:
        """Switch a named fault off; unknown or absent faults are ignored."""
        self.faults.discard(fault)

    @property
    def outputs(self) -> tuple[bool, bool, bool]:
        """Lock, grip and supply valve as the ladder drives them."""
        return self._lock_output, self._grip_output, self._supply_output

    # What sensors see

    @property
    def input_state(self) -> tuple[object, ...]:
        """All that the inputs of the PLC follow from: equal states give equal inputs."""
        is_lock_moving = self._lock_moves_until_s is not None
        tool_id = self.tool.tool_id if self.tool is not None else None
        return (
            self.dock_slot,
            self.is_locked,
            is_lock_moving,
            tool_id,
            len(self.docked),
            self.pressure_psi,
            *self.faults,
        )

    @property
    def is_lock_closed(self) -> bool:
        """Lock-closed input."""
        return self.is_locked and self._lock_moves_until_s is None and "lock_sensor_dead" not in self.faults

    @property
    def is_lock_open(self) -> bool:
        """Lock-open input."""
        return not self.is_locked and self._lock_moves_until_s is None

    @property
    def is_tool_present(self) -> bool:
        """Tool-present input of the head: a tool is on it, or under it in the dock."""
        return self.tool is not None or self.dock_slot in self.docked

    def is_slot_full(self, slot: int) -> bool:
        """Return the presence input of a dock slot: also on while a carried tool is seated in it."""
        is_seated = slot in self.docked or (self.tool is not None and self.dock_slot == slot)
        return is_seated and "slots_empty" not in self.faults

    @property
    def is_supply_ok(self) -> bool:
        """Pressure switch of the air mains, before the supply valve."""
        return "low_air" not in self.faults

    @property
    def is_pressure_ok(self) -> bool:
        """Pressure switch of the gripper line, set to 90 % of 30 psi."""
        return self.pressure_psi >= PRESSURE_OK_SHARE * USUAL_PRESSURE_PSI

    @property
    def has_sensor_fault(self) -> bool:
        """The transmitter shows a converter fault: the world has no answer for this grasp."""
        return self._grasp is not None and self._grasp.is_failed

    def grasp_force_n(self) -> float:
        """Return the true force of the object on the gripper now, in N; > 0 pulls down."""
        grasp = self._grasp
        if grasp is None or grasp.curve is None or grasp.closing_since_s is None or self.tool is None:
            return 0.0
        lift_mm = self._head[2] - grasp.z_mm
        if lift_mm >= grasp.curve.release_lift_mm or "object_slips" in self.faults:
            grasp.is_released = True
        if grasp.is_released:
            return 0.0
        share = self._closing_share(grasp)
        force_n = grasp.curve.lift_force_at(lift_mm) if share >= 1.0 else grasp.curve.closing_force_at(share)
        held = min(self.pressure_psi / self._closing_psi, 1.0)  # opening jaws let go
        return force_n * held

    # Time

    def step(self, now_s: float) -> None:
        """Advance to `now_s`: lock, air, grasp, drift, reading."""
        self._move_head(now_s)
        duration_s, self._now_s = now_s - self._now_s, now_s
        self._move_lock(now_s)
        self._move_air(duration_s)
        self._move_jaws(now_s)
        if "zero_drift" in self.faults:
            self._drift_n += DRIFT_N_PER_S * duration_s
        self._take_reading(now_s)

    def _move_head(self, now_s: float) -> None:
        head_mm = self._position_of(now_s)
        if head_mm is not self._head:
            self._head = head_mm
            self.dock_slot = self.layout.dock_at(*head_mm)

    def _move_lock(self, now_s: float) -> None:
        if self._lock_moves_until_s is None or now_s < self._lock_moves_until_s:
            return
        self._lock_moves_until_s = None
        self.is_locked = self._lock_output
        slot = self.dock_slot
        if self.is_locked and self.tool is None and slot in self.docked:
            self.tool = self.docked.pop(slot)
        elif not self.is_locked and self.tool is not None:
            if slot is None:
                logger.error("Virtual bench: tool %s fell off, the lock was opened outside the dock", self.tool.tool_id)
            else:
                self.docked[slot] = self.tool
            self.tool = None

    def _move_air(self, duration_s: float) -> None:
        grasp = self._grasp
        is_waiting = grasp is not None and grasp.solved is not None and not grasp.solved.done()
        if "leak" in self.faults and self._grip_output:
            self.pressure_psi = max(self.pressure_psi - LEAK_PSI_PER_S * duration_s, 0.0)
            return
        if "grip_valve_stuck" in self.faults or not (self._grip_output or "vent_valve_stuck" in self.faults):
            target_psi = 0.0
        elif self._grip_output and self._supply_output and not is_waiting:
            target_psi = max(self.supply_psi, self.pressure_psi)
        else:
            target_psi = self.pressure_psi  # trapped by the check valve
        decay = math.exp(-duration_s / AIR_TIME_CONSTANT_S)
        left_psi = (self.pressure_psi - target_psi) * decay
        self.pressure_psi = target_psi + (left_psi if abs(left_psi) > SETTLED_PSI else 0.0)

    def _move_jaws(self, now_s: float) -> None:
        grasp = self._grasp
        if grasp is None:
            return
        if not self._grip_output and self.pressure_psi < RESTING_PRESSURE_PSI:
            self._grasp = None
            return
        if grasp.solved is not None and grasp.solved.done():
            self._take_result(grasp, grasp.solved)
            grasp.solved = None
        if grasp.closing_since_s is None and self.pressure_psi >= self._closing_psi:
            grasp.closing_since_s = now_s

    def _closing_share(self, grasp: _Grasp) -> float:
        stroke_mm = max(grasp.setup.open_gap_mm - grasp.setup.closed_gap_mm, 1e-6) / 2
        since_s = self._now_s if grasp.closing_since_s is None else grasp.closing_since_s
        return min((self._now_s - since_s) * grasp.setup.close_speed_mm_per_s / stroke_mm, 1.0)

    def _begin_grasp(self) -> _Grasp:
        """Start the physics for the object under the head, if there is one and a tool to grip it."""
        x_mm, y_mm, z_mm = self._head
        object_id = None if "object_missing" in self.faults else self.layout.object_at(x_mm, y_mm)
        if self.tool is None or object_id is None:
            return _Grasp(None, None, self.setup, z_mm)
        # 0.05 mm is below what the axes resolve; it makes equal grasps equal requests
        tip_below_mm = _to_resolution(self.layout.tip_below_mm(self.tool.design, z_mm))
        at_mm = self.layout.object_xy_mm(object_id)
        offset_mm = (_to_resolution(at_mm[0] - x_mm), _to_resolution(at_mm[1] - y_mm))
        if tip_below_mm < -self.layout.object_height_mm:
            return _Grasp(None, None, self.setup, z_mm)  # closed in the air over the object
        setup = self.setup.model_copy(update={"tip_below_mm": tip_below_mm})
        world = at_pressure(self.world, self.supply_psi / USUAL_PRESSURE_PSI)
        request = build_request(
            world, self.tool.tool_id, self.tool.design, object_id, setup, offset_mm, -self.head_yaw_deg
        )
        return _Grasp(self._solver(request), request, setup, z_mm)

    def _take_result(self, grasp: _Grasp, solved: "Future[GraspSimulation]") -> None:
        request = grasp.request
        if request is None:
            return
        try:
            simulation = solved.result()
        except SimulationFailed as failure:
            logger.warning("Virtual bench: no physics for %d (%s): %s", request.object_id, failure.reason, failure)
            grasp.is_failed = True
            return
        grasp.curve = grasp_curve(simulation, self.world, request, self.job[1])

    def _take_reading(self, now_s: float) -> None:
        reading = math.floor(now_s * self.world.sensor.rate_hz + 1e-6)
        if reading <= self._last_reading:
            return
        noise_n = self._noise.advance(reading - self._last_reading)
        self._last_reading = reading
        if "transmitter_frozen" in self.faults:
            return
        pull_n = OVERLOAD_N if "overload" in self.faults else 0.0
        grasp_n = self.grasp_force_n()
        felt_n = grasp_n if self._lag is None else self._lag.report(now_s, grasp_n)
        self.gross_n = force_n_from_kg(self._hanging_kg()) + felt_n + pull_n + self._drift_n + noise_n
        self.n_readings += 1

    def _hanging_kg(self) -> float:
        """Return the mass of head, tool, and what hangs on it."""
        mass_kg = HEAD_MASS_KG
        if self.tool is not None and self.dock_slot is None:
            mass_kg += self.tool.expected_mass_kg * (HEAVY_SHARE if "tool_heavy" in self.faults else 1.0)
            mass_kg -= PART_KG if "part_dropped" in self.faults else 0.0
        return mass_kg + (OBJECT_KG if "object_sticks" in self.faults else 0.0)


def _to_resolution(length_mm: float) -> float:
    """Round the length to steps of 0.05 mm; never -0.0, which would be another request."""
    return round(length_mm * 20) / 20 + 0.0


def closing_psi(supply_psi: float) -> float:
    """Return the pressure at which the jaws move, at this setting of the supply."""
    return PRESSURE_OK_SHARE * max(min(supply_psi, USUAL_PRESSURE_PSI), RESTING_PRESSURE_PSI)


def at_pressure(world: World, share: float) -> World:
    """Return the world at this share of the usual supply pressure: a cylinder's force goes with its pressure."""
    if abs(share - 1.0) < 1e-6:
        return world
    hidden = tuple(
        EffectValue(effect=value.effect, parameters={"max_force_n": value.parameters["max_force_n"] * share})
        if value.effect == "force_limited_closing"
        else value
        for value in world.hidden
    )
    return world.model_copy(update={"hidden": hidden})


def slots_full(state: WorldState) -> list[bool]:
    """Return the presence inputs of all dock slots, 0 to 9."""
    return [state.is_slot_full(slot) for slot in range(N_SLOTS)]
