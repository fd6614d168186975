"""Leaving a part of the plan out while it runs, and putting it back: the one function of page and terminal."""

import re
from collections.abc import Iterator, Sequence
from typing import overload

from fast.hardware.station.station import Item
from fast.lake.query.engine import Mark
from fast.lake.tables.campaign import EventRow
from fast.models.errors import UsageError
from fast.models.records import GraspRequest
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.left_out import LEFT_OUT, LeftOut, LeftOuts, Part, read_left_out
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.state import CampaignState, ProposedTool

_TOOL = re.compile(r"(?:[^/]+/)?B(\d+)T(\d)")


def leave_out(campaign: Campaign, part: Part, reason: str, operator: str, *, is_out: bool = True) -> str:
    """Have no grasp begun any more with a part of the plan, or put it back; a sentence says what that does.

    The grasp in progress is finished, and what was measured stays and counts.

    Raises:
        UsageError: there is no such part, it is so already, or nobody said why.
    """
    state = campaign.state()
    _check_part(campaign, state, part)
    words = state.left_out.valid(part.batch)
    said = next((word for word in words if word.part.key == part.key), None)
    if is_out and said is not None:
        raise UsageError(f"{part.name} is left out already, by {said.operator} ({said.reason}); nothing was changed.")
    if not is_out and said is None:
        raise UsageError(f"{part.name} is not left out, so it cannot be put back; nothing was changed.")
    if is_out and not reason.strip():
        raise UsageError(f"say why {part.name} is left out; nothing was changed.")
    word = LeftOut(part=part, is_out=is_out, reason=reason.strip(), operator=operator)
    message = f"{operator} {'left out' if is_out else 'put back'} {part.name}"
    message += f": {word.reason}" if word.reason else ""
    append_event(campaign.lake, campaign.campaign_id, LEFT_OUT, message, **word.model_dump(mode="json"))
    if not is_out:
        return f"{part.name} is put back: its missing grasps are made when the bench comes to them."
    return f"{part.name} is left out: no grasp is begun with it any more; what was measured stays."


def read_part(
    campaign: Campaign,
    tool: str = "",
    object_id: int | None = None,
    repeat: int | None = None,
    batch: int | None = None,
) -> Part:
    """Read a part of the plan as people name it; `tool`: such as B01T3. With nothing named, the rest of the batch.

    Raises:
        UsageError: the tool is not written so, or a repeat has no tool or object.
    """
    if not tool:
        if repeat is not None:
            raise UsageError("a repeat is of a tool on an object; name both.")
        number = batch if batch is not None else find_batch_at_bench(campaign, campaign.state())
        return Part(batch=number, object_id=object_id)
    match = _TOOL.fullmatch(tool)
    if match is None:
        raise UsageError(f"`{tool}` is no tool; write it like B01T3.")
    if repeat is not None and object_id is None:
        raise UsageError("a repeat is of a tool on an object; name both.")
    return Part(batch=int(match[1]), slot=int(match[2]), object_id=object_id, repeat=repeat)


def find_batch_at_bench(campaign: Campaign, state: CampaignState) -> int:
    """Find the batch that is measured now, or next: the first that owes grasps, or else the last one."""
    plan, limit = campaign.config.objects.list_grasps(0), campaign.config.max_grasp_attempts
    batches = sorted({tool.batch for tool in state.tools})
    for batch in batches:
        tools = state.tools_of(batch)
        if not state.is_confirmed(batch) or any(state.missing_grasps(tool, plan, limit) for tool in tools):
            return batch
    return batches[-1] if batches else 1


def _check_part(campaign: Campaign, state: CampaignState, part: Part) -> None:
    """Raise UsageError for what the campaign does not have, or has not at the bench."""
    if part.object_id is not None and part.object_id not in campaign.object_ids:
        raise UsageError(f"campaign {campaign.campaign_id} has no {part.name}; nothing was changed.")
    if not state.tools_of(part.batch):
        raise UsageError(f"batch {part.batch} is not proposed yet; nothing was changed.")
    if part.slot is None:
        return
    tool = next((tool for tool in state.tools_of(part.batch) if tool.slot == part.slot), None)
    if tool is None or tool.tool_id not in state.confirmed:
        raise UsageError(f"nobody has confirmed a tool `{part.name}`; nothing was changed.")
    if state.confirmed[tool.tool_id] == "rejected":
        raise UsageError(f"{tool.label} was rejected, so nothing is measured with it; nothing was changed.")


class OpenPlan(Sequence[Item]):
    """Grasps of a tool in order; going through them, those that people have left out by then are passed over."""

    def __init__(self, campaign: Campaign, tool: ProposedTool, items: Sequence[Item]) -> None:
        self._lake, self._campaign_id = campaign.lake, campaign.campaign_id
        self._tool, self._items, self._batch = tool, items, tool.batch
        if any(isinstance(item, GraspRequest) for item in items):  # of a kept tool, beside a batch that is not its own
            self._batch = max((other.batch for other in campaign.state().tools), default=tool.batch)
        self._mark: Mark | None = None
        self._left_out = LeftOuts()

    def __len__(self) -> int:
        return len(self._items)

    @overload
    def __getitem__(self, place: int) -> Item: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Item]: ...
    def __getitem__(self, place: int | slice) -> Item | Sequence[Item]:
        return self._items[place]

    def __iter__(self) -> Iterator[Item]:
        return (item for item in self._items if not self._is_out(item))

    def _is_out(self, item: Item) -> bool:
        mark = self._lake.mark(EventRow)  # the events are read only when there are new ones
        if mark != self._mark:
            self._left_out, self._mark = read_left_out(self._lake, self._campaign_id), mark
        cell = (item.object_id, item.repeat) if isinstance(item, GraspRequest) else item
        out, tool = self._left_out, self._tool
        is_over = out.is_ended(self._batch) or cell[0] in out.objects(self._batch)
        return is_over or out.covers(tool.batch, tool.slot, cell)
