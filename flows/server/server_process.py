"""Body of the server's own process: Prefect's pages, and the lake's output folder read-only beside them.

Arguments: number of the listening socket that the parent hands on, process id of the parent, output folder.
"""

import base64
import binascii
import functools
import hmac
import inspect
import os
import socket
import sys
from collections.abc import Awaitable, Callable, MutableMapping
from datetime import timedelta
from pathlib import Path
from typing import Any

OUTPUTS = "/outputs"
WORKER_PACES = {"minimum_check_interval": 5.0, "scheduling_resolution": 5.0}
QUEUE_PACES = {"heartbeat_interval": 30.0}

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


def add_outputs(pages: App, folder: Path, login: str | None) -> App:
    """Prefect's application with reports and recordings of the lake under `/outputs/`, behind the same password."""
    from starlette.applications import Starlette
    from starlette.responses import PlainTextResponse
    from starlette.routing import Mount
    from starlette.staticfiles import StaticFiles

    folder.mkdir(parents=True, exist_ok=True)
    # It does not follow links, nor leave the folder.
    files = Starlette(routes=[Mount(OUTPUTS, StaticFiles(directory=folder, html=True))])
    refusal = PlainTextResponse("Password needed.", 401, {"WWW-Authenticate": 'Basic realm="FAST"'})

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        is_output = scope["type"] == "http" and scope["path"].startswith(f"{OUTPUTS}/")
        if not is_output:
            await pages(scope, receive, send)
        elif login is not None and not _knows(scope, login):
            await refusal(scope, receive, send)
        else:
            await files(scope, receive, send)

    return app


def _knows(scope: Scope, login: str) -> bool:
    """Whether the request carries the login."""
    sent = dict(scope["headers"]).get(b"authorization", b"").decode("latin-1")
    kind, _, code = sent.partition(" ")
    try:
        return kind == "Basic" and hmac.compare_digest(base64.b64decode(code, validate=True), login.encode())
    except (binascii.Error, ValueError):
        return False


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


def serve(listener: socket.socket, parent_pid: int, folder: Path) -> None:
    """Serve what comes to a listening socket until the parent is gone."""
    import uvicorn
    from prefect.server.api.server import create_app

    from fast.tasks.simulation.pool import follow_parent

    follow_parent(parent_pid)
    slow_queue()
    login = os.environ.get("PREFECT_SERVER_API_AUTH_STRING")
    config = uvicorn.Config(add_outputs(create_app(), folder, login), log_level="warning")
    uvicorn.Server(config).run(sockets=[listener])


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2]), Path(sys.argv[3]))
