"""The form of a printed batch in Prefect's pages: a run of a deployment that waits for a person.

A form is a convenience beside `fast print confirm`: what counts is in the lake, so nothing here fails a campaign.
"""

import logging
import urllib.error
from typing import Any

from fast.flows.server.access import Api
from fast.flows.server.server import address_for_others, ask_server, find_any_server
from fast.lake.store import Lake
from fast.lake.tables.campaign import BatchRow
from fast.tasks.bench.print import open_slots

logger = logging.getLogger(__name__)

_OPEN = ["SCHEDULED", "PENDING", "RUNNING", "PAUSED"]


def open_form(lake: Lake, campaign_id: str, batch: int) -> str | None:
    """Have the form of the open slots of a batch in the pages, one and no more; returns the address of its page.

    None where all is answered, as it is when a form ended and its campaign has not heard of it yet; and where the
    server does not answer or nobody has applied prefect.yaml (`fast serve`).
    """
    api, name = find_any_server(lake), BatchRow.make_id(campaign_id, batch)
    if api is None:
        return None
    try:
        runs = _open_runs(api, lake, name)
        # Asked for after the forms: one that has ended since has its answer in the lake.
        if not runs:
            slots = open_slots(lake, campaign_id, batch)
            if not slots:
                return None
            runs = [_start(api, lake, name, {"campaign": campaign_id, "batch": batch, "slots": slots})]
    except (OSError, ValueError) as error:
        if not (isinstance(error, urllib.error.HTTPError) and error.code == 404):
            logger.warning("no form for %s in the pages: %s", name, error)
        return None
    return f"{api.page}/runs/flow-run/{runs[0]['id']}"


def close_forms(lake: Lake, campaign_id: str, batch: int, reason: str) -> None:
    """End the forms of a batch that nobody needs any more."""
    api, name = find_any_server(lake), BatchRow.make_id(campaign_id, batch)
    if api is None:
        return
    try:
        for run in _open_runs(api, lake, name):
            state = {"type": "COMPLETED", "name": "Completed", "message": reason}
            ask_server(api, f"/flow_runs/{run['id']}/set_state", {"state": state, "force": True})
    except (OSError, ValueError) as error:
        logger.warning("the form of %s stays open: %s", name, error)


def _start(api: Api, lake: Lake, batch: str, parameters: dict[str, Any]) -> dict[str, Any]:
    deployment = ask_server(api, "/deployments/name/print/print")
    filled = {**parameters, "lake": address_for_others(lake)}
    body = {"name": f"{batch}: printed and mounted?", "parameters": filled, "tags": ["needs-you", batch]}
    found: dict[str, Any] = ask_server(api, f"/deployments/{deployment['id']}/create_flow_run", body)
    return found


def _open_runs(api: Api, lake: Lake, batch: str) -> list[dict[str, Any]]:
    """List the forms of a batch of this lake that have not ended."""
    which = {
        "flow_runs": {
            "tags": {"all_": [batch]},
            "state": {"type": {"any_": _OPEN}},
        }
    }
    runs = ask_server(api, "/flow_runs/filter", which)
    return [run for run in runs if run["parameters"].get("lake") == address_for_others(lake)]
