"""Gripper air: supply, grip and vent, each confirmed by reading back outputs and pressure."""

from fast.hardware.click import tags
from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import Clock
from fast.hardware.parts.safe_state import EmergencyStopError
from fast.models.errors import DeviceError, InterlockError
from fast.models.records import GraspSetup

_LOWEST_SHARE = 28.0 / 30.0  # of the set-point: less does not close the jaws fully
_HIGHEST_SHARE = 1.1  # of the set-point: more is another grasp than the one that is recorded


class Pneumatics:
    """Supply valve and gripper valve behind the PLC. Every method is an intent and safe to repeat.

    `pressure_time_out_s`: how long the gripper's pressure may take to come up.
    """

    def __init__(
        self, plc: ClickPlc, clock: Clock, supply_pressure_psi: float = 30.0, pressure_time_out_s: float = 2.0
    ) -> None:
        self.supply_pressure_psi = supply_pressure_psi
        self._usual_pressure_psi = supply_pressure_psi
        self._plc = plc
        self._clock = clock
        self._time_out_s = pressure_time_out_s

    def check_air(self) -> None:
        """Refuse to go on with the emergency stop pressed.

        Raises:
            EmergencyStopError: the emergency stop is not released.
        """
        if self.is_estop_pressed():
            raise EmergencyStopError(
                "The emergency stop is pressed. Release it, acknowledge at the panel, then home and check the tool."
            )

    def is_estop_pressed(self) -> bool:
        """Read the emergency-stop input."""
        return not self._plc.read_bit(tags.ESTOP_OK_INPUT)

    def is_supply_ok(self) -> bool:
        """Return whether the air mains has its pressure."""
        return self._plc.read_bit(tags.SUPPLY_OK_INPUT)

    def open_supply(self) -> None:
        """Set the pressure and open the supply valve."""
        self.check_air()
        self._plc.write_many(tags.SUPPLY_SETPOINT_REGISTER, [self.supply_pressure_psi])
        self._plc.write_bit(tags.SUPPLY_REQUEST, True)
        self._plc.wait_for({tags.SUPPLY_OUTPUT: True}, 1.0, "Opening the air supply")

    def set_supply_pressure(self, psi: float | None) -> None:
        """Set the pressure for the next grasps, with the supply open; None is the bench's usual one."""
        wanted_psi = self._usual_pressure_psi if psi is None else psi
        if wanted_psi != self.supply_pressure_psi:
            self.supply_pressure_psi = wanted_psi
            self.open_supply()

    def close_supply(self) -> None:
        """Close the supply valve; a closed gripper keeps its pressure behind the check valve."""
        self._plc.write_bit(tags.SUPPLY_REQUEST, False)
        self._plc.wait_for({tags.SUPPLY_OUTPUT: False}, 1.0, "Closing the air supply")

    def set_stroke(self, setup: GraspSetup) -> None:
        """Write the stroke recipe (gaps, speeds, longest lift) to the PLC, which shows and logs it."""
        values = [setup.open_gap_mm, setup.closed_gap_mm, setup.close_speed_mm_per_s, setup.lift_speed_mm_per_s,
                  setup.max_lift_mm]  # fmt: skip
        self._plc.write_many(tags.FIRST_RECIPE_REGISTER, list(values))

    def label_job(self, object_id: int, repeat: int) -> None:
        """Tell the PLC's panel which object is next."""
        self._plc.write_many(tags.JOB_OBJECT_REGISTER, [object_id, repeat])

    def is_gripping(self) -> bool:
        """Return whether the gripper valve is on."""
        return self._plc.read_bit(tags.GRIP_OUTPUT)

    def pressure_psi(self) -> float:
        """Return the measured gripper pressure in psi."""
        return self._plc.read_float(tags.PRESSURE_REGISTER)

    def grip(self) -> None:
        """Close the jaws: returns when the pressure switch closes, which is when the jaws start to move.

        Raises:
            InterlockError: no tool locked, emergency stop, valve output off.
            DeviceError: the pressure did not come up; the valve is switched off again.
        """
        self.check_air()
        if not self._plc.read_bit(tags.LOCK_CLOSED_INPUT):
            raise InterlockError("The tool lock is not closed; the gripper stays open. Look at the head.")
        self._plc.request(tags.GRIP_REQUEST, {tags.GRIP_OUTPUT: True}, 1.0, "Switching the gripper valve on")
        deadline_s = self._clock.now_s() + self._time_out_s
        while not self._is_pressure_up():
            if self._clock.now_s() >= deadline_s:
                psi = self.pressure_psi()
                self.vent()
                raise DeviceError(
                    f"The gripper has {psi:.0f} psi {self._time_out_s:g} s after its valve opened, it needs "
                    f"{self._lowest_psi:.0f} psi. The gripper is open again; check the air supply and the valve."
                )
            self._clock.sleep(0.01)

    def check_pressure(self) -> None:
        """Confirm the closing pressure once the jaws are at their stop.

        Raises:
            DeviceError: below 28/30 of the set-point, or more than a tenth above it.
        """
        psi = self.pressure_psi()
        if psi < self._lowest_psi:
            raise DeviceError(
                f"The closed gripper has {psi:.1f} psi, it needs {self._lowest_psi:.1f} psi; check for a leak, and "
                f"that the ladder writes psi into {tags.PRESSURE_REGISTER}."
            )
        highest_psi = _HIGHEST_SHARE * self.supply_pressure_psi
        if psi > highest_psi:
            raise DeviceError(
                f"The closed gripper has {psi:.1f} psi, at most {highest_psi:.1f} psi fit the "
                f"{self.supply_pressure_psi:g} psi that were set; check that the regulator follows "
                f"{tags.SUPPLY_SETPOINT_REGISTER}, and that the ladder writes psi into {tags.PRESSURE_REGISTER}."
            )

    def vent(self) -> None:
        """Open the jaws: returns when valve output and pressure are down.

        Raises:
            InterlockError: the output or the pressure stays on; do not lift.
        """
        confirm = {tags.GRIP_OUTPUT: False, tags.PRESSURE_OK_INPUT: False}
        self._plc.request(tags.VENT_REQUEST, confirm, 2.0, "Venting the gripper")
        self._clock.sleep(0.3)  # the jaws need the rest of the air out

    def _is_pressure_up(self) -> bool:
        """Ask the switch, which is set for the usual pressure; below it, the measured pressure must do."""
        if self.supply_pressure_psi >= self._usual_pressure_psi:
            return self._plc.read_bit(tags.PRESSURE_OK_INPUT)
        return self.pressure_psi() >= self._lowest_psi

    @property
    def _lowest_psi(self) -> float:
        return _LOWEST_SHARE * self.supply_pressure_psi
