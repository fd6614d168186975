"""Where a campaign stands, in a dictionary for machines and a few lines for people; from the lake alone."""

import shlex
from typing import Any

from fast.flows.campaign.batch_folder import is_told
from fast.flows.campaign.progress import count_work
from fast.hardware.parts.safe_state import Verb
from fast.lake.leases import holder_of
from fast.lake.order import LATEST_FIRST
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, SimulationRow, SimulatorVersionRow
from fast.lake.tables.imported import IMPORTED, importing_campaign, is_imported
from fast.models.ids import tool_label
from fast.models.units import spell_count
from fast.tasks.bench.questions import list_open_questions
from fast.tasks.bench.ways_on import WayOnward, list_ways, read_fault
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import read_stored_config
from fast.tasks.campaign.requests import GAP_LEASE, lease_name, requested_verb
from fast.tasks.campaign.simulator_versions import at_present
from fast.tasks.campaign.state import CampaignState, rank_tools
from fast.tasks.scientist.insights.advice import ADVICE, has_stopped, read_advice

_ENDED_BY = {
    Verb.PAUSE: "paused",
    Verb.STOP: "stopped",
    Verb.ABORT: "failed (aborted)",
    Verb.ESTOP: "emergency stop, waits for a person",
}
_LAST_EVENT = f"""
    SELECT message FROM events WHERE campaign_id = ? AND kind <> '{ADVICE}'
    ORDER BY {LATEST_FIRST}, event_id DESC LIMIT 1
"""


def read_campaign(lake: Lake, campaign_id: str) -> Campaign:
    """Read a campaign with the config it was started with, from the lake."""
    text = _stored_toml(lake, campaign_id)
    return Campaign(lake, read_stored_config(text, campaign_id))


def _stored_toml(lake: Lake, campaign_id: str) -> str:
    sql = "SELECT config_toml FROM campaigns WHERE campaign_id = ?"
    return str(lake.query(sql, [campaign_id])["config_toml"][0].as_py())


def read_status(lake: Lake, campaign_id: str) -> dict[str, Any]:
    """Read counts, best tool and what the campaign is doing or waiting for."""
    if is_imported(_stored_toml(lake, campaign_id)):
        return _imported_status(lake, campaign_id)
    campaign = at_present(read_campaign(lake, campaign_id))
    state = campaign.state()
    load = count_work(campaign, state)
    batches = sorted({t.batch for t in state.tools})
    is_folder = campaign.config.bench.is_folder  # whose tools count as printed once a grasp of them is told
    untold = [batch for batch in batches if is_folder and not is_told(campaign, state, batch)]
    waiting = [batch for batch in batches if not is_folder and not state.is_confirmed(batch)]
    tools = rank_tools(lake, campaign_id)
    events = lake.query(_LAST_EVENT, [campaign_id])["message"].to_pylist()
    advice = read_advice(lake, campaign_id)
    is_complete = load.fraction >= 1.0 or has_stopped(campaign)
    return {
        "campaign": campaign_id,
        "state": describe_state(lake, campaign_id, is_complete),
        "grasps": f"{load.grasps_done}/{load.grasps_total}",
        "failures": sum(state.failures.values()),
        "simulated": f"{load.simulated_done}/{load.simulated_total}",
        "simulated_before": load.simulated_before,
        "waiting_for_print": [f"{campaign_id}/B{batch:02d}" for batch in waiting],
        "waiting_for_grasps": [f"{campaign_id}/B{batch:02d}" for batch in untold],
        "waiting_for_answers": [one.question.sentence for one in list_open_questions(lake, campaign_id)],
        "best_tool": tools[0]["tool_id"] if tools else None,
        "best_n": tools[0]["tool_quality_n"] if tools else None,
        "advice": advice[0].model_dump() if advice else None,
        "last_event": events[0] if events else None,
        **_read_fault(campaign, state, is_complete),
        "output": str(campaign.output),
    }


def _read_fault(campaign: Campaign, state: CampaignState, is_complete: bool) -> dict[str, Any]:
    """Read the fault at which a campaign stands, and the ways on."""
    name = campaign.campaign_id
    is_stopped = describe_state(campaign.lake, name, is_complete) == "interrupted"
    fault = read_fault(campaign.lake, name) if is_stopped else ""
    ways = list_ways(campaign, state) if fault else []
    return {
        "fault": fault or None,
        "ways_on": [{"way": way.label, "moves": way.moves, "command": _write_command(name, way)} for way in ways],
    }


