"""The lab's page for agents, as a server of the Model Context Protocol: it reads, and proposes what a person decides.

It is a client of the page's interface with a key that lets it say and not move: the gate is on the server.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import httpx

from fast.flows.server.access import Api, Role, role_login
from fast.models.errors import FastError

if TYPE_CHECKING:
    from mcp.server import MCPServer

_LIMIT_S = 120.0


def make_server(api: Api) -> "MCPServer":
    """Make a server with the tools of a lake's page, for an agent."""
    from mcp.server import MCPServer

    server = MCPServer("fast", version=version("fast-gripper-lab"))
    page = _Page(api)

    @server.tool()
    def list_campaigns() -> list[str]:
        """List campaigns of the lake, the newest first."""
        return page.get("campaigns")

    @server.tool()
    def read_campaign(campaign_id: str) -> dict[str, Any]:
        """Say where a campaign stands: state in a word, grasps measured, simulated, when a person is needed, best tool.

        Forces are in N.
        """
        return page.get(f"campaigns/{quote(campaign_id, safe='')}")

    @server.tool()
    def list_tools() -> list[dict[str, Any]]:
        """List measured tools, best first; `tool_quality_n`: mean peak pull-off force in N, `work_j`: work in J."""
        return page.get("tools")

    @server.tool()
    def ask_sql(sql: str) -> dict[str, Any]:
        """Answer one SELECT over the lake (DuckDB) with at most 500 rows. `FROM tool_quality` is a good start."""
        return page.post("sql", {"sql": sql})

    @server.tool()
    def read_findings() -> list[dict[str, Any]]:
        """Read what gap searches found: where simulation and measurement disagree, what is missing. Errors are in N."""
        return page.get("findings")

    @server.tool()
    def simulate_grasp(object_id: int, tool_id: str = "") -> dict[str, Any]:
        """Simulate one grasp of a tool on an object (0 to 35); without a tool, of the best published finger."""
        return page.post("simulate", {"tool_id": tool_id, "object_id": object_id})

    @server.tool()
    def list_todo() -> list[dict[str, Any]]:
        """List what people are asked for now."""
        return page.get("todo")

    @server.tool()
    def propose(
        kind: str, who: str, why: str, cost: str = "", config: str = "", campaign_id: str = ""
    ) -> dict[str, Any]:
        """Propose something that a person accepts or denies on the lab's page; nothing is started by this.

        kind: campaign (with its config in TOML), report (of a campaign), calibration or search. who: your name. cost:
        what it takes, with units.
        """
        proposal = {"kind": kind, "who": who, "why": why, "cost": cost, "config": config, "campaign_id": campaign_id}
        return page.post("proposals", proposal)

    return server


class _Page:
    """The page's interface, asked as an agent may."""

    def __init__(self, api: Api) -> None:
        user, _, key = role_login(api.login or "", Role.SAY).partition(":")
        self._address, self._login = f"{api.page}/api/v1/", (user, key)

    def get(self, path: str) -> Any:
        """Get what the page says."""
        with self._open() as client:
            return _read(client.get(path))

    def post(self, path: str, body: dict[str, Any]) -> Any:
        """Post a body and return what the page answers."""
        with self._open() as client:
            token = _read(client.get("me"))["token"]
            return _read(client.post(path, json=body, headers={"X-Fast-Token": token}))

    @contextmanager
    def _open(self) -> Iterator[httpx.Client]:
        """Open the page, whose refusals an agent reads: of another error it is told the tool's name alone."""
        from mcp.server.mcpserver.exceptions import ToolError

        try:
            with httpx.Client(base_url=self._address, auth=self._login, timeout=_LIMIT_S, trust_env=False) as client:
                yield client
        except FastError as error:
            raise ToolError(str(error)) from error
        except httpx.TransportError as error:
            raise ToolError(f"The lab's page does not answer ({error}); is `fast serve` still running?") from error


def _describe(fault: dict[str, Any]) -> str:
    """Describe a fault of the schema's check: where and what."""
    return f"{'.'.join(str(part) for part in fault['loc'][1:])}: {fault['msg']}"


def _read(response: httpx.Response) -> Any:
    """Read an answer as data.

    Raises:
        FastError: the page refused, in its sentence.
    """
    if response.is_error:
        is_json = response.headers.get("content-type", "").startswith("application/json")
        detail = response.json()["detail"] if is_json else response.text
        raise FastError(detail if isinstance(detail, str) else "; ".join(_describe(fault) for fault in detail))
    return response.json()
