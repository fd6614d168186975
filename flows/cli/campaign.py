"""`fast campaign`: start, continue, watch and stop campaigns."""

import math
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fast.flows.cli.common import DEFAULT_LAKE, OBJECT_HELP, AsJson, CampaignId, LakePath, make_app, show, table_text
from fast.flows.cli.live import open_reporter
from fast.flows.cli.real import YesMove, ask_leave
from fast.models.errors import UsageError

if TYPE_CHECKING:
    from fast.flows.campaign.process import CampaignOutcome
    from fast.lake.store import Lake
    from fast.tasks.campaign.setup import RealBench

_ENDED = {"pause": "paused", "stop": "stopped", "abort": "aborted and counts as failed"}

app = make_app(name="campaign", help="Start, continue, watch and stop campaigns.")


@app.command
def run(
    config: Annotated[Path, Parameter(help="TOML file of the campaign, e.g. campaigns/quick.toml.")],
    *,
    lake: LakePath = DEFAULT_LAKE,
    auto_print: Annotated[
        bool, Parameter(negative="", help="Count trays as printed without asking a person (demos and tests).")
    ] = False,
    real: Annotated[
        bool, Parameter(negative="", help="Drive the real bench of the config's `bench.real` file, once confirmed.")
    ] = False,
    yes_move: YesMove = None,
    acknowledge: Annotated[
        bool, Parameter(negative="", help="A person has looked after an emergency stop and lets the campaign go on.")
    ] = False,
    json: AsJson = False,
) -> None:
    """Start the campaign of a config file, or continue it where it stands; makes the lake if there is none.

    Ctrl-C pauses: it finishes the current grasp, parks the tool and ends. A second Ctrl-C stops: the bench goes to its
    safe state at once. The same command continues later.
    """
    from fast.flows.campaign.launch import run_campaign

    def confirm(bench_file: Path, settings: "RealBench") -> None:
        ask_leave(bench_file, settings, None, yes_move)

    leave = confirm if real else None
    with open_reporter() as reporter:
        outcome = run_campaign(
            config,
            lake,
            auto_print=auto_print,
            confirm_real=leave,
            reporter=reporter,
            is_acknowledged=acknowledge,
        )
    _show_outcome(outcome, lake, json)
    if outcome.ended_by == "abort":
        sys.exit(1)


