"""Picking tools from the dock and putting them back, every step proven by a sensor before the next."""

import logging
from collections.abc import Mapping

from hardware.click import tags
from hardware.click.driver import ClickPlc
from hardware.clock import Clock
from hardware.force_sensor import ForceSensor
from hardware.gantry import Gantry
from hardware.layout import BenchLayout
from hardware.safety import EmergencyStopError, FreezeError
from hardware.tools import MountedTool
from models.errors import InterlockError
from models.units import force_n_from_kg

logger = logging.getLogger(__name__)

MASS_TOLERANCE = 0.05  # of the tool's mass
_LOCK_TIME_OUT_S = 2.0
_WEIGH_S = 2.0  # averages the cell's noise well below the tolerance


class ToolChanger:
    """The quick-change head and the dock. `tools` says what stands in which slot."""

    def __init__(
        self,
        gantry: Gantry,
        plc: ClickPlc,
        force: ForceSensor,
        clock: Clock,
        tools: Mapping[int, MountedTool],
        layout: BenchLayout,
    ) -> None:
        self.tools = dict(tools)
        self._gantry = gantry
        self._plc = plc
        self._force = force
        self._clock = clock
        self._layout = layout

    def is_locked(self) -> bool:
        """Lock-closed sensor."""
        return self._plc.read_bit(tags.LOCK_CLOSED_INPUT)

    def full_slots(self) -> list[int]:
        """Dock slots whose presence sensor is on."""
        bits = self._plc.read_bits(tags.FIRST_DOCK_INPUT, tags.N_DOCK_SLOTS)
        return [slot for slot, is_full in enumerate(bits) if is_full]

    def current_slot(self) -> int | None:
        """Slot of the tool on the head, from the sensors alone, or None with an empty head.

        Raises:
            InterlockError: the sensors do not name one tool.
        """
        is_present = self._plc.read_bit(tags.TOOL_PRESENT_INPUT)
        if not is_present:
            return None
        if not self.is_locked():
            raise InterlockError("A tool is on the head but the lock is not closed. Don't move; a person must look.")
        empty = sorted(set(self.tools) - set(self.full_slots()))
        if len(empty) != 1:
            raise InterlockError(
                f"A tool is on the head, but {len(empty)} slots of the tool table are empty ({empty}) instead of one. "
                "Put the dock in order, then continue."
            )
        return empty[0]

    def pick(self, slot: int) -> MountedTool:
        """Fetch the tool of a slot; another tool on the head is docked first. Done already: nothing moves.

        Raises:
            InterlockError: slot empty, lock not confirmed, or the mass is not the tool's: nothing leaves the dock.
        """
        tool = self.tools.get(slot)
        if tool is None:
            raise InterlockError(f"Slot {slot} has no tool in the tool table ({sorted(self.tools)}); choose another.")
        current = self.current_slot()
        if current == slot:
            return tool
        if current is not None:
            self.dock()
        if slot not in self.full_slots():
            raise InterlockError(f"Slot {slot} should hold {tool.tool_id}, its sensor shows it empty; check the dock.")
        self._to_slot(slot)
        free_n = self._weigh()
        self._gantry.move_to(z_mm=self._layout.dock_z_mm)
        self._clock.sleep(0.05)
        if not self._plc.read_bit(tags.TOOL_PRESENT_INPUT):
            raise InterlockError(f"Slot {slot}: the head does not feel tool {tool.tool_id}; it stays in the dock.")
        self._lock(slot)
        self._gantry.move_to(z_mm=self._layout.top_z_mm)
        self._check_mass(tool, self._weigh() - free_n)
        logger.info("Picked tool %s from slot %d", tool.tool_id, slot)
        return tool

    def dock(self) -> None:
        """Put the tool on the head back into its slot; with an empty head nothing moves.

        Raises:
            InterlockError: the tool is not seated, or the lock does not open; the tool stays locked.
        """
        slot = self.current_slot()
        if slot is None:
            return
        self._to_slot(slot)
        self._gantry.move_to(z_mm=self._layout.dock_z_mm)
        self._clock.sleep(0.05)
        if slot not in self.full_slots():
            raise InterlockError(f"Slot {slot} does not feel the tool that was lowered into it; it stays locked.")
        self._plc.request(
            tags.UNLOCK_REQUEST,
            {tags.LOCK_CLOSED_INPUT: False, tags.LOCK_OPEN_INPUT: True},
            _LOCK_TIME_OUT_S,
            f"Unlocking the tool in slot {slot}",
        )
        self._gantry.move_to(z_mm=self._layout.top_z_mm)
        self._clock.sleep(0.05)
        if self._plc.read_bit(tags.TOOL_PRESENT_INPUT):
            raise InterlockError(f"The tool of slot {slot} came up with the head after unlocking. Don't move; look.")
        logger.info("Docked tool %s in slot %d", self.tools[slot].tool_id, slot)

    def check_carrying(self) -> None:
        """Prove that lock and tool are still there.

        Raises:
            EmergencyStopError: pressed.
            FreezeError: lock or tool sensor off while a tool is carried.
        """
        bits = self._plc.read_bits(tags.FIRST_INPUT, tags.N_INPUTS)
        is_closed, _, is_present, _, is_estop_ok, _ = bits
        if not is_estop_ok:
            raise EmergencyStopError("The emergency stop was pressed. Release it, then home and check the tool.")
        if not (is_closed and is_present):
            missing = "lock" if not is_closed else "tool"
            raise FreezeError(
                f"The {missing} sensor went off while a tool is on the head. Motion is held; don't switch anything, "
                "look at the head."
            )

    def _to_slot(self, slot: int) -> None:
        x_mm, y_mm = self._layout.dock_xy_mm(slot)
        self._gantry.move_to(z_mm=self._layout.top_z_mm)
        self._gantry.move_to(x_mm=x_mm, y_mm=y_mm)

    def _lock(self, slot: int) -> None:
        confirm = {tags.LOCK_CLOSED_INPUT: True, tags.LOCK_OPEN_INPUT: False}
        self._plc.request(tags.LOCK_REQUEST, confirm, _LOCK_TIME_OUT_S, f"Locking the tool of slot {slot}")

    def _weigh(self) -> float:
        self._clock.sleep(0.2)  # the tool swings out
        return self._force.baseline(_WEIGH_S).gross_n

    def _check_mass(self, tool: MountedTool, gained_n: float) -> None:
        expected_n = force_n_from_kg(tool.expected_mass_kg)
        if abs(gained_n - expected_n) > MASS_TOLERANCE * expected_n:
            raise InterlockError(
                f"Tool {tool.tool_id} weighs {gained_n / force_n_from_kg(1.0):.3f} kg, the table says "
                f"{tool.expected_mass_kg:.3f} kg (limit {MASS_TOLERANCE:.0%}). The head holds; "
                "fix the tool table or the tool."
            )
