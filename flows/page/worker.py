"""The worker of `fast serve`, which does what is started on the page."""

import urllib.error
from collections.abc import Mapping
from typing import Any

from fast.flows.server.access import Api
from fast.flows.server.server import address_for_others, ask_server, find_any_server
from fast.lake.store import Lake
from fast.models.errors import UsageError

ON_PAGE = "started on the lab's page"


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
    """The server of `fast serve`.

    Raises:
        UsageError: it does not stand.
    """
    api = find_any_server(lake)
    if api is None:
        raise UsageError("No worker is running, so nothing was started: run `fast serve`, and use its page.")
    return api
