"""The bench file of an arm: its address, and where things are in its base frame."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from fast.hardware.parts.limits import BenchLimits
from fast.models.errors import UsageError
from fast.models.records import Design, GraspSetup, Record

Point = tuple[float, float, float]
_USUAL = GraspSetup()
_FIXED_GRIPPER = BenchLimits(
    open_gap_mm=(_USUAL.open_gap_mm, _USUAL.open_gap_mm),
    closed_gap_mm=(_USUAL.closed_gap_mm, _USUAL.closed_gap_mm),
    close_speed_mm_per_s=(_USUAL.close_speed_mm_per_s, _USUAL.close_speed_mm_per_s),
    lift_speed_mm_per_s=(0.5, 100.0),
    yaw_deg=(-90.0, 90.0),
)


class ArmSettings(Record):
    """Addresses and places of an arm; lengths in mm, angles in rad, in the base frame of the robot, z up.

    The controller's RTDE port is always 30004. Digital outputs and inputs are the standard ones of the control box.
    """

    kind: Literal["ur"] = Field(description="Universal Robots, CB3 or e-Series, in remote control")
    host: str = Field(min_length=1, description="address of the controller")
    script_port: int = Field(default=30002, ge=1, le=65535, description="secondary interface, which takes URScript")
    rate_hz: float = Field(default=125.0, ge=10, le=500, description="of RTDE; 125 on CB3, up to 500 on e-Series")
    down_rotation_rad: Point = Field(
        default=(0.0, 3.14159265, 0.0), description="rotation vector of the flange when the gripper points down"
    )
    gripper_mm: float = Field(default=120.0, gt=0, description="from the flange to the base of the fingers")
    travel_z_mm: float = Field(description="height of the flange between places, over everything")
    rack_mm: tuple[Point, ...] = Field(min_length=1, max_length=10, description="flange when the tool of a slot hangs")
    mounts_mm: dict[int, Point] = Field(min_length=1, description="by object: middle of the top of its mount")
    travel_speed_mm_per_s: float = Field(default=250.0, gt=0, le=1000)
    """Between places."""
    dock_speed_mm_per_s: float = Field(default=50.0, gt=0, le=250, description="into and out of the rack and the grasp")
    acceleration_mm_per_s2: float = Field(default=500.0, gt=0, le=5000)
    """Of all moves."""
    grip_output: Annotated[int, Field(ge=0, le=7)] = 0
    """Digital output that closes the jaws."""
    lock_output: Annotated[int, Field(ge=0, le=7)] = 1
    """Digital output that locks the tool."""
    pressure_input: int | None = Field(
        default=0, ge=0, le=7, description="pressure switch of the gripper's line; none: wait `air_s` instead"
    )
    pressure_time_out_s: float = Field(default=10.0, gt=0, description="until the pressure switch must be on")
    air_s: float = Field(default=0.5, gt=0, le=10, description="until the gripper's line has its pressure, or lost it")
    most_force_n: float = Field(default=100.0, gt=0, le=500, description="a stronger pull ends the grasp as failed")
    limits: BenchLimits = _FIXED_GRIPPER
    """What a grasp can set."""

    @model_validator(mode="after")
    def _check_outputs(self) -> "ArmSettings":
        if self.grip_output == self.lock_output:
            raise ValueError(f"grip_output and lock_output are both {self.grip_output}; a tool would fall: change one")
        return self

    def grasp_mm(self, design: Design, object_id: int, setup: GraspSetup) -> Point:
        """Return the flange at a grasp with the object midway between the fingers; tips lie under the object's bottom.

        Raises:
            UsageError: it is not said where the object stands, or the longest lift ends above the travel height.
        """
        if object_id not in self.mounts_mm:
            raise UsageError(f"Object {object_id} has no place in mounts_mm of the bench file; teach and add it.")
        x, y, z = self.mounts_mm[object_id]
        z += design.height_mm - setup.tip_below_mm + self.gripper_mm
        if z + setup.max_lift_mm > self.travel_z_mm:
            raise UsageError(
                f"A lift of {setup.max_lift_mm:g} mm on object {object_id} ends with the flange at "
                f"{z + setup.max_lift_mm:.0f} mm, travel_z_mm is {self.travel_z_mm:g}; raise it or lift less."
            )
        return x, y, z
