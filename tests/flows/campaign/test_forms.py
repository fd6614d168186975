"""The form of a batch in the pages, against a server that answers as Prefect's does; without one no campaign fails."""

import shlex
from types import SimpleNamespace
from urllib.error import HTTPError

import pytest

from fast.flows.campaign.forms import close_forms, open_form
from fast.flows.campaign.notify import SILENT
from fast.flows.campaign.operator_prompts import Prompts
from fast.flows.progress import ProgressReporter
from fast.flows.server.access import Api
from fast.flows.server.server import address_for_others, ask_server
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.tasks.bench.mount import plan_rack
from fast.tasks.bench.print import PrintConfirmation, confirm_print, ensure_tray
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from tests.flows.campaign.made_up_search import search_made_up
from tests.flows.cli.cli_lakes import proposed_lake
from tests.flows.server.local_server import local_server


class Pages:
    """The part of Prefect's API that forms use."""

    def __init__(self, deployed=True):
        self.deployed = deployed
        self.runs = []

    def __call__(self, request):
        if request.path == "/api/deployments/name/print/print":
            return (200, {"id": "D"}) if self.deployed else (404, {})
        if request.path == "/api/deployments/D/create_flow_run":
            self.runs.append({"id": f"R{len(self.runs)}", "open": True, **request.body})
            return 201, self.runs[-1]
        if request.path == "/api/flow_runs/filter":
            wanted = set(request.body["flow_runs"]["tags"]["all_"])
            return 200, [run for run in self.runs if run["open"] and wanted <= set(run["tags"])]
        run = next(run for run in self.runs if request.path == f"/api/flow_runs/{run['id']}/set_state")
        run["open"], run["message"] = False, request.body["state"]["message"]
        return 201, {}


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    return Lake.open(proposed_lake(tmp_path_factory.mktemp("forms")))


@pytest.fixture
def pages(monkeypatch):
    found = Pages()
    with local_server(found) as (address, seen):
        monkeypatch.setenv("FAST_PREFECT_API_URL", f"{address}/api")
        monkeypatch.setenv("FAST_PREFECT_API_AUTH_STRING", "fast:open sesame")
        found.seen = seen
        yield found


def test_a_batch_has_one_form_until_it_is_closed(lake, pages):
    form = open_form(lake, "quick", 1)
    assert form.endswith("/runs/flow-run/R0")
    assert open_form(lake, "quick", 1) == form
    (run,) = pages.runs
    assert run["parameters"] == {
        "campaign": "quick", "batch": 1, "slots": [0, 1, 2, 3], "lake": address_for_others(lake)
    }  # fmt: skip
    assert run["name"] == "quick/B01: printed and mounted?"
    close_forms(lake, "quick", 1, "said by ada")
    assert run["message"] == "said by ada"
    assert open_form(lake, "quick", 1).endswith("R1")
    assert {request.headers["Authorization"] for request in pages.seen} == {"Basic ZmFzdDpvcGVuIHNlc2FtZQ=="}


def test_a_form_that_was_answered_is_not_followed_by_another(tmp_path, pages):
    """The answer is in the lake, the form has ended, and the campaign has not looked yet."""
    lake = Lake.open(proposed_lake(tmp_path))
    assert open_form(lake, "quick", 1).endswith("R0")
    ensure_tray(lake, "quick", 1)
    confirm_print(lake, "quick", 1, PrintConfirmation(operator="ada", again={2: "warped"}))
    pages.runs[0]["open"] = False
    assert open_form(lake, "quick", 1).endswith("R1")  # of the tool that is printed again
    assert pages.runs[1]["parameters"]["slots"] == [2]
    confirm_print(lake, "quick", 1, PrintConfirmation(operator="ada"))
    pages.runs[1]["open"] = False
    assert open_form(lake, "quick", 1) is None
    assert len(pages.runs) == 2


def test_without_deployment_or_server_there_is_no_form(lake, pages, monkeypatch):
    pages.deployed = False
    assert open_form(lake, "quick", 1) is None
    monkeypatch.setenv("FAST_PREFECT_API_URL", "http://127.0.0.1:9/api")
    assert open_form(lake, "quick", 1) is None
    close_forms(lake, "quick", 1, "nobody hears it")


def test_a_server_whose_database_is_busy_is_asked_again(monkeypatch):
    monkeypatch.setattr("fast.flows.server.server.time.sleep", lambda s: None)
    answers = [(503, {}), (503, {}), (200, "well"), *[(503, {})] * 5]
    with local_server(lambda request: answers.pop(0)) as (address, seen):
        assert ask_server(Api(address), "/x") == "well"
        with pytest.raises(HTTPError, match="503"):
            ask_server(Api(address), "/x")
    assert len(seen) == 8


def test_a_person_is_asked_and_reminded_and_forms_are_closed(tmp_path, pages, monkeypatch):
    home = tmp_path / "my lab"
    home.mkdir()
    lake = Lake.open(proposed_lake(home))
    campaign = Campaign(lake, load_config(home / "quick.toml"))
    said = []
    prompts = Prompts(campaign, ProgressReporter(said.append, said.append), SILENT)
    prompt = prompts.to_print(1, ensure_tray(lake, "quick", 1))
    prompt.ask()
    assert "fast print confirm quick/B01 --operator NAME" in said[0]
    command = next(line for line in said[0].splitlines() if "fast print confirm" in line)
    assert shlex.split(command)[-1] == lake.address
    assert "form at http://" in said[0]
    assert [row["kind"] for row in lake.rows(EventRow)][-1] == "print_waiting"
    prompt.remind()
    assert len(said) == 1
    later_s = 5 * 3600
    monkeypatch.setattr("fast.flows.campaign.operator_prompts.time.monotonic", lambda: prompt._asked_s + later_s)
    prompt.remind()
    prompt.remind()
    assert [line.partition(";")[0] for line in said[1:]] == ["FAST still needs you: batch quick/B01, for 5 h 0 min"]
    confirm_print(lake, "quick", 1, PrintConfirmation(operator="ada"))
    prompt.close()
    assert [run["open"] for run in pages.runs] == [False]


def test_a_campaign_says_which_kept_tool_goes_where(tmp_path):
    lake = Lake.open(proposed_lake(tmp_path))
    confirm_print(lake, "quick", 1, PrintConfirmation(operator="ada"))
    search_id = search_made_up(lake, SimpleNamespace(campaign_id="quick"), None).run.gap_id
    campaign = Campaign(lake, load_config(tmp_path / "quick.toml"))
    said = []
    prompts = Prompts(campaign, ProgressReporter(said.append, said.append), SILENT)
    prompts.to_mount(plan_rack(lake, campaign.state(), search_id)).ask()
    assert "mount these kept tools again, nothing is printed: B01T0 in slot 0, B01T1 in slot 1" in said[0]
    assert "fast print mounted quick --operator NAME" in said[0]
    assert lake.records(EventRow)[-1].kind == "mount_waiting"
