"""Forms of a gap search in the pages: what they ask for, what they refuse, and what an answer becomes in the lake."""

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import ValidationError

from fast.flows.campaign import gap_forms
from fast.flows.campaign.gap_forms import (
    make_mount_form,
    make_reading_form,
    mount_tools,
    read_mount_answer,
    read_number,
)
from fast.flows.campaign.notify import SILENT
from fast.flows.campaign.operator_prompts import Prompts
from fast.flows.campaign.operator_prompts import make_mount_form as make_mount_step
from fast.flows.campaign.operator_prompts import make_reading_form as make_reading_step
from fast.flows.progress import ProgressReporter
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.errors import ConfigError, UsageError
from fast.models.gap.ask.answers import Reading
from fast.tasks.bench.asked import MOUNTED, Mounting, confirm_mounting, read_mounting
from fast.tasks.bench.mount import plan_rack
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.gap.readings import KIND, read_readings, write_reading
from tests.flows.campaign.made_up_search import ask_person, search_made_up
from tests.flows.cli.cli_lakes import proposed_lake

SLOTS = {"quick/B01T0": 0, "quick/B01T1": 4}
Suspend = Callable[..., list[Any]]


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    found = Lake.open(proposed_lake(tmp_path))
    confirm_print(found, "quick", 1, PrintConfirmation(operator="ada"))
    return found


@pytest.fixture
def suspend(monkeypatch: pytest.MonkeyPatch) -> Suspend:
    """Have people answer these, one after the other, instead of a run that suspends; returns the forms they got."""

    def script(*answers: dict[str, Any]) -> list[Any]:
        forms: list[Any] = []
        given: Iterator[dict[str, Any]] = iter(answers)

        def answer(wait_for_input: Any, timeout: float, key: str) -> Any:
            forms.append(wait_for_input)
            assert key == f"answer-{len(forms)}"  # by which Prefect gives an answer again after a restart
            return wait_for_input(**next(given))

        monkeypatch.setattr(gap_forms, "suspend_flow_run", answer)
        return forms

    return script


def describe(form: Any) -> str:
    """What stands above the first field."""
    return str(form.model_json_schema()["properties"]["operator"]["description"])


def test_the_form_of_kept_tools_needs_the_name_alone() -> None:
    form = make_mount_form(SLOTS, "")
    found = form.model_json_schema()
    assert found["required"] == ["operator"]
    assert found["properties"]["B01T1"]["title"] == "B01T1 in rack slot 4"
    assert found["properties"]["B01T1"]["enum"] == ["mounted", "gone"]
    for bad in ({}, {"operator": ""}, {"operator": "ada", "B01T0": "lost"}):
        with pytest.raises(ValidationError):
            form(**bad)
    word = read_mount_answer(form(operator=" ada ", B01T0="gone"), "A0", SLOTS)
    assert word == Mounting(search_id="A0", slots={"quick/B01T1": 4}, gone=("quick/B01T0",), operator="ada")
    with pytest.raises(ConfigError, match="the form: `operator` is '', it must be a text that is not empty"):
        read_mount_answer(form(operator="  "), "A0", SLOTS)


def test_the_form_of_a_number_says_what_to_measure_and_in_which_unit() -> None:
    form = make_reading_form("walls", "")
    found = form.model_json_schema()
    assert found["required"] == ["operator", "value"]
    assert found["properties"]["value"]["title"] == "Walls, more than drawn, mm"
    assert describe(form).startswith("Measure both walls and the ribs of three fingers with callipers")
    with pytest.raises(ValidationError):
        form(operator="ada", value="0.12mm")
    with pytest.raises(UsageError, match="nobody asks for a `weather`"):
        make_reading_form("weather", "")


def test_kept_tools_are_asked_for_until_the_answer_can_be_used(lake: Lake, suspend: Suspend) -> None:
    search_id = search_made_up(lake, SimpleNamespace(campaign_id="quick"), None).run.gap_id  # type: ignore[arg-type]
    forms = suspend({"operator": " "}, {"operator": "ada", "B01T1": "gone"})
    done = mount_tools.fn("quick", search_id, str(lake.root))
    assert len(forms) == 2
    assert "could not be used: the form: `operator` is ''" in describe(forms[1])
    found = Lake.open(lake.root)
    word = Mounting(search_id=search_id, slots={"quick/B01T0": 0}, gone=("quick/B01T1",), operator="ada")
    assert read_mounting(found, search_id) == word
    assert done.message == "1 kept tool mounted, 1 gone."
    again = mount_tools.fn("quick", search_id, str(lake.root))  # a restart of the run
    assert again.message == "the tools were confirmed elsewhere meanwhile."
    assert len(found.records(EventRow, kind=MOUNTED)) == 1


def test_a_number_is_asked_for_until_it_can_be(lake: Lake, suspend: Suspend) -> None:
    ask_person(lake, "quick")
    bad = [{"value": 120.0}, {"value": float("nan")}, {"operator": " ", "value": 0.1}]
    forms = suspend(*({"operator": "ada"} | answer for answer in (*bad, {"value": 0.12})))
    done = read_number.fn("quick", "P0", "walls", str(lake.root))
    complaints = [describe(form).partition("** Correct it")[0] for form in forms[1:]]
    assert [complaint.rpartition("used: ")[2] for complaint in complaints] == [
        "1 number cannot be, nothing was written: walls: 120 mm, usual is 0.05 or so, um? It would be 0.12 mm (it is "
        "-1 to 1 mm). Measure again.",
        "the form: `value` is nan, it must be a finite number; change it.",
        "nobody said who measured it; give a name.",
    ]
    found = Lake.open(lake.root)
    assert read_readings(found, "quick") == (Reading(kind="walls", value=0.12),)
    assert done.message == "walls: 0.12."
    assert read_number.fn("quick", "P0", "walls", str(lake.root)).message == "it was measured elsewhere meanwhile."
    assert len(found.records(EventRow, kind=KIND)) == 1


def test_what_is_answered_is_not_asked_again(lake: Lake) -> None:
    search_id = search_made_up(lake, SimpleNamespace(campaign_id="quick"), None).run.gap_id  # type: ignore[arg-type]
    mount = make_mount_step(lake, "quick", search_id)
    assert mount.find_open() == {"campaign": "quick", "search": search_id}
    confirm_mounting(lake, "quick", Mounting(search_id=search_id, slots={}, operator="ada"))
    assert mount.find_open() is None
    question = ask_person(lake, "quick").findings.next_experiment
    assert question is not None
    assert question.person is not None
    reading = make_reading_step(lake, "quick", "P0", question.person)
    assert reading.find_open() == {"campaign": "quick", "search": "P0", "kind": "walls"}
    write_reading(lake, "quick", "P0", Reading(kind="walls", value=0.1), "ada")
    assert reading.find_open() is None


def test_a_campaign_says_which_kept_tool_goes_where(lake: Lake, tmp_path: Path) -> None:
    search_id = search_made_up(lake, SimpleNamespace(campaign_id="quick"), None).run.gap_id  # type: ignore[arg-type]
    campaign = Campaign(lake, load_config(tmp_path / "quick.toml"))
    said: list[str] = []
    prompts = Prompts(campaign, ProgressReporter(said.append, said.append), SILENT)
    prompts.to_mount(search_id, plan_rack(lake, campaign.state(), search_id)).ask()
    assert "mount these kept tools again, nothing is printed: B01T0 in slot 0, B01T1 in slot 1" in said[0]
    assert "fast print mounted quick --operator NAME" in said[0]
    assert lake.records(EventRow)[-1].kind == "mount_waiting"
