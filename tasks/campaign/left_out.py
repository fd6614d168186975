"""What people leave out of a campaign while it runs: an object, a tool, one grasp, the rest of a batch.

The plan goes on without it, and what was measured stays. Each word is an event of the lake, so it outlives a kill; a
later word of the same thing counts instead.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

from pydantic import Field, model_validator

from fast.lake.order import OLDEST_FIRST
from fast.lake.store import Lake
from fast.models.ids import tool_label
from fast.models.objects.catalogue import name_object
from fast.models.records import Record

LEFT_OUT = "left_out"  # kind of the events

_WORDS = f"""
    SELECT payload_json FROM events WHERE campaign_id = $campaign AND kind = '{LEFT_OUT}'
    ORDER BY {OLDEST_FIRST}, event_id
"""


class Part(Record):
    """What is left out: the grasps to which all that is given applies."""

    batch: int = Field(ge=1)
    """The batch at the bench. An object is left out from it on, until it is put back."""
    slot: int | None = Field(default=None, description="of the tool in the batch; None: every tool")
    object_id: int | None = Field(default=None, description="None: every object")
    repeat: int | None = Field(default=None, ge=0, description="of the tool on the object; None: every repeat")

    @model_validator(mode="after")
    def _check_grasp(self) -> "Part":
        if self.repeat is not None and (self.slot is None or self.object_id is None):
            raise ValueError("a repeat is of a tool on an object; name both")
        return self

    @property
    def key(self) -> tuple[int | None, int | None, int | None]:
        """Slot, object, repeat."""
        return self.slot, self.object_id, self.repeat

    @property
    def of_all_tools(self) -> int | None:
        """The object, where it is left out whatever the tool."""
        return self.object_id if self.slot is None else None

    def has(self, slot: int, grasp: tuple[int, int]) -> bool:
        """Return whether a grasp of (object, repeat) with the tool of a slot is part of it."""
        return all(mine in (None, other) for mine, other in zip(self.key, (slot, *grasp), strict=True))

    @property
    def name(self) -> str:
        """As people say it."""
        if self.slot is None and self.object_id is None:
            return f"the rest of B{self.batch:02d}"
        tool = tool_label(self.batch, self.slot) if self.slot is not None else ""
        if self.object_id is None:
            return tool
        what = name_object(self.object_id)
        if not tool:
            return what
        return f"{tool} on {what}" + (f", repeat {self.repeat}" if self.repeat is not None else "")


class LeftOut(Record):
    """A person's word on a part of the plan. `is_out`: False puts it back."""

    part: Part
    is_out: bool = True
    reason: str = ""
    operator: str = Field(min_length=1)


@dataclass(frozen=True)
class LeftOuts:
    """All words of a campaign, the oldest first."""

    words: tuple[LeftOut, ...] = ()
    _valid: dict[int, list[LeftOut]] = field(default_factory=dict, compare=False, repr=False)

    def valid(self, batch: int) -> list[LeftOut]:
        """Return the words by which something is left out in a batch: the last of each part."""
        if batch not in self._valid:
            last: dict[tuple[int | None, ...], LeftOut] = {}
            for word in self.words:
                part, before = word.part, last.get(word.part.key)
                if part.batch == batch or (part.of_all_tools is not None and part.batch < batch):
                    last[part.key] = word if before is None or before.part.batch <= part.batch else before
            self._valid[batch] = [word for word in last.values() if word.is_out]
        return self._valid[batch]

    def covers(self, batch: int, slot: int, grasp: tuple[int, int]) -> bool:
        """Return whether no grasp of (object, repeat) is begun with the tool of a slot in a batch."""
        return any(word.part.has(slot, grasp) for word in self.valid(batch))

    def has_tool(self, batch: int, slot: int) -> bool:
        """Return whether a tool is left out."""
        return any(word.part.key == (slot, None, None) for word in self.valid(batch))

    def is_ended(self, batch: int) -> bool:
        """Return whether the rest of a batch is left out."""
        return any(word.part.key == (None, None, None) for word in self.valid(batch))

    def objects(self, batch: int) -> set[int]:
        """Return the objects that are left out in a batch, whatever the tool."""
        return {object_id for word in self.valid(batch) if (object_id := word.part.of_all_tools) is not None}


def read_left_out(lake: Lake, campaign_id: str) -> LeftOuts:
    """Read what people have left out of a campaign, and put back."""
    found: Iterable[str] = lake.query(_WORDS, {"campaign": campaign_id})["payload_json"].to_pylist()
    return LeftOuts(tuple(LeftOut.model_validate_json(text) for text in found))
