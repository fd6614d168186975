"""The arm behind the wire: runs programs, moves along straight lines, and feels what the world pulls with."""

import logging
import threading
from collections import defaultdict
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from scipy.spatial.transform import Rotation

from fast.hardware.arm.settings import ArmSettings, Point
from fast.hardware.parts.layout import N_OBJECTS, N_SLOTS, BenchLayout
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.arm.urscript import Move, Output, Register, Statement, Stop, read_program
from fast.hardware.virtual.world.file import World
from fast.hardware.virtual.world.physics import Physics, PhysicsCache, PhysicsRequest
from fast.hardware.virtual.world.state import USUAL_PRESSURE_PSI, WorldState
from fast.models.records import GraspSimulation

logger = logging.getLogger(__name__)

GRIPPER_MM = 120.0  # from the flange to the base of the fingers
RUNNING, IDLE = 7, 5  # robot modes: brakes open, closed
NORMAL, PROTECTIVE_STOP, SAFEGUARD_STOP, EMERGENCY_STOP = 1 << 0, 1 << 2, 1 << 4, 1 << 7  # safety_status_bits
_STOPPED, _PLAYING, _PAUSED = 1, 2, 4  # runtime states
_ORIGIN_MM = (750.0, 750.0)  # of the base frame, on the sheet
_DOWN = (0.0, np.pi, 0.0)
_PHYSICS_PATIENCE_S = 300.0  # a virtual gripper has its pressure when its physics is solved
_TRAVEL_ABOVE_MM = 30.0  # the rack's highest motion

Tools = Mapping[int, MountedTool]


