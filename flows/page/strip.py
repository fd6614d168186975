"""What a campaign does, in a word, and the orders that a person may give it now."""

from dataclasses import dataclass
from typing import Any

from fast.flows.campaign.status import describe_state, read_campaign
from fast.hardware.parts.safe_state import Verb
from fast.lake.order import LATEST_FIRST
from fast.lake.store import Lake
from fast.tasks.bench.ways_on import WayOnward, list_ways, read_fault
from fast.tasks.campaign.present_run import read_present_run
from fast.tasks.campaign.requests import STARTED
from fast.tasks.campaign.simulator_versions import at_present

_LAST_START = f"""
    SELECT payload_json ->> '$.run' AS run, payload_json ->> '$.config' AS config,
        payload_json ->> '$.auto_print' AS auto_print, payload_json ->> '$.real' AS is_real
    FROM events WHERE campaign_id = $campaign AND kind = '{STARTED}' ORDER BY {LATEST_FIRST}, event_id DESC LIMIT 1
"""
_ENDING = {
    Verb.PAUSE: "pausing",
    Verb.STOP: "stopping",
    Verb.ABORT: "stopping",
    Verb.ESTOP: "emergency stop",
}


@dataclass(frozen=True)
class Strip:
    """The control strip."""

    campaign_id: str
    """That is steered."""
    word: str
    """What the campaign does, or how its last run ended."""
    explains: str
    """What the word means now, and until when; empty where it says enough."""
    run: str
    """Names the run that is seen, which goes on or was the last; empty where none is known."""
    may_pause: bool
    """Whether a run goes on that has had no order yet."""
    may_stop: bool
    """Whether a run goes on that is not asked to stop already."""
    may_continue: bool
    """Whether no run goes on and the campaign is not at its end."""
    fault: str = ""
    """Why the last run failed, in the words of the terminal; empty if it did not."""
    ways: tuple[WayOnward, ...] = ()
    """Onward after that fault; none without one."""


@dataclass(frozen=True)
class LastStart:
    """How a campaign was last started. `config`: its file; empty where it is not known."""

    run: str
    config: str
    auto_print: bool
    is_real: bool


def read_strip(lake: Lake, campaign_id: str, is_complete: bool, is_waiting: bool) -> Strip:
    """Read what the strip shows; `is_waiting`: a person is asked for something and the bench can do nothing else."""
    present = read_present_run(lake, campaign_id)
    if present.holder is not None:
        verb = present.verb
        word = _ENDING[verb] if verb is not None else "waiting" if is_waiting else "running"
        explains = {
            "running": "",
            "waiting": "for a person, see To do",
            "pausing": "the grasp in progress is finished first (a minute at most); Stop now does not wait for it",
            "stopping": "the bench goes to its safe state; if this stays for a minute, press the emergency stop",
            "emergency stop": "a person must look",
        }[word]
        return Strip(campaign_id, word, explains, present.run, verb is None, verb is not Verb.STOP, False)
    word = describe_state(lake, campaign_id, is_complete)
    start, fault = read_last_start(lake, campaign_id), ""
    if word == "interrupted":
        fault = read_fault(lake, campaign_id)
        word = "stopped by a fault" if fault else word
    may_continue = word not in ("complete", "imported")
    ways: list[WayOnward] = []
    if fault:
        campaign = at_present(read_campaign(lake, campaign_id))
        ways = list_ways(campaign, campaign.state())
    return Strip(campaign_id, word, "", start.run if start else "", False, False, may_continue, fault, tuple(ways))


def read_last_start(lake: Lake, campaign_id: str) -> LastStart | None:
    """Read how the last run of a campaign was started, if one was."""
    rows: list[dict[str, Any]] = lake.query(_LAST_START, {"campaign": campaign_id}).to_pylist()
    if not rows:
        return None
    row = rows[0]
    return LastStart(row["run"] or "", row["config"] or "", row["auto_print"] == "true", row["is_real"] == "true")
