"""`fast serve`: the Prefect server of a lake, with its pages."""

import time
from typing import Annotated

from cyclopts import Parameter

from flows.cli.common import DEFAULT_LAKE, LakePath, say


def serve(
    *, lake: LakePath = DEFAULT_LAKE, port: Annotated[int, Parameter(help="port on the loopback address")] = 4200
) -> None:
    """Run the Prefect server of this lake until Ctrl-C; campaigns on the same lake show there."""
    from flows.prefect_server import running_server, server
    from lake.store import Lake
    from models.errors import FastError

    found = Lake.open(lake, create=True)
    known = running_server(found.root)
    if known:
        raise FastError(f"a server of this lake runs already: {known.removesuffix('/api')}; use that one.")
    with server(found.root, port) as api_url:
        say(f"Prefect server of {found.root}: {api_url.removesuffix('/api')}")
        say("Ctrl-C stops it; campaigns that use it go on with their work.")
        while True:
            time.sleep(1)
