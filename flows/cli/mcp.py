"""`fast mcp`: the lab's page for agents."""

from fast.flows.cli.common import DEFAULT_LAKE, LakePath
from fast.flows.dependencies import require
from fast.models.errors import FastError


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