@app.command
def status(campaign: CampaignId = None, *, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """Say where a campaign stands: done and left, best tool so far, what it waits for."""
    from fast.flows.campaign.status import format_status, read_status

    found = open_lake(lake)
    state = read_status(found, resolve_campaign(found, campaign))
    show(state, format_status(state, found.address), json)


@app.command(name="list")
def list_campaigns(*, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """List all campaigns of the lake."""
    from fast.flows.campaign.status import read_status

    found = open_lake(lake)
    rows = [read_status(found, name) for name in campaign_ids(found)]
    columns = ["campaign", "state", "grasps", "simulated", "best_tool", "best_n"]
    show(rows, table_text(rows, columns), json)


@app.command
def pause(campaign: CampaignId = None, *, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """Finish the current grasp, park the tool, end; `fast campaign run` continues."""
    _request("pause", campaign, lake, json)


@app.command
def stop(campaign: CampaignId = None, *, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """Bring the bench to its safe state at once, keep all data, end; a person opens the gripper and parks."""
    _request("stop", campaign, lake, json)


@app.command
def abort(campaign: CampaignId = None, *, lake: LakePath = DEFAULT_LAKE, json: AsJson = False) -> None:
    """Do as stop does, and count the campaign as failed (exit status 1); `fast campaign run` can still continue it."""
    _request("abort", campaign, lake, json)


@app.command(name="leave-out")
def leave_out(
    campaign: CampaignId = None,
    *,
    tool: Annotated[str, Parameter(help="Tool, e.g. B01T3: no grasp is begun with it any more.")] = "",
    object: Annotated[str, Parameter(help=f"{OBJECT_HELP} From this batch on; with --tool, of that tool alone.")] = "",
    repeat: Annotated[int | None, Parameter(help="With --tool and --object: this one grasp.")] = None,
    batch: Annotated[int | None, Parameter(help="The rest of this batch: no grasp of it is begun any more.")] = None,
    back: Annotated[bool, Parameter(negative="", help="Put back what was left out.")] = False,
    reason: Annotated[str, Parameter(help="Why; needed unless it is put back.")] = "",
    operator: Annotated[str, Parameter(help="Who says so.")],
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Leave a tool, an object, a grasp or the rest of a batch out, also while it is measured; what was measured stays.

    The grasp in progress is finished. After a fault, `fast campaign run` goes on with the rest.
    """
    from fast.flows.campaign.status import read_campaign
    from fast.tasks.bench.leave_out import leave_out as leave_part_out
    from fast.tasks.bench.leave_out import read_part
    from fast.tasks.objects import find_object

    found = open_lake(lake)
    if not (tool or object or batch is not None) or (batch is not None and (tool or object)):
        raise UsageError("say what is left out: --tool, --object or both, or --batch; nothing was changed.")
    known = read_campaign(found, resolve_campaign(found, campaign))
    number = find_object(object, lake).object_id if object else None
    part = read_part(known, tool, number, repeat, batch)
    sentence = leave_part_out(known, part, reason, operator, is_out=not back)
    show({"campaign": known.campaign_id, "part": part.name, "is_out": not back}, sentence, json)


@app.command
def answer(
    campaign: CampaignId = None,
    choice: Annotated[str, Parameter(help="One of the choices; without it, what the bench asks is listed.")] = "",
    *,
    value: Annotated[list[str] | None, Parameter(negative="", help="NAME=VALUE of a field; may be repeated.")] = None,
    operator: Annotated[str, Parameter(help="Who answers.")] = "",
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Answer what the bench of a campaign asks; the same can be done on the lab's page."""
    from fast.tasks.bench.questions import answer_question, list_open_questions

    found = open_lake(lake)
    name = resolve_campaign(found, campaign)
    asked = list_open_questions(found, name)
    if not choice:
        rows = [one.question.model_dump(mode="json") for one in asked]
        text = "\n".join(f"{one.question.sentence} Choices: {'; '.join(one.question.choices)}" for one in asked)
        show(rows, text or f"the bench of {name} asks nothing", json)
        return
    if not operator or not asked:
        raise UsageError("say who answers with --operator." if asked else f"the bench of {name} asks nothing.")
    values = dict(entry.partition("=")[::2] for entry in value or [])
    sentence = answer_question(found, name, asked[0].question_id, choice, values, operator)
    show({"campaign": name, "choice": choice}, sentence, json)


def _request(verb: str, campaign: str | None, lake: Path, as_json: bool) -> None:
    from fast.hardware.parts.safe_state import Verb
    from fast.tasks.campaign.present_run import request_verb

    found = open_lake(lake)
    name = resolve_campaign(found, campaign)
    sentence = request_verb(found, name, Verb(verb), "on the command line")
    show({"campaign": name, "asked": verb}, sentence, as_json)


def open_lake(lake: Path, *, create: bool = False) -> "Lake":
    """Open the lake at a path, which must exist already unless it is to be made."""
    from fast.lake.store import Lake

    return Lake.open(lake, create=create)


def campaign_ids(lake: "Lake") -> list[str]:
    """List all campaigns of the lake, oldest first."""
    # Times are left out of what is read: PyArrow would import pandas for them, half a second.
    found = lake.query("SELECT campaign_id FROM campaigns ORDER BY sequence, created_at, campaign_id")
    return [str(name) for name in found["campaign_id"].to_pylist()]


def resolve_campaign(lake: "Lake", campaign: str | None) -> str:
    """Return the campaign asked for, or the only one there is."""
    from fast.models.validation import closest

    known = campaign_ids(lake)
    if not known:
        raise UsageError(f"the lake {lake.address} has no campaign; start one with `fast campaign run CONFIG.toml`.")
    if campaign in known:
        return str(campaign)
    if campaign is not None:
        raise UsageError(f"campaign `{campaign}` is not in this lake; {closest(campaign, known)}")
    if len(known) > 1:
        raise UsageError(f"this lake has {len(known)} campaigns ({', '.join(known)}); name one.")
    return known[0]


def _show_outcome(outcome: "CampaignOutcome", lake: Path, as_json: bool) -> None:
    data: dict[str, Any] = {
        "campaign": outcome.campaign_id,
        "complete": outcome.is_complete,
        "best_tool": outcome.best,
        "times_reference": _reference_data(outcome),
        "tools": outcome.tools,
        "report": str(outcome.report) if outcome.report else None,
        "recording": str(outcome.recording) if outcome.recording else None,
        "ended_by": outcome.ended_by,
    }
    show(data, _outcome_text(data, lake), as_json)


def _reference_data(outcome: "CampaignOutcome") -> dict[str, Any] | None:
    """Compare the best tool with the reference finger, for machines; an interval that is not known is empty."""
    found = outcome.times_reference
    if found is None:
        return None
    bounds = [bound if math.isfinite(bound) else None for bound in (found.ratio.lower, found.ratio.upper)]
    tools = [tool.tool_id for tool in found.references]
    return {"times": found.ratio.mean, "ci95": bounds, "reference_tools": tools, "sentence": found.sentence}


def _outcome_text(data: dict[str, Any], lake: Path) -> str:
    lines = ["", table_text(data["tools"]), ""] if data["tools"] else []
    if not data["complete"]:
        ended = _ENDED.get(data["ended_by"], "interrupted")
        return "\n".join([*lines, f"campaign {data['campaign']} is {ended}; the same command continues it."])
    best = data["best_tool"]
    if best:
        lines.append(f"best tool  {best['tool_id']}  {best['tool_quality_n']:.2f} N mean peak pull-off force")
    if data["times_reference"]:
        lines.append(f"reference  {data['times_reference']['sentence']}")
    lines += [f"report     {data['report']}", f"recording  {data['recording']}"]
    return "\n".join([*lines, "", *_next_lines(data, lake)])


def _can_search_gap(tools: list[dict[str, Any]]) -> bool:
    """Return whether enough tools and objects were measured to hold some out."""
    from fast.tasks.gap.split import MIN_DESIGNS, MIN_OBJECTS

    return sum(tool["n_objects"] >= MIN_OBJECTS for tool in tools) >= MIN_DESIGNS


def _next_lines(data: dict[str, Any], lake: Path) -> list[str]:
    """List what to open and what to try next, as it can be clicked or typed."""
    from fast.lake.storage.open import storage_at

    address = storage_at(lake).address
    is_usual = lake == DEFAULT_LAKE or os.environ.get("FAST_LAKE") in (str(lake), address)
    where = "" if is_usual else f" --lake {shlex.quote(address)}"
    best = data["best_tool"]
    tries = [("what it did, in motion", f"fast view {data['campaign']}{where}")]
    if best:
        tries += [("the best tool", f"fast view {best['tool_id']}{where}")]
    tries.append(("ask the data", f'fast sql "FROM tool_quality"{where}'))
    if _can_search_gap(data["tools"]):
        tries.append(("where the simulator is wrong: what the search would cost", f"fast gap --dry-run{where}"))
    else:
        tries.append(("where a simulator is wrong, on measurements that come with FAST", "fast gap --example"))
    width = max(len(command) for _, command in tries)
    report = f"Open the report: {Path(data['report']).resolve().as_uri()}"
    return [report, "Then try:"] + [f"    {command.ljust(width)}   {why}" for why, command in tries]
