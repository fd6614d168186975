"""Flow runs whose process is gone: said so in the pages, and campaigns of them started again.

Prefect learns of the end of a run from the process that does it, or from the worker that started that. When both are
killed, or the machine goes down, nobody tells it: the run stays Running for good, and holds the slot of its deployment.
Here the operating system is asked instead.
"""

import logging
import urllib.error
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from fast.flows.server.access import Api
from fast.flows.server.run_process import RunningProcess, is_process_alive
from fast.flows.server.server import ask_server

logger = logging.getLogger(__name__)

OURS = ("campaign", "run-campaign", "print", "run-batch", "simulate", "report", "recalibrate", "close-gap")  # flows
CONTINUED = "run-campaign"  # the flow that goes on by itself: the lake says where it stands
CONTINUES = "continues-a-crashed-run"
ACTIVE = ("RUNNING", "PENDING", "CANCELLING")
UNMARKED_LIMIT_S = 300.0  # a run marks itself when its process has started, on a busy machine after a minute
ORPHAN_LIMIT_S = 15.0  # after the start of a worker: what the one before it had started is marked, or has ended with it
MOST_PER_HOUR = 20  # continuations of one campaign: it may be the campaign that kills its process
FORGOTTEN_AFTER = timedelta(days=1)  # a crash that nobody minded for so long is left to people
_AT_ONCE = 200  # runs per question; the server gives no more

Run = dict[str, Any]


@dataclass(frozen=True)
class EndedRuns:
    """Runs that were declared crashed, and campaigns that were continued, a sentence for each."""

    crashed: list[str] = field(default_factory=list)
    continued: list[str] = field(default_factory=list)

    @property
    def sentences(self) -> list[str]:
        """All of them."""
        return [*self.crashed, *self.continued]


def end_crashed_runs(
    api: Api,
    *,
    and_continue: bool = False,
    worker_since: datetime | None = None,
) -> EndedRuns:
    """Declare crashed every run of ours whose process is gone; with `and_continue`, start campaigns of them again.

    `worker_since`: start of the worker, where it is the only one. A server that does not answer is asked again next
    time.
    """
    try:
        names = _flow_names(api)
        crashed = [sentence for run in _active(api, names) if (sentence := _declare(api, run, worker_since))]
        continued = _continue_campaigns(api, names) if and_continue else []
    except (OSError, ValueError) as error:
        logger.warning("crashed flow runs were not looked for: %s", error)
        return EndedRuns()
    return EndedRuns(crashed, continued)


def explain_death(run: Run, now: datetime, worker_since: datetime | None = None) -> str | None:
    """Explain in one sentence why a run that the server holds for active is not; None when it may be.

    `worker_since`: start of the only worker; what the one before it was about to start, nobody will.
    """
    process = RunningProcess.of_tags(run["tags"])
    if process is not None:
        if not process.is_here or process.is_alive():
            return None
        return f"its process {process.pid} on {process.host} is gone: killed, or the machine went down"
    if str(run.get("infrastructure_pid") or "").isdecimal() and is_process_alive(int(run["infrastructure_pid"])):
        return None
    since = _time(run["state"]["timestamp"])
    if run["state"]["type"] == "PENDING" and worker_since is not None and _is_orphaned(since, worker_since, now):
        return "the worker that was to start it is gone: killed, or the machine went down"
    age_s = (now - since).total_seconds()
    if age_s < UNMARKED_LIMIT_S:
        return None
    return f"no process has said for {age_s:.0f} s that it does this run"


def _is_orphaned(since: datetime, worker_since: datetime, now: datetime) -> bool:
    """Return whether the worker that took a run at `since` is gone, and all that it had started with it."""
    return since < worker_since and (now - worker_since).total_seconds() > ORPHAN_LIMIT_S


