"""Forms of a gap search in Prefect's pages: kept tools that are mounted again, and numbers that a person measures.

As the form of a batch, a run suspends until a person answers; an answer that cannot be used is asked for again.
"""

from typing import Annotated, Any, Literal, cast

from prefect import flow
from prefect.flow_runs import suspend_flow_run
from prefect.input import RunInput
from prefect.states import Completed, State
from pydantic import Field, create_model

from fast.flows.campaign.print_form import SURE, WAIT_LIMIT_S
from fast.flows.campaign.status import read_campaign
from fast.lake.store import Lake
from fast.models.errors import FastError, UsageError
from fast.models.gap.ask.answers import Reading
from fast.models.gap.ask.person import find_measurement
from fast.models.units import spell_count
from fast.models.validation import load_record
from fast.tasks.bench.asked import Mounting, confirm_mounting, read_mounting
from fast.tasks.bench.mount import plan_rack
from fast.tasks.gap.readings import is_answered, write_reading

_Operator = Annotated[str, Field(min_length=1)]


@flow(name="mount", flow_run_name="{campaign}: kept tools mounted?", persist_result=True, result_serializer="json")
def mount_tools(campaign: str, search: str, lake: str = "lake-data") -> State[Any]:
    """Ask a person to mount kept tools until the answer can be used; then the campaign goes on."""
    found, complaint, number = Lake.open(lake), "", 0
    while read_mounting(found, search) is None:
        number += 1
        slots = plan_rack(found, read_campaign(found, campaign).state(), search)
        form = make_mount_form(slots, complaint)
        try:
            answer = suspend_flow_run(wait_for_input=form, timeout=WAIT_LIMIT_S, key=f"answer-{number}")
            word = read_mount_answer(answer, search, slots)
            confirm_mounting(found, campaign, word)
        except FastError as error:
            complaint = str(error)
            continue
        return Completed(message=f"{spell_count(len(word.slots), 'kept tool')} mounted, {len(word.gone)} gone.")
    return Completed(message="the tools were confirmed elsewhere meanwhile.")


@flow(name="reading", flow_run_name="{search}: {kind}", persist_result=True, result_serializer="json")
def read_number(campaign: str, search: str, kind: str, lake: str = "lake-data") -> State[Any]:
    """Ask a person for a number until the answer can be used; the next search takes it."""
    found, complaint, number = Lake.open(lake), "", 0
    while not is_answered(found, search, kind):
        number += 1
        form = make_reading_form(kind, complaint)
        try:
            answer = suspend_flow_run(wait_for_input=form, timeout=WAIT_LIMIT_S, key=f"answer-{number}")
            told = answer.model_dump()
            reading = load_record(Reading, {"kind": kind, "value": told["value"]}, "the form")
            who, is_sure = told["operator"].strip(), bool(told.get("is_sure"))
            write_reading(found, campaign or None, search, reading, who, is_sure=is_sure, way=f"*{SURE}*")
        except FastError as error:
            complaint = str(error)
            continue
        return Completed(message=f"{kind.replace('_', ' ')}: {reading.value:g}.")
    return Completed(message="it was measured elsewhere meanwhile.")


def make_mount_form(slots: dict[str, int], complaint: str) -> type[RunInput]:
    """Make the form of kept tools: each mounted in its slot, or gone."""
    fields: dict[str, Any] = {"operator": (_Operator, Field(title="Your name", description=_say(complaint)))}
    for tool_id, slot in slots.items():
        label = tool_id.rpartition("/")[2]
        fields[label] = (Literal["mounted", "gone"], Field(default="mounted", title=f"{label} in rack slot {slot}"))
    return cast(type[RunInput], create_model("KeptTools", __base__=RunInput, **fields))


def read_mount_answer(answer: RunInput, search_id: str, slots: dict[str, int]) -> Mounting:
    """Read the answer as a person's word.

    Raises:
        ConfigError: there is no name.
    """
    said = {tool_id: getattr(answer, tool_id.rpartition("/")[2]) for tool_id in slots}
    word: dict[str, Any] = {"search_id": search_id, "operator": str(getattr(answer, "operator", "")).strip()}
    word["slots"] = {tool_id: slot for tool_id, slot in slots.items() if said[tool_id] == "mounted"}
    word["gone"] = tuple(tool_id for tool_id in slots if said[tool_id] == "gone")
    return load_record(Mounting, word, "the form")


def make_reading_form(kind: str, complaint: str) -> type[RunInput]:
    """Make the form of a number that a person measures.

    Raises:
        UsageError: nobody asks for such a number.
    """
    known = find_measurement(kind)
    if known is None:
        raise UsageError(f"nobody asks for a `{kind}`.")
    order = known.words[0].upper() + known.words[1:]
    fields: dict[str, Any] = {
        "operator": (_Operator, Field(title="Your name", description=f"{_say(complaint)}{order}.")),
        "value": (float, Field(title=known.label)),
        "is_sure": (bool, Field(default=False, title=SURE)),
    }
    return cast(type[RunInput], create_model("Measured", __base__=RunInput, **fields))


def _say(complaint: str) -> str:
    return f"**This answer could not be used: {complaint}** Correct it and submit again. " if complaint else ""
