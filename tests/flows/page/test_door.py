"""The door for programs: its schema, what it refuses, and an agent that drives it with the protocol's own client."""

import asyncio
from importlib.metadata import version

import pytest

from fast.flows.page.door import make_server
from fast.flows.page.proposals import list_open
from fast.flows.server.access import Api, Role, own_login
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from tests.flows.cli.cli_lakes import ROOT, proposed_lake
from tests.flows.page.lab_page import Browser
from tests.flows.page.served import serve

QUICK = (ROOT / "campaigns" / "quick.toml").read_text().replace('name = "quick"', 'name = "second"')


@pytest.fixture
def lake(tmp_path):
    return Lake.open(proposed_lake(tmp_path))


def test_the_interface_has_a_schema_and_says_where_a_campaign_stands(lake):
    browser = Browser(lake)
    schema = browser.client.get("/api/v1/openapi.json").json()
    assert set(schema["paths"]) >= {"/api/v1/campaigns/{campaign_id}", "/api/v1/sql", "/api/v1/proposals"}
    assert all(path.startswith("/api/v1/") for path in schema["paths"])
    state = browser.client.get("/api/v1/campaigns/quick").json()
    assert (state["grasps_done"], state["state"]) == (0, "interrupted")
    assert browser.client.get("/api/v1/campaigns/other").status_code == 404
    assert browser.client.post("/api/v1/sql", json={"sql": "DROP TABLE grasps"}).status_code == 400
    answer = browser.client.post("/api/v1/sql", json={"sql": "SELECT 15.979936175::DOUBLE AS force_n, NULL AS none"})
    assert answer.json()["rows"] == [[15.979936175, None]]


def test_what_is_refused_is_in_the_schema_as_the_key_and_the_token_are(lake):
    browser = Browser(lake)
    schema = browser.client.get("/api/v1/openapi.json").json()
    for routes in schema["paths"].values():
        for route in routes.values():
            assert {"400", "401", "403", "404", "409"} <= set(route["responses"])
            assert {"HTTPBasic": []} in route["security"]
    assert {"APIKeyHeader": []} in schema["paths"]["/api/v1/proposals"]["post"]["security"]
    refused = browser.client.get("/api/v1/campaigns/other")
    assert refused.json() == {"detail": "This lake has no campaign `other` that can be shown."}


def test_a_proposal_starts_nothing_and_is_decided_once_by_a_person(lake):
    browser, headers = Browser(lake, Role.SAY), {"X-Fast-Token": Browser(lake).token}
    proposal = {
        "kind": "search",
        "who": "agent <b>",
        "why": "errors grow with <i>slip</i>",
        "cost": "40 min of two cores",
    }
    assert browser.client.post("/api/v1/proposals", json=proposal).status_code == 403
    assert Browser(lake, Role.LOOK).client.post("/api/v1/proposals", json=proposal, headers=headers).status_code == 403
    for _ in range(2):
        answer = browser.client.post("/api/v1/proposals", json=proposal, headers=headers)
        assert answer.status_code == 200
    number = answer.json()["proposal_id"]
    assert list(list_open(lake)) == [number]
    text = browser.see("/todo")
    assert "errors grow with &lt;i&gt;slip" in text
    assert browser.say("/todo/proposal", {"proposal": number, "accept": "yes"})[0] == 403
    person = Browser(lake)
    status, words = person.say("/todo/proposal", {"proposal": number, "accept": "yes"})
    assert (status, "run `fast serve`" in words) == (409, True)  # no worker stands: it stays open
    assert list(list_open(lake)) == [number]
    assert person.say("/todo/proposal", {"proposal": number, "accept": "no"})[0] == 204
    status, words = person.say("/todo/proposal", {"proposal": number, "accept": "yes"})
    assert (status, "decided about this proposal already" in words) == (409, True)
    (row,) = lake.records(EventRow, kind="proposal_settled")
    assert row.message == "ada denied a proposal of agent <b>"


def test_a_config_with_faults_is_not_proposed(lake):
    wrong = QUICK.replace("initial_tools = 4 ", "initial_tools = -4 ")
    proposal = {"kind": "campaign", "who": "agent", "why": "more", "config": wrong}
    answer = Browser(lake).client.post(
        "/api/v1/proposals", json=proposal, headers={"X-Fast-Token": Browser(lake).token}
    )
    assert (answer.status_code, "initial_tools" in answer.json()["detail"]) == (400, True)
    assert list_open(lake) == {}


def test_an_agent_reads_asks_and_proposes(lake):
    pytest.importorskip("mcp")
    from mcp.client import Client

    async def drive(api):
        async with Client(make_server(api)) as client:
            assert client.server_info.version == version("fast-gripper-lab")
            names = {tool.name for tool in (await client.list_tools()).tools}
            state = await client.call_tool("read_campaign", {"campaign_id": "quick"})
            answer = await client.call_tool("ask_sql", {"sql": "SELECT count(*) AS n FROM proposals"})
            refused = [
                await client.call_tool(*call)
                for call in (
                    ("ask_sql", {"sql": "DELETE FROM proposals"}),
                    ("simulate_grasp", {"object_id": -1}),
                    ("read_campaign", {"campaign_id": "../me"}),
                )
            ]
            wanted = {"kind": "campaign", "who": "agent", "why": "a second seed", "config": QUICK, "cost": "2 min"}
            proposed = await client.call_tool("propose", wanted)
            return names, state, answer, refused, proposed

    async def ask_in_vain(api):
        async with Client(make_server(api)) as client:
            return await client.call_tool("list_campaigns", {})

    with serve(lake) as address:
        api = Api(f"{address.partition('/?')[0]}/api", own_login(lake.root))
        names, state, answer, refused, proposed = asyncio.run(drive(api))
    assert "is `fast serve` still running?" in asyncio.run(ask_in_vain(api)).content[0].text
    assert names == {
        "list_campaigns", "read_campaign", "list_tools", "ask_sql", "read_findings", "simulate_grasp",
        "list_todo", "propose",
    }  # fmt: skip
    assert "grasps_total" in state.content[0].text
    assert '"n_rows": 1' in answer.content[0].text
    assert all(answer.is_error for answer in refused)
    assert "the lake is read-only to SQL: use a SELECT statement" in refused[0].content[0].text
    assert "object_id: Input should be greater than or equal to 0" in refused[1].content[0].text
    assert "token" not in refused[2].content[0].text
    assert not proposed.is_error
    (proposal,) = list_open(lake).values()
    assert (proposal.who, proposal.kind) == ("agent", "campaign")
