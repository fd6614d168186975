"""The human step as a form in Prefect's pages: what became of each tool of a batch, measured values, lot and name.

The run suspends: no process waits, so the form outlives restarts of server, worker and machine. After a resume the
flow starts from the top; answers that were given before come back from the server and are judged as before.
"""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, cast

from prefect import flow
from prefect.flow_runs import suspend_flow_run
from prefect.input import RunInput
from prefect.states import Completed, State
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model
from pydantic.json_schema import SkipJsonSchema

from fast.flows.server.server_process import OUTPUTS
from fast.lake.store import Lake
from fast.lake.tables.campaign import BatchRow
from fast.models.errors import FastError, UsageError
from fast.models.ids import tool_label
from fast.models.units import spell_count
from fast.models.validation import load_record
from fast.tasks.bench.measured_tools import MeasuredTool
from fast.tasks.bench.print import PrintConfirmation, confirm_print, open_slots

WAIT_LIMIT_S = 10 * 365 * 86400  # Prefect gives up after an hour unless told otherwise
SURE = "Strange numbers are right"  # what a form calls --sure
_MEASURES = {
    "front_mm": "measured_front_thickness_mm",
    "back_mm": "measured_back_thickness_mm",
    "rib_mm": "measured_rib_thickness_mm",
    "hardness_shore_a": "hardness_shore_a",
}


def _no_default(schema: dict[str, Any]) -> None:
    """Remove the default: an empty number is left out; a default of None would make the page ask for the type first."""
    schema.pop("default", None)


def _number(title: str) -> Any:
    return Field(default=None, title=title, json_schema_extra=_no_default)


_Size = Annotated[float, Field(gt=0)] | SkipJsonSchema[None]
_RackSlot = Annotated[int, Field(ge=0, le=9)] | SkipJsonSchema[None]


class ToolAnswer(BaseModel):
    """Printed, rejected or printed again; measured values if there are any."""

    model_config = ConfigDict(extra="forbid")

    became: Literal["printed", "rejected", "print again"] = Field(default="printed", title="What became of it")
    reason: str = Field(default="", title="Reason, if rejected or to be printed again")
    front_mm: _Size = _number("Front wall, measured, mm")
    back_mm: _Size = _number("Back wall, measured, mm")
    rib_mm: _Size = _number("Ribs, measured, mm")
    hardness_shore_a: _Size = _number("Hardness, Shore A")
    rack_slot: _RackSlot = _number("Rack slot, if another")


@flow(
    name="print",
    flow_run_name="{campaign}/B{batch:02d}: printed and mounted?",
    persist_result=True,
    result_serializer="json",
)
def confirm_batch(campaign: str, batch: int, slots: list[int], lake: str = "lake-data") -> State[Any]:
    """Ask a person what became of a printed batch until the answer can be used; then the campaign goes on.

    `slots`: those that are asked for.
    """
    found = Lake.open(lake)
    complaint, last, number = "", None, 0
    while True:
        number += 1
        wanted = [slot for slot in open_slots(found, campaign, batch) if slot in slots]
        if not wanted:
            return Completed(message="the batch was confirmed elsewhere meanwhile.")
        form = make_form(campaign, batch, slots, complaint, last)
        try:
            last = suspend_flow_run(wait_for_input=form, timeout=WAIT_LIMIT_S, key=f"answer-{number}")
            done = confirm_print(found, campaign, batch, read_answer(last, batch, slots, wanted), way=f"*{SURE}*")
        except (FastError, ValidationError) as error:
            complaint = str(error)
            continue
        sentence = f"{spell_count(done.n_mounted, 'tool')} mounted, {done.n_rejected} rejected"
        if done.again:
            sentence += f"; printed again: slot {', '.join(map(str, done.again))}, files in {done.sheet}"
        return Completed(message=f"{sentence}.")


def make_form(campaign: str, batch: int, slots: Sequence[int], complaint: str, last: RunInput | None) -> type[RunInput]:
    """Make the form of these slots; after a bad answer with the complaint on top and what was typed, but the name."""
    before = {} if last is None else last.model_dump(exclude_none=True)
    tools: dict[str, Any] = {}
    for slot in slots:
        label = tool_label(batch, slot)
        answer = ToolAnswer(**before.get(label, {}))
        shown: dict[str, Any] = {"default": answer.model_dump(exclude_none=True)}
        tools[label] = (ToolAnswer, Field(default=answer, title=f"{label}, slot {slot}", json_schema_extra=shown))
    fields: dict[str, Any] = {
        # Without a default, so that an empty answer is refused.
        "operator": (str, Field(min_length=1, title="Your name", description=_description(campaign, batch, complaint))),
        "material_lot": (str, Field(default=before.get("material_lot", ""), title="Material lot")),
        **tools,
        "is_sure": (bool, Field(default=False, title=SURE)),
    }
    return cast(type[RunInput], create_model("PrintedBatch", __base__=RunInput, **fields))


def _description(campaign: str, batch: int, complaint: str) -> str:
    """Write what the first field says: pages do not show a description of the whole form."""
    sheet = f"[Sheet and files]({OUTPUTS}/{campaign}/B{batch:02d}-print/sheet.html)"
    name = BatchRow.make_id(campaign, batch)
    text = f"Who printed and mounted batch {name}? {sheet}. The campaign goes on after Submit."
    return f"**This answer could not be used: {complaint}** Correct it and submit again. {text}" if complaint else text


def read_answer(answer: RunInput, batch: int, slots: Sequence[int], wanted: Sequence[int]) -> PrintConfirmation:
    """Read the answer as a person's word; slots that were confirmed elsewhere meanwhile are left out.

    Raises:
        UsageError: a reason is missing.
    """
    given = {slot: getattr(answer, tool_label(batch, slot)) for slot in slots}
    told = {slot: tool for slot, tool in given.items() if slot in wanted}
    word: dict[str, Any] = {"operator": str(getattr(answer, "operator", "")).strip()}
    word["is_sure"] = bool(getattr(answer, "is_sure", False))
    word["material_lot"] = str(getattr(answer, "material_lot", "")).strip()
    word["rejected"] = {slot: _reason(batch, slot, tool) for slot, tool in told.items() if tool.became == "rejected"}
    word["again"] = {slot: _reason(batch, slot, tool) for slot, tool in told.items() if tool.became == "print again"}
    mounted = {slot: tool for slot, tool in told.items() if tool.became == "printed"}
    word["measured"] = {slot: found for slot, tool in mounted.items() if (found := _measured(tool)) is not None}
    word["mounted"] = {slot: tool.rack_slot for slot, tool in mounted.items() if tool.rack_slot is not None}
    return load_record(PrintConfirmation, word, "the form")


def _reason(batch: int, slot: int, tool: ToolAnswer) -> str:
    reason = tool.reason.strip()
    if not reason:
        raise UsageError(f"{tool_label(batch, slot)} is {tool.became!r} without a reason; give one.")
    return reason


def _measured(tool: ToolAnswer) -> MeasuredTool | None:
    values = {theirs: getattr(tool, ours) for ours, theirs in _MEASURES.items()}
    return None if all(value is None for value in values.values()) else MeasuredTool(**values)