def _write_command(campaign_id: str, way: WayOnward) -> str:
    """Write the command that takes a way on in a terminal; `fast campaign run` then goes on."""
    part = way.part
    if part is None:
        return "fast campaign run CONFIG"
    words = [f"--tool {tool_label(part.batch, part.slot)}"] if part.slot is not None else []
    words += [f"--object {part.object_id}"] if part.object_id is not None else []
    words += [f"--repeat {part.repeat}"] if part.repeat is not None else []
    return f"fast campaign leave-out {campaign_id} {' '.join(words or [f'--batch {part.batch}'])}"


def _imported_status(lake: Lake, campaign_id: str) -> dict[str, Any]:
    """Return the same for imported data, of which all that there is is done."""
    n_grasps = len(lake.ids(GraspRow, campaign_id=campaign_id))
    versions = lake.rows(SimulatorVersionRow, tier=IMPORTED)
    own = [row["version_id"] for row in versions if importing_campaign(row["version_json"]) == campaign_id]
    n_simulated = len(lake.ids(SimulationRow, version_id=own))
    tools = rank_tools(lake, campaign_id)
    return {
        "campaign": campaign_id,
        "state": IMPORTED,
        "grasps": f"{n_grasps}/{n_grasps}",
        "simulated": f"{n_simulated}/{n_simulated}",
        "waiting_for_print": [],
        "waiting_for_answers": [],
        "waiting_for_grasps": [],
        "best_tool": tools[0]["tool_id"] if tools else None,
        "best_n": tools[0]["tool_quality_n"] if tools else None,
        "advice": None,
        "last_event": None,
        "fault": None,
        "ways_on": [],
        "output": str(lake.root / "outputs" / campaign_id),
    }


def format_status(status: dict[str, Any], lake: str | None = None) -> str:
    """Format the status as lines for a person; the last one says what to do. `lake`: address that its commands name."""
    there = f" --lake {shlex.quote(lake)}" if lake else ""
    lines = [
        f"campaign   {status['campaign']} ({status['state']})",
        f"grasps     {status['grasps']}",
        f"simulated  {status['simulated']}",
    ]
    if n_failures := status.get("failures"):
        own = f"campaign_id = '{status['campaign']}' AND status = 'failed'"
        why = f"SELECT reason, count(*) FROM grasps WHERE {own} GROUP BY reason"
        lines.insert(2, f'           {spell_count(n_failures, "attempt")} failed: fast sql{there} "{why}"')
    if n_before := status.get("simulated_before"):
        lines.append(f"           {n_before} of them by an older simulator version: forces are not quite the same")
    if status["fault"]:
        lines.append(f"fault      {status['fault']}")
        lines += [f"way on     {way['command']}{there}: {way['moves']}" for way in status["ways_on"]]
    if status["best_tool"]:
        lines.append(f"best tool  {status['best_tool']}  {status['best_n']:.2f} N")
    if status["advice"]:
        lines.append(f"next batch after B{status['advice']['after_batch']:02d}: {status['advice']['sentence']}")
        lines.append(f"health     {status['advice']['tone']}: {status['advice']['health']}")
    for batch in status["waiting_for_print"]:
        lines.append(f"waiting    for batch {batch}: fast print confirm {batch} --operator NAME{there}")
    for sentence in status["waiting_for_answers"]:
        lines.append(f"waiting    for an answer: {sentence} See fast campaign answer {status['campaign']}{there}")
    for batch in status["waiting_for_grasps"]:
        lines.append(f"waiting    for grasps of batch {batch}: fast tell CONFIG results.csv --operator NAME{there}")
    return "\n".join(lines)


def describe_state(lake: Lake, campaign_id: str, is_complete: bool) -> str:
    """Say what a campaign is doing, in a word or two: who owns it, or how its last run ended."""
    holder = holder_of(lake.storage, lease_name(campaign_id))
    if holder is not None:
        searcher = holder_of(lake.storage, GAP_LEASE)
        if searcher is not None and (searcher.machine, searcher.pid) == (holder.machine, holder.pid):
            return "running, searches for a gap"
        return "running" if holder.is_here else f"running, as far as is known, on {holder.host}"
    if is_complete:
        return "complete"
    verb = requested_verb(lake, campaign_id)
    return _ENDED_BY[verb] if verb else "interrupted"
