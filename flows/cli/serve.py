"""`fast serve`: the Prefect server of a lake, with its pages."""

import json as json_module
import os
import socket
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, say


def serve(
    *,
    lake: LakePath = DEFAULT_LAKE,
    port: Annotated[int, Parameter(help="Port on the loopback address.", validator=Number(gte=1, lte=65535))] = 4200,
    json: AsJson = False,
) -> None:
    """Run the Prefect server of this lake until Ctrl-C; campaigns on the same lake show there."""
    from flows.cli.virtual import wait_for, watch_signals
    from flows.dependencies import require
    from flows.prefect_server import running_server, server
    from lake.store import Lake
    from models.errors import FastError

    require(["prefect"])
    _check_server_wanted(port)
    found = Lake.open(lake, create=True)
    known = running_server(found.root)
    if known:
        raise FastError(f"a server of this lake runs already: {known.removesuffix('/api')}; use that one.")
    with server(found.root, port) as api_url:
        asked = watch_signals()  # a server that is still starting is ended by the default
        page = api_url.removesuffix("/api")
        if json:
            say(json_module.dumps({"url": page, "api_url": api_url, "lake": found.address}))
        else:
            say(f"Prefect server of {found.address}: {page}")
            say("Ctrl-C stops it; campaigns that use it go on with their work.")
        wait_for(asked)


def _check_server_wanted(port: int) -> None:
    """Raises UsageError when the environment names another server, or the port is taken."""
    from models.errors import UsageError

    named = os.environ.get("PREFECT_API_URL")
    if named:
        raise UsageError(f"PREFECT_API_URL is {named}, so campaigns use that server; unset it to start one here.")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port left a moment ago is free
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise UsageError(f"--port {port} cannot be used ({error.strerror}); give another one.") from error
