"""Forms of the human step in Prefect's pages: runs of the deployment `print/print` that wait for a person.

A form is a convenience beside `fast print confirm`: what counts is in the lake, so nothing here fails a campaign.
"""

import logging
import os
import urllib.error
from typing import Any

from flows.server.server import address_for_others, ask_server, find_server
from lake.store import Lake
from lake.tables.campaign import BatchRow
from tasks.bench.print import open_slots

logger = logging.getLogger(__name__)

DEPLOYMENT = "print/print"
_OPEN = ["SCHEDULED", "PENDING", "RUNNING", "PAUSED"]


def open_form(lake: Lake, campaign_id: str, batch: int) -> str | None:
    """Have a form for the open slots of a batch in the pages, one and no more; returns the address of its page.

    None where the server does not answer or nobody has applied prefect.yaml (`fast serve`).
    """
    api_url = _server_of(lake)
    if api_url is None:
        return None
    try:
        runs = _open_runs(api_url, lake, campaign_id, batch)
        run = runs[0] if runs else _start(api_url, lake, campaign_id, batch)
    except (OSError, ValueError) as error:
        if not (isinstance(error, urllib.error.HTTPError) and error.code == 404):
            logger.warning("no form for %s in the pages: %s", BatchRow.make_id(campaign_id, batch), error)
        return None
    return f"{api_url.removesuffix('/api')}/runs/flow-run/{run['id']}"


def close_forms(lake: Lake, campaign_id: str, batch: int, reason: str) -> None:
    """End the forms of a batch that nobody needs any more."""
    api_url = _server_of(lake)
    if api_url is None:
        return
    try:
        for run in _open_runs(api_url, lake, campaign_id, batch):
            state = {"type": "COMPLETED", "name": "Completed", "message": reason}
            ask_server(api_url, f"/flow_runs/{run['id']}/set_state", {"state": state, "force": True})
    except (OSError, ValueError) as error:
        logger.warning("the form of %s stays open: %s", BatchRow.make_id(campaign_id, batch), error)


def _server_of(lake: Lake) -> str | None:
    return os.environ.get("PREFECT_API_URL") or find_server(lake.root)


def _start(api_url: str, lake: Lake, campaign_id: str, batch: int) -> dict[str, Any]:
    deployment = ask_server(api_url, f"/deployments/name/{DEPLOYMENT}")
    name = f"{BatchRow.make_id(campaign_id, batch)}: printed and mounted?"
    slots = open_slots(lake, campaign_id, batch)
    parameters = {"campaign": campaign_id, "batch": batch, "slots": slots, "lake": address_for_others(lake)}
    body = {"name": name, "parameters": parameters, "tags": ["needs-you", BatchRow.make_id(campaign_id, batch)]}
    found: dict[str, Any] = ask_server(api_url, f"/deployments/{deployment['id']}/create_flow_run", body)
    return found


def _open_runs(api_url: str, lake: Lake, campaign_id: str, batch: int) -> list[dict[str, Any]]:
    """Forms of a batch of this lake that have not ended."""
    which = {
        "flow_runs": {
            "tags": {"all_": [BatchRow.make_id(campaign_id, batch)]},
            "state": {"type": {"any_": _OPEN}},
        }
    }
    runs = ask_server(api_url, "/flow_runs/filter", which)
    return [run for run in runs if run["parameters"].get("lake") == address_for_others(lake)]
