"""The worker of `fast serve`: what the page starts on it, what it does and will do, and what of its work failed."""

import urllib.error
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from fast.flows.page.web import write_clock
from fast.flows.server.access import Api
from fast.flows.server.server import address_for_others, ask_server, find_any_server
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.tasks.campaign.requests import STARTED

_OPEN = ["SCHEDULED", "PENDING", "RUNNING", "PAUSED"]
_FAILED = ["FAILED", "CRASHED"]
_TOLD_FOR = timedelta(days=1)  # a failure that nobody mended by then is no news
_BEGUN = f"""
    SELECT payload_json ->> '$.config' AS config, max(created_at) AS begun_at FROM events
    WHERE kind = '{STARTED}' AND config IS NOT NULL GROUP BY config ORDER BY begun_at
"""
_FLOWS = {"recalibrate": "calibration", "close-gap": "search for what the simulator misses", "simulate": "simulations"}
ON_PAGE = "started on the lab's page"


@dataclass(frozen=True)
class Job:
    """A run of the queue; `reason`: the sentence of one that failed."""

    name: str
    state: str
    since: str
    reason: str = ""


def list_jobs(lake: Lake) -> list[Job] | None:
    """List what the worker does and will do, and what failed, forms left aside; None where no worker stands."""
    api = find_any_server(lake)
    if api is None:
        return None
    try:
        flows = {flow["id"]: flow["name"] for flow in ask_server(api, "/flows/filter", {})}
        return [*_list_open(api, flows, lake), *_list_failed(api, flows, lake)]
    except (OSError, ValueError):
        return None


def _list_open(api: Api, flows: Mapping[str, str], lake: Lake) -> list[Job]:
    which = {"flow_runs": {"state": {"type": {"any_": _OPEN}}}, "sort": "EXPECTED_START_TIME_ASC", "limit": 50}
    jobs: dict[str, Job] = {}
    for run in _read_runs(api, which, lake):
        flow = flows.get(run["flow_id"], run["name"])
        if flow == "print":
            continue
        is_planned = run["auto_scheduled"] and run["state"]["type"] == "SCHEDULED"
        state = "planned" if is_planned else run["state"]["name"].lower()
        at = run.get("start_time") or run.get("expected_start_time")
        name = _name_job(flow, run)
        # Of what comes every day, the next time alone; of a campaign, one of its two flows.
        jobs.setdefault(flow if is_planned else f"{name} {state}", Job(name, state, _clock(at)))
    return list(jobs.values())


def _list_failed(api: Api, flows: Mapping[str, str], lake: Lake) -> list[Job]:
    """List jobs whose last run of this day failed, newest first; of campaigns those nobody began again since."""
    ended = {"state": {"type": {"any_": [*_FAILED, "COMPLETED"]}}, "deployment_id": {"is_null_": False}}
    ended |= {"end_time": {"after_": (datetime.now(UTC) - _TOLD_FOR).isoformat()}}
    last: dict[str, dict[str, Any]] = {}
    for run in _read_runs(api, {"flow_runs": ended, "sort": "END_TIME_DESC", "limit": 200}, lake):
        last.setdefault(_name_job(flows.get(run["flow_id"], run["name"]), run), run)
    begun = {f"campaign {Path(row['config']).stem}": row["begun_at"] for row in lake.query(_BEGUN).to_pylist()}
    return [
        Job(name, "failed", _clock(run["end_time"]), run["state"].get("message") or "")
        for name, run in last.items()
        if run["state"]["type"] in _FAILED
        and not (name in begun and datetime.fromisoformat(run["end_time"]) < begun[name])
    ]


def _read_runs(api: Api, which: dict[str, Any], lake: Lake) -> list[dict[str, Any]]:
    """Read the runs of this lake that the server has."""
    here = address_for_others(lake)
    return [run for run in ask_server(api, "/flow_runs/filter", which) if run["parameters"].get("lake", here) == here]


def _name_job(flow: str, run: Mapping[str, Any]) -> str:
    """Name what a run does; Prefect gives it our name when it begins, until then one like `sage-petrel`."""
    told = run["parameters"]
    if flow == "run-campaign":
        return f"campaign {Path(told.get('config', '')).stem}"
    if flow == "report":
        return f"report of {told.get('campaign', '')}"
    if flow == "lend":
        return f"a virtual bench, moved by hand by {told.get('holder', '')}"
    return _FLOWS.get(flow, str(run["name"]))


def _clock(text: str | None) -> str:
    return write_clock(datetime.fromisoformat(text) if text else None)


def start_on_worker(
    lake: Lake, deployment: str, parameters: Mapping[str, Any], operator: str, key: str | None = None
) -> None:
    """Have the worker start a deployment; `key`: the same one twice is one.

    Raises:
        UsageError: no worker stands, or the server did not take it.
    """
    api = require_worker(lake)
    try:
        found = ask_server(api, f"/deployments/name/{deployment}")
        body = {
            "parameters": {**parameters, "lake": address_for_others(lake)},
            "tags": [ON_PAGE, f"by {operator}"],
            **({"idempotency_key": key} if key is not None else {}),
        }
        ask_server(api, f"/deployments/{found['id']}/create_flow_run", body)
    except (OSError, ValueError, urllib.error.URLError) as error:
        raise UsageError(
            f"The server of the flows did not take it ({error}); look at `fast serve`, then try again."
        ) from error


def require_worker(lake: Lake) -> Api:
    """Return the server of `fast serve`.

    Raises:
        UsageError: it does not stand.
    """
    api = find_any_server(lake)
    if api is None:
        raise UsageError("No worker is running, so nothing was started: run `fast serve`, and use its page.")
    return api