class VirtualArm:
    """State of the controller; `advance` moves time, everything else only looks or writes. Thread-safe.

    tools: in the rack, by slot. fresh_tools: asked whenever the empty flange comes to the rack, so that a rack that a
    person fills anew need not be told.
    """

    def __init__(
        self,
        world: World,
        tools: Tools,
        physics: Physics,
        fresh_tools: Callable[[], Tools] | None = None,
        layout: BenchLayout = BenchLayout(),  # noqa: B008 - frozen record
    ) -> None:
        self.layout = layout
        self.lock = threading.RLock()
        self.is_protective_stopped = self.is_powered_off = False
        self.is_safeguard_open = self.is_paused = False  # the program waits, and goes on afterwards
        self.speed_share = 1.0
        self._physics = PhysicsCache(physics)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="virtual-physics")
        self._fresh_tools = fresh_tools
        self._now_s = 0.0
        above_mm = to_base(layout, 750.0, 750.0, layout.top_z_mm)
        self._pose = np.array([*(value / 1000.0 for value in above_mm), *_DOWN])
        self._head = self._find_head_mm()
        self._ran_at_s = 0.0
        self._program: list[Statement] = []
        self._pending: Future[GraspSimulation] | None = None
        self._registers: dict[int, int] = {}
        self._outputs = 0
        self._n_grasps: dict[tuple[str, int], int] = defaultdict(int)
        self.world = WorldState(world, tools, self._solve, layout, self._head_mm)

    def settings(self, host: str, script_port: int) -> ArmSettings:
        """Return the bench file of this arm."""
        layout = self.layout
        rack = [(*layout.dock_xy_mm(slot), layout.dock_z_mm) for slot in range(N_SLOTS)]
        placed = [i for i in (*range(N_OBJECTS), *dict(layout.own_objects)) if layout.has_place(i)]
        mounts = {i: to_base(layout, *layout.object_xy_mm(i), 0.0) for i in placed}
        return ArmSettings(
            kind="ur",
            host=host,
            script_port=script_port,
            gripper_mm=GRIPPER_MM,
            travel_z_mm=to_base(layout, 0.0, 0.0, layout.workspace_mm[2])[2] + _TRAVEL_ABOVE_MM,
            pressure_time_out_s=_PHYSICS_PATIENCE_S,
            rack_mm=tuple(to_base(layout, *place) for place in rack),
            mounts_mm={i: (x, y, layout.mount_height_mm) for i, (x, y, _) in mounts.items()},
        )

    def close(self) -> None:
        """Let the solver go."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def run_program(self, text: str) -> None:
        """Take a program in the place of the one that runs; one that is not understood is refused, as by a robot."""
        try:
            statements = read_program(text)
        except ValueError as error:
            logger.warning("Virtual arm: program refused: %s", error)
            return
        with self.lock:
            if self._may_move:
                self.is_paused = False  # it takes the place of the one that waits
                self._program, self._ran_at_s = statements, self._now_s

    @property
    def _may_move(self) -> bool:
        return not (self.is_protective_stopped or self.is_powered_off or "estop_pressed" in self.world.faults)

    def advance(self, duration_s: float) -> None:
        """Move program, arm and world by some time."""
        with self.lock:
            self._now_s += duration_s
            if not self._may_move:
                self._program = []
            left_s = duration_s
            if self._program:
                self._ran_at_s = self._now_s
            if self.is_safeguard_open or self.is_paused:
                left_s = 0.0
            while self._program and left_s > 0.0:
                left_s = self._step_program(left_s)
            self._refill_rack()
            self.world.step(self._now_s)

    def values(self) -> dict[str, float | list[float]]:
        """Return the variables of RTDE now."""
        with self.lock:
            pose = self._pose.tolist()
            is_down = "estop_pressed" in self.world.faults
            is_stopped = self.is_protective_stopped
            safety = EMERGENCY_STOP if is_down else PROTECTIVE_STOP if is_stopped else NORMAL
            safety |= SAFEGUARD_STOP * self.is_safeguard_open
            return {
                "timestamp": self._now_s,
                "actual_TCP_pose": pose,
                "target_TCP_pose": pose,
                "actual_TCP_force": [0.0, 0.0, -self.world.gross_n, 0.0, 0.0, 0.0],
                "robot_mode": IDLE if self.is_powered_off else RUNNING,
                "safety_status_bits": safety,
                "runtime_state": _PAUSED if self.is_paused else _PLAYING if self._program else _STOPPED,
                "target_speed_fraction": self.speed_share,
                "actual_digital_input_bits": int(self.world.is_pressure_ok),
                "actual_digital_output_bits": self._outputs,
                **{f"output_int_register_{number}": value for number, value in self._registers.items()},
            }

    def _step_program(self, left_s: float) -> float:
        """Carry out the first statement for as long as it takes; returns the time that is left."""
        statement = self._program[0]
        if isinstance(statement, Move):
            distance_m = float(np.linalg.norm(statement.pose[:3] - self._pose[:3]))
            speed_m_per_s = self.speed_share * statement.speed_m_per_s
            share = min(1.0, speed_m_per_s * left_s / distance_m) if distance_m > 1e-9 else 1.0
            self._turn(statement.pose, share)
            if share < 1.0:
                return 0.0
            left_s -= distance_m / speed_m_per_s
        elif isinstance(statement, Output):
            mask = 1 << statement.number
            self._outputs = self._outputs | mask if statement.is_on else self._outputs & ~mask
            self._drive()
        elif isinstance(statement, Register):
            self._registers[statement.number] = statement.value
        else:
            assert isinstance(statement, Stop)  # a program that stops has already replaced the motion
        self._program.pop(0)
        return left_s

    def _turn(self, pose: np.ndarray, share: float) -> None:
        start, end = Rotation.from_rotvec(self._pose[3:]), Rotation.from_rotvec(pose[3:])
        turn = (end * start.inv()).as_rotvec() * share
        place = self._pose[:3] + share * (pose[:3] - self._pose[:3])
        self._pose = np.concatenate([place, (Rotation.from_rotvec(turn) * start).as_rotvec()])
        self._head = self._find_head_mm()

    def _drive(self) -> None:
        """Drive the valves: output 0 closes the gripper, output 1 locks the tool."""
        grip, lock = bool(self._outputs & 1), bool(self._outputs & 2)
        world = self.world
        if grip and not world.outputs[1]:
            world.head_yaw_deg = self._yaw_deg()
            x_mm, y_mm, _ = self._head_mm(self._now_s)
            object_id = self.layout.object_at(x_mm, y_mm)
            if world.tool is not None and object_id is not None:
                key = world.tool.tool_id, object_id
                world.start_job(object_id, self._n_grasps[key])
                self._n_grasps[key] += 1
        world.set_outputs(lock, grip, True, USUAL_PRESSURE_PSI)

    def _yaw_deg(self) -> float:
        turned = Rotation.from_rotvec(self._pose[3:]) * Rotation.from_rotvec(_DOWN).inv()
        return float(np.round(np.degrees(turned.as_rotvec()[2]), 3))

    def _refill_rack(self) -> None:
        if self._fresh_tools is None or self.world.tool is not None or self._outputs & 2:
            return
        place = self.layout.dock_at(*self._head_mm(self._now_s))
        if place is not None and self.world.dock_slot is None:  # it has just come down
            self.world.docked.update(self._fresh_tools())

    def _head_mm(self, now_s: float) -> Point:
        """Give the flange in the layout's words: x, y on the sheet, z of the head; the same object where it stands."""
        return self._head

    def _find_head_mm(self) -> Point:
        x, y, z = (1000.0 * self._pose[:3]).tolist()
        return x + _ORIGIN_MM[0], y + _ORIGIN_MM[1], z - GRIPPER_MM - self.layout.head_offset_mm

    def _solve(self, request: PhysicsRequest) -> "Future[GraspSimulation]":
        self._pending = self._worker.submit(self._physics, request)
        return self._pending

    @property
    def is_solving(self) -> bool:
        """Whether the physics of a grasp is being worked out: then time should not be faster than the computer's."""
        return self._pending is not None and not self._pending.done()

    @property
    def rest_s(self) -> float:
        """Time since the last program, 0 while one runs."""
        return self._now_s - self._ran_at_s


def to_base(layout: BenchLayout, x_mm: float, y_mm: float, z_mm: float) -> Point:
    """Return where the flange is in the base frame when the head is at a place of the layout."""
    return x_mm - _ORIGIN_MM[0], y_mm - _ORIGIN_MM[1], z_mm + layout.head_offset_mm + GRIPPER_MM
