"""Picking tools from the dock and putting them back, every step proven by a sensor before the next."""

import logging
from collections.abc import Mapping

from fast.hardware.click import tags
from fast.hardware.click.driver import ClickPlc
from fast.hardware.clock import Clock
from fast.hardware.parts.force_sensor import ForceSensor
from fast.hardware.parts.gantry import Gantry
from fast.hardware.parts.layout import BenchLayout
from fast.hardware.parts.safe_state import EmergencyStopError, FreezeError
from fast.hardware.questions import Ask, BenchQuestion
from fast.hardware.tools.journal import Journal, Transaction
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.tools.status import HeadSensors, ToolStatus, WayOn, judge
from fast.models.errors import InterlockError
from fast.models.units import force_n_from_kg, spell_share

logger = logging.getLogger(__name__)

IS_IT, IS_NOT = "it is this tool, go on", "stop here"
MASS_TOLERANCE = 0.05  # of the tool's mass
DAY_DRIFT_N = 0.3  # of the load cell's zero between two sessions
SWING_S = 0.2  # the tool swings out
SENSOR_S = 0.05  # a few scans of the PLC
_LOCK_TIME_OUT_S = 2.0
WEIGH_S = 2.0  # averages the cell's noise well below the tolerance


class ToolChanger:
    """The quick-change head and the dock. `tools` says what stands in which slot.

    `ask`: has a person say whether a tool of another mass is the right one; None: it is refused.
    """

    def __init__(
        self,
        gantry: Gantry,
        plc: ClickPlc,
        force: ForceSensor,
        clock: Clock,
        tools: Mapping[int, MountedTool],
        layout: BenchLayout,
        journal: Journal | None = None,
    ) -> None:
        self.tools = dict(tools)
        self.journal = journal or Journal()
        self.ask: Ask | None = None
        self._proven_slot: int | None = None
        self._told_n: dict[str, float] = {}  # weights of tools that a person has looked at
        self._gantry = gantry
        self._plc = plc
        self._force = force
        self._clock = clock
        self._layout = layout

    def is_locked(self) -> bool:
        """Read the lock-closed sensor."""
        return self._plc.read_bit(tags.LOCK_CLOSED_INPUT)

    def full_slots(self) -> list[int]:
        """List the dock slots whose presence sensor is on."""
        bits = self._plc.read_bits(tags.FIRST_DOCK_INPUT, tags.N_DOCK_SLOTS)
        return [slot for slot, is_full in enumerate(bits) if is_full]

    def status(self) -> ToolStatus:
        """Tell from journal and sensors where the tool is and the one safe way on. The head must be out of the dock."""
        is_closed, is_open, is_present, *_ = self._plc.read_bits(tags.FIRST_INPUT, tags.N_INPUTS)
        sensors = HeadSensors(is_present, is_closed, is_open, tuple(self.full_slots()))
        return judge(self.journal.last, sensors, self.tools)

    def check_may_rise(self) -> None:
        """Refuse to raise the head, also for homing, around a tool that could fall.

        Raises:
            InterlockError: the lock is neither open nor closed, or open around a carried tool; nothing has moved.
        """
        is_closed, is_open, is_present, _, _, is_in_dock = self._plc.read_bits(tags.FIRST_INPUT, tags.N_INPUTS)
        if not is_present or is_closed or (is_open and is_in_dock):
            return
        raise InterlockError(
            f"A tool is on the head and its lock is {'open' if is_open else 'neither open nor closed'}: it may fall. "
            "Nothing was moved; support the tool, close the lock at the panel, then home."
        )

    def settle(self) -> int | None:
        """End what an interruption left open; returns the slot of the tool on the head. Done already: nothing moves.

        Raises:
            InterlockError: journal and sensors disagree: a person must look.
        """
        self._leave_dock()
        status = self.status()
        if status.way is WayOn.ASK_PERSON:
            raise InterlockError(f"{status.sentence} Nothing was moved; way on: {status.way.value}.")
        if status.way is not WayOn.NONE:
            logger.warning("%s Now: %s.", status.sentence, status.way.value)
        if status.way is WayOn.UNDO_PICK:
            self.journal.close("undone")
        elif status.way is WayOn.CLOSE_DOCK:
            self.journal.close("done")
        elif status.way is WayOn.FINISH_PICK and status.slot is not None:
            self._finish_pick(self.tools[status.slot])
        elif status.way is WayOn.FINISH_DOCK and status.slot is not None:
            self._dock(status.slot)
            return None
        return status.slot

    def note_tool(self, slot: int | None, person: str) -> ToolStatus:
        """Note which slot's tool a person who has looked says is on the head, or that none is. Nothing moves.

        Raises:
            InterlockError: the sensors still contradict it; nothing was noted.
        """
        told = Transaction("told", slot, "", end="done")
        is_closed, is_open, is_present, *_ = self._plc.read_bits(tags.FIRST_INPUT, tags.N_INPUTS)
        status = judge(told, HeadSensors(is_present, is_closed, is_open, tuple(self.full_slots())), self.tools)
        if not status.is_clear:
            raise InterlockError(
                f"{status.sentence} That contradicts what was said; put sensors or tools in order first."
            )
        self.journal.note_tool(slot, person)
        return status

    def pick(self, slot: int) -> MountedTool:
        """Fetch the tool of a slot; another tool on the head is docked first. Done already: nothing moves.

        A transaction of the journal: killed anywhere, `settle` ends it.

        Raises:
            InterlockError: slot empty, lock not confirmed, or the mass is not the tool's: nothing leaves the dock.
        """
        tool = self.tools.get(slot)
        if tool is None:
            raise InterlockError(f"Slot {slot} has no tool in the tool table ({sorted(self.tools)}); choose another.")
        current = self.settle()
        if current == slot:
            self._check_same_tool(tool)
            return tool
        if current is not None:
            self.dock()
        if slot not in self.full_slots():
            raise InterlockError(f"Slot {slot} should hold {tool.tool_id}, its sensor shows it empty; check the dock.")
        self.journal.begin("pick", slot, tool.tool_id)
        self._to_slot(slot)
        self.journal.step("over_slot")
        self.journal.step("weighed_free", free_n=self._weigh())
        self._gantry.move_to(z_mm=self._layout.dock_z_mm)
        self._clock.sleep(SENSOR_S)
        if not self._plc.read_bit(tags.TOOL_PRESENT_INPUT):
            raise InterlockError(f"Slot {slot}: the head does not feel tool {tool.tool_id}; it stays in the dock.")
        self.journal.step("seated")
        self.journal.step("locking")
        self._lock(slot)
        self.journal.step("locked")
        self._gantry.move_to(z_mm=self._layout.top_z_mm)
        self._clock.sleep(SENSOR_S)
        if slot in self.full_slots():
            raise InterlockError(f"Tool {tool.tool_id} was locked but slot {slot} still feels one; look at the dock.")
        self.journal.step("raised")
        self._finish_pick(tool)
        logger.info("Picked tool %s from slot %d", tool.tool_id, slot)
        return tool

    def dock(self) -> None:
        """Put the tool on the head back into its slot; with an empty head nothing moves.

        A transaction of the journal: killed anywhere, `settle` ends it. A pick whose tool turned out to be wrong is
        undone by it.

        Raises:
            InterlockError: the tool is not seated, or the lock does not open; the tool stays locked.
        """
        self._leave_dock()
        status = self.status()
        if status.way is WayOn.FINISH_PICK and status.slot is not None:
            self.journal.close("done")
            self._dock(status.slot)
            return
        slot = self.settle()
        if slot is not None:
            self._dock(slot)

    def _dock(self, slot: int) -> None:
        if self.journal.open is None:
            self.journal.begin("dock", slot, self.tools[slot].tool_id)
        self._proven_slot = None
        self._to_slot(slot)
        self.journal.step("over_slot")
        self._gantry.move_to(z_mm=self._layout.dock_z_mm)
        self._clock.sleep(SENSOR_S)
        if slot not in self.full_slots():
            raise InterlockError(f"Slot {slot} does not feel the tool that was lowered into it; it stays locked.")
        self.journal.step("seated")
        self.journal.step("unlocking")
        self._plc.request(
            tags.UNLOCK_REQUEST,
            {tags.LOCK_CLOSED_INPUT: False, tags.LOCK_OPEN_INPUT: True},
            _LOCK_TIME_OUT_S,
            f"Unlocking the tool in slot {slot}",
        )
        self.journal.step("unlocked")
        self._gantry.move_to(z_mm=self._layout.top_z_mm)
        self._clock.sleep(SENSOR_S)
        if self._plc.read_bit(tags.TOOL_PRESENT_INPUT):
            raise InterlockError(f"The tool of slot {slot} came up with the head after unlocking. Don't move; look.")
        self.journal.step("raised")
        self.journal.close("done")
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

    def _leave_dock(self) -> None:
        """Go up, when an error left the head in the dock: an open lock leaves the tool, a closed one takes it along."""
        if self._plc.read_bit(tags.HEAD_IN_DOCK_INPUT):
            self.check_may_rise()
            self._gantry.move_to(z_mm=self._layout.top_z_mm)
            self._clock.sleep(SENSOR_S)

    def _to_slot(self, slot: int) -> None:
        x_mm, y_mm = self._layout.dock_xy_mm(slot)
        self._gantry.move_to(z_mm=self._layout.top_z_mm)
        self._gantry.move_to(x_mm=x_mm, y_mm=y_mm)

    def _finish_pick(self, tool: MountedTool) -> None:
        """Weigh the tool on the head against the table, and end the pick."""
        transaction = self.journal.open
        free_n = transaction.values.get("free_n") if transaction is not None else None
        if free_n is None or transaction is None:
            raise InterlockError(
                "A tool was locked before the head was weighed; dock it with `fast gantry park --real BENCH.toml`."
            )
        gained_n = self._weigh() - free_n
        self._check_mass(tool, gained_n, MASS_TOLERANCE * force_n_from_kg(tool.expected_mass_kg))
        self.journal.step("weighed", gained_n=gained_n)
        self.journal.close("done")
        self._proven_slot = transaction.slot

    def _check_same_tool(self, tool: MountedTool) -> None:
        """Weigh a tool that a session first meets on the head against the empty head of an earlier one."""
        last = self.journal.last
        free_n = last.values.get("free_n") if last is not None else None
        if last is None or free_n is None or self._proven_slot == last.slot:
            return
        limit_n = MASS_TOLERANCE * force_n_from_kg(tool.expected_mass_kg) + DAY_DRIFT_N
        self._check_mass(tool, self._weigh() - free_n, limit_n)
        self._proven_slot = last.slot

    def _lock(self, slot: int) -> None:
        confirm = {tags.LOCK_CLOSED_INPUT: True, tags.LOCK_OPEN_INPUT: False}
        self._plc.request(tags.LOCK_REQUEST, confirm, _LOCK_TIME_OUT_S, f"Locking the tool of slot {slot}")

    def _weigh(self) -> float:
        self._clock.sleep(SWING_S)
        return self._force.baseline(WEIGH_S).gross_n

    def _check_mass(self, tool: MountedTool, gained_n: float, limit_n: float) -> None:
        expected_n = force_n_from_kg(tool.expected_mass_kg)
        if abs(gained_n - self._told_n.get(tool.tool_id, expected_n)) <= limit_n:
            return
        fault = (
            f"Tool {tool.tool_id} weighs {gained_n / force_n_from_kg(1.0):.3f} kg, the table says "
            f"{tool.expected_mass_kg:.3f} kg (limit {spell_share(limit_n / expected_n)}).{self._who_weighs(gained_n)} "
            "The head holds"
        )
        if self.ask is not None:
            asked = BenchQuestion(key=f"mass of {tool.tool_id}", sentence=f"{fault}.", choices=(IS_IT, IS_NOT))
            if self.ask(asked).choice == IS_IT:
                self._told_n[tool.tool_id] = gained_n
                return
        raise InterlockError(
            f"{fault}; put it back with `fast gantry park --real BENCH.toml`, then fix the tool table or the tool."
        )

    def _who_weighs(self, gained_n: float) -> str:
        """Say which other tool of the table it could be."""
        masses_n = {slot: force_n_from_kg(tool.expected_mass_kg) for slot, tool in self.tools.items()}
        alike = [slot for slot, mass_n in masses_n.items() if abs(gained_n - mass_n) <= MASS_TOLERANCE * mass_n]
        if not alike:
            return ""
        return f" It weighs as the tool of slot {', '.join(map(str, alike))}: the slots may be swapped."
