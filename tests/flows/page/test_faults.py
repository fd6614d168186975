"""A fault as a choice: what stopped the campaign stands on every tab with the ways on, and each of them is gone."""

from contextlib import contextmanager

import pytest

from fast.flows.campaign.status import read_campaign
from fast.flows.page import start
from fast.flows.server.access import Role
from fast.hardware.bench import open_virtual_bench
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, GraspRow
from fast.models.errors import FastError, UsageError
from fast.models.objects.catalogue import name_object
from fast.tasks.bench.plan import plan_tool
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.bench.ways_on import choose_way
from fast.tasks.campaign.flow_runs import record_run
from fast.tasks.campaign.left_out import Part
from fast.tasks.campaign.requests import STARTED, append_event
from tests.flows.cli.cli_lakes import Fast, proposed_lake
from tests.flows.page.lab_page import Browser
from tests.flows.page.served import CHROMIUM, find_barriers, open_browser, say_name, serve
from tests.hardware.safety.scenario_bench import WORLD, is_pulling, physics, when
from tests.studies.benchmarks.made_up_batch import measure_missing, rack_of


@pytest.fixture
def stopped(tmp_path):
    """A campaign whose first batch was stopped by a limit switch in its first lift."""
    lake = Lake.open(proposed_lake(tmp_path))
    confirm_print(lake, "quick", 1, PrintConfirmation(operator="ada"))
    config = str(tmp_path / "quick.toml")
    append_event(lake, "quick", STARTED, "started", run="r1", config=config, auto_print=False, real=False)

    def prepare(bench):
        when(bench, is_pulling, lambda: bench.virtual.inject("hard_limit"))

    def work():
        measure(lake, prepare)
        return True

    with pytest.raises(FastError):
        record_run(lake, "campaign", "quick", "f1", work, current_provenance())
    return lake


def measure(lake, prepare=lambda bench: None):
    """The same command again."""

    @contextmanager
    def open_bench(mounted):
        with open_virtual_bench(WORLD, rack_of(mounted), physics, wires="memory") as bench:
            prepare(bench)
            yield bench

    measure_missing(read_campaign(lake, "quick"), WORLD, lambda *_: None, open_bench=open_bench)


def count_owed(lake):
    campaign = read_campaign(lake, "quick")
    state = campaign.state()
    return {tool.slot: len(plan_tool(campaign, state, tool).items) for tool in state.tools_of(1)}


def test_a_fault_is_a_choice_on_every_tab_and_in_the_terminal(stopped, monkeypatch, capsys):
    lake, browser, begun = stopped, Browser(stopped), []
    cut = next(row for row in lake.rows(GraspRow) if row["status"] != "ok")
    name = name_object(cut["object_id"])
    for path in ("/", "/todo", "/results", "/gap", "/start"):
        text = browser.see(path)
        assert "hard limit was hit" in text
        assert f"Leave {name} out" in text
        assert f"no tool goes to {name} until somebody puts it back" in text
    said = Fast(capsys)("campaign", "status", "--lake", lake.root).out
    command = f"fast campaign leave-out quick --object {cut['object_id']} --lake {lake.root}"
    assert f"{command}: The bench homes and goes on" in said
    form = {"campaign": "quick", "run": "r1", "way": "object", "reason": "mount broke"}
    status, words = browser.say("/start/way", form)
    assert (status, "No worker is running, so nothing was started" in words) == (409, True)
    assert lake.rows(EventRow, kind="left_out") == []
    monkeypatch.setattr(start, "require_worker", lambda _: None)
    monkeypatch.setattr(start, "start_on_worker", lambda *words, key: begun.append(key))
    status, words = Browser(lake, role=Role.SAY).say("/start/way", form)
    assert (status, begun) == (403, [])
    status, words = browser.say("/start/way", form)
    assert (status, "goes on within a minute" in words, begun) == (204, True, ["page-continues-r1"])
    assert count_owed(lake) == dict.fromkeys(range(4), 6)
    status, words = browser.say("/start/way", form)  # pressed twice: the same once
    assert (status, "has the way on `object`" in words or "no fault with the way on" in words) == (409, True)
    measure(lake)
    made = {row["object_id"] for row in lake.rows(GraspRow) if row["status"] == "ok"}
    assert len(made) == 3
    assert cut["object_id"] not in made