def _flow_names(api: Api) -> dict[str, str]:
    """Return ids and names of the flows that are ours."""
    wanted = {"flows": {"name": {"any_": list(OURS)}}}
    return {flow["id"]: flow["name"] for flow in ask_server(api, "/flows/filter", wanted)}


def _active(api: Api, names: Iterable[str]) -> list[Run]:
    if not (flow_ids := list(names)):
        return []
    question = {
        "flow_runs": {"state": {"type": {"any_": list(ACTIVE)}}},
        "flows": {"id": {"any_": flow_ids}},
        "limit": _AT_ONCE,
    }
    return list(ask_server(api, "/flow_runs/filter", question))


def _declare(api: Api, run: Run, worker_since: datetime | None) -> str | None:
    """Set a run whose process is gone, and its tasks, to Crashed; returns the sentence about it.

    Where a person has asked for its end it is Cancelled, and is not continued.
    """
    reason = explain_death(run, datetime.now(UTC), worker_since)
    if reason is None:
        return None
    state = "CANCELLED" if run["state"]["type"] == "CANCELLING" else "CRASHED"
    _set_state(api, "flow_runs", run["id"], state, reason)
    question = {
        "task_runs": {"state": {"type": {"any_": list(ACTIVE)}}},
        "flow_runs": {"id": {"any_": [run["id"]]}},
        "limit": _AT_ONCE,
    }
    for task_run in ask_server(api, "/task_runs/filter", question):
        _set_state(api, "task_runs", task_run["id"], state, reason)
    return f"{_title(run)} was cancelled" if state == "CANCELLED" else f"{_title(run)} has crashed: {reason}"


def _set_state(api: Api, kind: str, run_id: str, state: str, reason: str) -> None:
    new = {"type": state, "name": state.title(), "message": reason}
    ask_server(api, f"/{kind}/{run_id}/set_state", {"state": new, "force": True})


def _continue_campaigns(api: Api, names: dict[str, str]) -> list[str]:
    """Start again every campaign whose last run from a deployment has crashed; a person's stop is no crash."""
    flow_ids = [flow_id for flow_id, name in names.items() if name == CONTINUED]
    if not flow_ids:
        return []
    question = {"flows": {"id": {"any_": flow_ids}}, "sort": "EXPECTED_START_TIME_DESC", "limit": _AT_ONCE}
    by_campaign: dict[str, list[Run]] = {}
    for run in ask_server(api, "/flow_runs/filter", question):
        if run["deployment_id"] and not run["auto_scheduled"]:
            by_campaign.setdefault(f"{run['deployment_id']} {sorted(run['parameters'].items())}", []).append(run)
    return [sentence for runs in by_campaign.values() if (sentence := _continue(api, runs))]


def _continue(api: Api, runs: list[Run]) -> str | None:
    """Start a new run with the parameters of the last, newest first, if that has crashed."""
    last, now = runs[0], datetime.now(UTC)
    if last["state"]["type"] != "CRASHED" or _time(last["state"]["timestamp"]) < now - FORGOTTEN_AFTER:
        return None
    recent = [run for run in runs if CONTINUES in run["tags"] and _time(run["created"]) > now - timedelta(hours=1)]
    if len(recent) >= MOST_PER_HOUR:
        logger.warning("%s has crashed and was continued %d times within an hour: no more", _title(last), len(recent))
        return None
    new = {"parameters": last["parameters"], "tags": [CONTINUES], "idempotency_key": f"continues-{last['id']}"}
    try:
        ask_server(api, f"/deployments/{last['deployment_id']}/create_flow_run", new)
    except urllib.error.HTTPError as error:
        return f"{_title(last)} has crashed and its deployment starts no other: {error.reason}"
    return f"{_title(last)} has crashed and is continued"


def _title(run: Run) -> str:
    """Return `run NAME`; names such as `run campaigns/quick.toml` say so themselves."""
    name = str(run["name"])
    return name if name.startswith("run ") else f"run {name}"


def _time(text: str) -> datetime:
    return datetime.fromisoformat(text)
