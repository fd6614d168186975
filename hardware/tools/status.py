"""Where the tool is, from the journal's last transaction and the sensors together; pure, tested over every case.

Neither is believed alone: sensors do not know which tool, the journal does not know what a person did since. Where both
agree there is one safe way on; where they do not, a person looks first.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from fast.hardware.tools.journal import Transaction
from fast.hardware.tools.mounted import MountedTool


class WayOn(Enum):
    """The one safe way on."""

    NONE = "nothing to do"
    FINISH_PICK = "finish the pick: weigh the tool that is on the head"
    UNDO_PICK = "undo the pick: the tool is in its slot, the head is empty"
    FINISH_DOCK = "finish the dock: lower the tool into its slot again"
    CLOSE_DOCK = "finish the dock: the tool is in its slot, the head is empty"
    ASK_PERSON = (
        "a person looks and says where the tool is: "
        "`fast gantry tool --real BENCH.toml --person NAME` with `--on-head SLOT` or `--head-empty`"
    )


@dataclass(frozen=True)
class HeadSensors:
    """What the sensors of head and dock show, with the head outside the dock."""

    is_tool_present: bool
    is_lock_closed: bool
    is_lock_open: bool
    full_slots: tuple[int, ...]


@dataclass(frozen=True)
class ToolStatus:
    """Slot of the tool on the head (None: empty, or unknown), one sentence about it, and the way on."""

    slot: int | None
    sentence: str
    way: WayOn

    @property
    def is_clear(self) -> bool:
        """Whether journal and sensors name one place."""
        return self.way is not WayOn.ASK_PERSON


def judge(last: Transaction | None, sensors: HeadSensors, tools: Mapping[int, MountedTool]) -> ToolStatus:
    """Judge where the tool is. `last`: the journal's last transaction; `tools`: the tool table, which is the truth."""
    empty = sorted(set(tools) - set(sensors.full_slots))
    if sensors.is_tool_present:
        return _judge_full_head(last, sensors, empty, tools)
    if sensors.is_lock_closed:
        return _ask("The lock is closed on an empty head: a tool could not be seated. Open it at the panel")
    return _judge_empty_head(last, empty)


def _judge_full_head(
    last: Transaction | None, sensors: HeadSensors, empty: list[int], tools: Mapping[int, MountedTool]
) -> ToolStatus:
    if not sensors.is_lock_closed:
        return _ask("A tool is on the head but the lock is not closed: it may fall. Don't move, support it first")
    if len(empty) != 1:
        return _ask(
            f"A tool is on the head, but {len(empty)} slots of the tool table are empty ({empty}) instead of one"
        )
    slot = empty[0]
    tool_id = tools[slot].tool_id
    if last is not None and last.end is None:
        if last.slot != slot:
            return _ask(f"The {last.verb} of slot {last.slot} was interrupted, but slot {slot} is the empty one")
        way = WayOn.FINISH_PICK if last.verb == "pick" else WayOn.FINISH_DOCK
        return ToolStatus(slot, f"The {last.verb} of {tool_id} was interrupted with the tool on the head.", way)
    if last is not None and last.slot_on_head != slot:
        before = "no tool" if last.slot_on_head is None else f"the tool of slot {last.slot_on_head}"
        return _ask(f"The head carried {before} when the journal ended, now slot {slot} is empty and it carries a tool")
    return ToolStatus(slot, f"Tool {tool_id} of slot {slot} is on the head, locked.", WayOn.NONE)


def _judge_empty_head(last: Transaction | None, empty: list[int]) -> ToolStatus:
    if last is not None and last.end is None:
        if last.slot in empty:
            return _ask(
                f"The {last.verb} of slot {last.slot} was interrupted; the tool is neither on the head nor there"
            )
        way = WayOn.UNDO_PICK if last.verb == "pick" else WayOn.CLOSE_DOCK
        sentence = f"The {last.verb} of slot {last.slot} was interrupted with the tool in its slot."
        return ToolStatus(None, sentence, way)
    if last is not None and last.slot_on_head is not None:
        where = "missing" if last.slot_on_head in empty else f"in slot {last.slot_on_head}"
        return _ask(f"The tool of slot {last.slot_on_head} was on the head when the journal ended, now it is {where}")
    return ToolStatus(None, "The head is empty.", WayOn.NONE)


def _ask(what: str) -> ToolStatus:
    return ToolStatus(None, f"{what}.", WayOn.ASK_PERSON)
