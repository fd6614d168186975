"""Body of the page's own process. Arguments: numbers of the listening sockets, id of the parent process, lake."""

import os
import socket
import sys

from fast.flows.server.loopback import split_numbers
from fast.flows.server.page_port import LOGIN_VARIABLE


def serve(listeners: list[socket.socket], parent_pid: int, lake: str) -> None:
    """Serve the page of a lake to whoever comes to listening sockets, until the parent is gone."""
    import uvicorn

    from fast.flows.page.app import make_app
    from fast.flows.server.access import Role
    from fast.flows.server.gate import add_gate
    from fast.lake.store import Lake
    from fast.tasks.simulation.pool import follow_parent

    follow_parent(parent_pid)
    login = os.environ.pop(LOGIN_VARIABLE)
    app = add_gate(make_app(Lake.open(lake), login), login, listeners[0].getsockname()[0], Role)
    # Of a proxy's word about who asks, nothing is believed. An open page is no reason to stay when all else ends.
    config = uvicorn.Config(
        app, log_level="warning", proxy_headers=False, timeout_graceful_shutdown=1, lifespan="off", server_header=False
    )
    uvicorn.Server(config).run(sockets=listeners)


if __name__ == "__main__":
    serve(split_numbers(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
