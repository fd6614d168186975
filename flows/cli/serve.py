"""`fast serve`: the page of a lab, Prefect's server with a worker, the deployments. `fast mcp`: the page for agents."""

import ipaddress
import json as json_module
import os
import socket
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, say, say_progress
from fast.flows.cli.virtual import watch_signals
from fast.flows.dependencies import require
from fast.models.errors import FastError, UsageError

if TYPE_CHECKING:
    from fast.flows.server.lab import Lab

TEND_S = 1.0


def serve(
    *,
    lake: LakePath = DEFAULT_LAKE,
    port: Annotated[int, Parameter(help="Port of the server.", validator=Number(gte=1, lte=65535))] = 4200,
    page_port: Annotated[
        int | None, Parameter(help="Port of the lab's page; default: 4210.", validator=Number(gte=1, lte=65535))
    ] = None,
    host: Annotated[
        str, Parameter(help="Address to listen on; one that others reach needs a password in FAST_PASSWORD.")
    ] = "127.0.0.1",
    runs: Annotated[int, Parameter(help="Flow runs that the worker does at once.", validator=Number(gte=1))] = 4,
    json: AsJson = False,
) -> None:
    """Serve the lab's page of this lake, with Prefect's server, a worker and the deployments, until Ctrl-C.

    Campaigns on the same lake show there and can be started there. The printed address lets a browser in; nobody else
    gets in, neither pages of other sites nor other users of the computer. A server that FAST_PREFECT_API_URL names is
    used instead of one of its own. FAST_PASSWORD is a password in place of the key in the address (user `fast`).
    """
    from fast.flows.server.access import addresses_for_person
    from fast.flows.server.environment import named_server
    from fast.flows.server.lab import LabPlan, open_lab, refuse_second
    from fast.flows.server.server import report_ignored
    from fast.flows.server.surroundings import check_surroundings
    from fast.lake.store import Lake

    require(["prefect"])
    named = named_server()
    if named is None:
        if Lake.exists(lake):
            refuse_second(Lake.open(lake).root)
        _check_server_wanted(host, port)
    check_surroundings()
    found = Lake.open(lake, create=True)
    if (sentence := report_ignored()) and named is None:
        say_progress(sentence)
    if page_port is not None:
        _check_server_wanted(host, page_port, "--page-port")
    with open_lab(found, LabPlan(port, host, runs, page_port)) as lab:
        asked = watch_signals()  # a server that is still starting is ended by the default
        pages, flows = (addresses_for_person(api, host) for api in (lab.page, lab.api))
        say_text: Callable[[str], None] = say_progress if json else say
        say_text(f"the lab's page of {found.address}: {' or '.join(pages)}")
        say_text(f"flows, in Prefect: {' or '.join(flows)}")
        deployments = lab.deploy()
        if json:
            data = {
                "page": pages[0],
                "url": flows[0],
                "api_url": lab.api.url,
                "lake": found.address,
                "deployments": deployments,
            }
            say(json_module.dumps(data))
        say_text(f"worker ready; can be started from the pages: {', '.join(deployments)}")
        say_text("Ctrl-C stops server and worker, and what the worker does; campaigns in other terminals go on.")
        _tend(lab, asked)


def _tend(lab: "Lab", asked: threading.Event) -> None:
    while not asked.wait(TEND_S):
        lab.tend(say_progress)
    if lab.find_runs():
        say_progress("what the worker does is brought to an end: a campaign pauses after the grasp in hand")


def _check_server_wanted(host: str, port: int, option: str = "--port") -> None:
    """Raise UsageError when the port is taken, or others would reach a server without password."""
    from fast.flows.server.access import PASSWORD_VARIABLE

    if not _is_loopback(host) and not os.environ.get(PASSWORD_VARIABLE):
        raise UsageError(f"--host {host} is reached by others; set a password in {PASSWORD_VARIABLE}, then try again.")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port left a moment ago is free
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UsageError(
                f"{option} {port} cannot be used on {host} ({error.strerror}); give another one."
            ) from error


def _is_loopback(host: str) -> bool:
    """Return whether an address is loopback; raise UsageError for what is no IPv4 address."""
    try:
        return ipaddress.IPv4Address(host).is_loopback
    except ValueError as error:
        raise UsageError(f"--host {host} is no IPv4 address; give one of this machine, e.g. 127.0.0.1.") from error


def mcp(*, lake: LakePath = DEFAULT_LAKE) -> None:
    """Offer the lab's page to an agent over standard input and output (Model Context Protocol).

    It reads the state, the data and the findings, simulates, and proposes what a person accepts or denies on the page.
    A page of the lake must stand (`fast serve`).
    """
    from fast.lake.storage.open import storage_at

    require(["mcp"])
    from fast.flows.page.door import make_server
    from fast.flows.server.page_port import find_page

    api = find_page(storage_at(lake).root)
    if api is None:
        raise FastError(f"no page of {lake} stands; start one with `fast serve`, then try again.")
    make_server(api).run("stdio")