@pytest.mark.parametrize(
    ("way", "left"),
    [("again", {0: 8, 1: 8, 2: 8, 3: 8}), ("grasp", {0: 7, 1: 8, 2: 8, 3: 8}), ("tool", {0: 0, 1: 8, 2: 8, 3: 8}),
     ("batch", {0: 0, 1: 0, 2: 0, 3: 0})],
)  # fmt: skip
def test_each_way_on_changes_the_plan_as_it_says(stopped, way, left):
    campaign = read_campaign(stopped, "quick")
    with pytest.raises(UsageError, match="no fault with the way on `sideways`"):
        choose_way(campaign, "sideways", "", "ada")
    choose_way(campaign, way, "", "ada")
    assert count_owed(stopped) == left
    words = stopped.records(EventRow, kind="left_out")
    assert [row.payload["operator"] for row in words] == ([] if way == "again" else ["ada"])
    assert all("hard limit was hit" in row.payload["reason"] for row in words)  # as the fault says


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM.exists(), reason="no chromium: apt-get install chromium")
@pytest.mark.parametrize(("width", "scheme"), [(1200, "light"), (390, "dark")])
def test_everybody_can_read_a_fault_and_choose(stopped, width, scheme):
    pytest.importorskip("playwright")
    with serve(stopped) as address, open_browser(address, width, scheme) as page:
        say_name(page, "Ada")
        for tab in ("Now", "To do", "Results", "Gap", "Start"):
            page.click(f"nav a:has-text('{tab}')")
            page.wait_for_selector(".fault button:has-text('Make the grasp again')")
            assert find_barriers(page) == []
        box = page.locator(".strip .fault")
        assert box.evaluate("box => box.scrollHeight <= box.clientHeight"), "no way is hidden below an edge"


def test_a_place_and_a_slot_are_left_out_on_the_map_and_put_back(stopped):
    browser = Browser(stopped)
    part = Part(batch=1, object_id=14).model_dump_json()
    form = {"campaign": "quick", "part": part, "reason": "mount broke"}
    assert browser.say("/orders/leave-out", {**form, "part": "14"})[0] == 409
    status, words = browser.say("/orders/leave-out", form)
    assert (status, "tube (14) is left out" in words) == (204, True)
    text = browser.see("/")
    assert '<g class="place skipped" data-object="14">' in text
    assert "is left out by ada: mount broke" in text
    status, words = browser.say("/orders/leave-out", {**form, "back": "yes"})
    assert (status, "tube (14) is put back" in words) == (204, True)
    assert '<g class="place left" data-object="14">' in browser.see("/")


def test_the_terminal_leaves_out_what_the_page_does(stopped, capsys):
    fast, lake = Fast(capsys), stopped.root
    who = ("--operator", "grace", "--lake", lake)
    assert "say what is left out" in fast.refused("campaign", "leave-out", "quick", "--reason", "x", *who)
    answer = fast("campaign", "leave-out", "quick", "--tool", "B01T2", "--reason", "tip torn", *who)
    assert answer.out.startswith("B01T2 is left out: no grasp is begun with it any more")
    answer = fast("campaign", "leave-out", "--object", "tube", "--reason", "mount broke", *who, "--json")
    assert answer.json == {"campaign": "quick", "part": "tube (14)", "is_out": True}
    assert count_owed(stopped) == {0: 6, 1: 6, 2: 0, 3: 6}
    assert "is left out by grace: tip torn" in Browser(stopped).see("/")
    assert fast("campaign", "leave-out", "--object", "14", "--back", *who).status == 0
    assert count_owed(stopped) == {0: 8, 1: 8, 2: 0, 3: 8}
