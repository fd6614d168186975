"""Forms of human steps in Prefect's pages: runs of a deployment that wait for a person.

A form is a convenience beside `fast print confirm`: what counts is in the lake, so nothing here fails a campaign.
"""

import logging
import urllib.error
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fast.flows.server.access import Api
from fast.flows.server.server import address_for_others, ask_server, find_any_server
from fast.lake.store import Lake

logger = logging.getLogger(__name__)

_OPEN = ["SCHEDULED", "PENDING", "RUNNING", "PAUSED"]


@dataclass(frozen=True)
class Form:
    """What a person is asked in the pages. deployment: whose flow asks; tag: by which it is found again.

    find_open: parameters of the flow, without the address of the lake; None where nothing is left to be answered.
    """

    deployment: str
    title: str
    tag: str
    find_open: Callable[[], Mapping[str, Any] | None]


def open_form(lake: Lake, form: Form) -> str | None:
    """Have a form in the pages, one and no more; returns the address of its page.

    None where all is answered, as it is when a form ended and its campaign has not heard of it yet; and where the
    server does not answer or nobody has applied prefect.yaml (`fast serve`).
    """
    api = find_any_server(lake)
    if api is None:
        return None
    try:
        runs = _open_runs(api, lake, form)
        # Asked for after the forms: one that has ended since has its answer in the lake.
        if not runs and (parameters := form.find_open()) is None:
            return None
        run = runs[0] if runs else _start(api, lake, form, parameters)
    except (OSError, ValueError) as error:
        if not (isinstance(error, urllib.error.HTTPError) and error.code == 404):
            logger.warning("no form for %s in the pages: %s", form.tag, error)
        return None
    return f"{api.page}/runs/flow-run/{run['id']}"


def close_forms(lake: Lake, form: Form, reason: str) -> None:
    """End the forms of a step that nobody needs any more."""
    api = find_any_server(lake)
    if api is None:
        return
    try:
        for run in _open_runs(api, lake, form):
            state = {"type": "COMPLETED", "name": "Completed", "message": reason}
            ask_server(api, f"/flow_runs/{run['id']}/set_state", {"state": state, "force": True})
    except (OSError, ValueError) as error:
        logger.warning("the form of %s stays open: %s", form.tag, error)


def _start(api: Api, lake: Lake, form: Form, parameters: Mapping[str, Any] | None) -> dict[str, Any]:
    deployment = ask_server(api, f"/deployments/name/{form.deployment}")
    filled = {**(parameters or {}), "lake": address_for_others(lake)}
    body = {"name": form.title, "parameters": filled, "tags": ["needs-you", form.tag]}
    found: dict[str, Any] = ask_server(api, f"/deployments/{deployment['id']}/create_flow_run", body)
    return found


def _open_runs(api: Api, lake: Lake, form: Form) -> list[dict[str, Any]]:
    """List the forms of a step of this lake that have not ended."""
    which = {
        "flow_runs": {
            "tags": {"all_": [form.tag]},
            "state": {"type": {"any_": _OPEN}},
        }
    }
    runs = ask_server(api, "/flow_runs/filter", which)
    return [run for run in runs if run["parameters"].get("lake") == address_for_others(lake)]
