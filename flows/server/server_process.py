"""Body of the server's own process: Prefect's pages, and the lake's output folder read-only beside them.

Arguments: numbers of the listening sockets that the parent hands on, process id of the parent, output folder.
"""

import functools
import gc
import inspect
import os
import socket
import sys
from datetime import timedelta
from pathlib import Path

from fast.flows.server.gate import App, Receive, Scope, Send, add_gate
from fast.flows.server.loopback import split_numbers

OUTPUTS = "/outputs"
WORKER_PACES = {"minimum_check_interval": 5.0, "scheduling_resolution": 5.0}
QUEUE_PACES = {"heartbeat_interval": 30.0}

LOGIN_VARIABLE = "FAST_SERVER_LOGIN"  # what the parent tells this process, which other users cannot read


def add_outputs(pages: App, folder: Path) -> App:
    """Return Prefect's application with reports and recordings of the lake under `/outputs/`."""
    from starlette.applications import Starlette
    from starlette.routing import Mount
    from starlette.staticfiles import StaticFiles

    folder.mkdir(parents=True, exist_ok=True)
    # It does not follow links, nor leave the folder.
    files = Starlette(routes=[Mount(OUTPUTS, StaticFiles(directory=folder, html=True))])

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        is_output = scope["type"] == "http" and scope["path"].startswith(f"{OUTPUTS}/")
        await (files if is_output else pages)(scope, receive, send)

    return app


def slow_queue() -> None:
    """Have the server's queue of background work look seldom for what is due; what is due at once is done at once.

    These are documented parameters of docket, for which Prefect has no setting and takes the defaults: four looks a
    second, and a heartbeat every two. One that a later version does not know is left out.
    """
    import docket

    for made, paces in ((docket.Worker, WORKER_PACES), (docket.Docket, QUEUE_PACES)):
        known = inspect.signature(made).parameters
        taken = {name: timedelta(seconds=pace_s) for name, pace_s in paces.items() if name in known}
        paced = functools.partialmethod(made.__init__, **taken)
        made.__init__ = paced  # type: ignore[method-assign, assignment]  # the class is made for this process alone


def serve(listeners: list[socket.socket], parent_pid: int, folder: Path) -> None:
    """Serve what comes to listening sockets until the parent is gone."""
    gc.set_threshold(50_000)  # as `fast` has it: a sixth of its start
    import uvicorn
    from prefect.server.api.server import create_app

    from fast.tasks.simulation.pool import follow_parent

    follow_parent(parent_pid)
    slow_queue()
    login = os.environ.pop(LOGIN_VARIABLE)
    app = add_gate(add_outputs(create_app(), folder), login, listeners[0].getsockname()[0])
    # Of a proxy's word about who asks, nothing is believed.
    config = uvicorn.Config(app, log_level="warning", proxy_headers=False)
    uvicorn.Server(config).run(sockets=listeners)


if __name__ == "__main__":
    serve(split_numbers(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
