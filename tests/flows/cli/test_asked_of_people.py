"""What a search asks of people, answered on the command line: kept tools mounted again, and a number."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.gap.ask.answers import Reading
from fast.models.records import GraspRequest
from fast.tasks.bench.asked import MOUNTED, Mounting, read_mounting, write_requests
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.gap.readings import KIND, name_unasked, read_readings, write_reading
from tests.flows.campaign.made_up_search import FAST, ask_person, search_made_up
from tests.flows.cli.cli_lakes import Fast, everything_in, proposed_lake


@pytest.fixture
def fast(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Fast:
    monkeypatch.delenv("FAST_LAKE", raising=False)
    return Fast(capsys)


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    """The campaign `quick`, whose first tools are printed: B01T3 was rejected."""
    found = Lake.open(proposed_lake(tmp_path))
    confirm_print(found, "quick", 1, PrintConfirmation(operator="ada", rejected={3: "tip torn"}))
    return found


def search(lake: Lake) -> str:
    """A search that asks for grasps of B01T0 and B01T1."""
    return search_made_up(lake, SimpleNamespace(campaign_id="quick"), None).run.gap_id  # type: ignore[arg-type]


def refuse(fast: Fast, lake: Lake, *words: object) -> str:
    """What a wrong use gets; it writes nothing."""
    before = everything_in(lake.root)
    said = fast.refused(*words, "--lake", lake.root)
    assert everything_in(lake.root) == before
    return said


def test_kept_tools_are_mounted_and_one_is_gone(fast: Fast, lake: Lake) -> None:
    search_id = search(lake)
    answer = fast(
        "print", "mounted", "quick", "--operator", "ada", "--gone", "B01T1", "--lake", lake.root, "--json"
    )  # fmt: skip
    assert answer.status == 0, answer.err
    assert answer.json == {"search": search_id, "mounted": {"quick/B01T0": 0}, "gone": ["quick/B01T1"]}
    found = Lake.open(lake.root)
    assert read_mounting(found, search_id) == Mounting(
        search_id=search_id, slots={"quick/B01T0": 0}, gone=("quick/B01T1",), operator="ada"
    )
    said = refuse(fast, found, "print", "mounted", "quick", "--operator", "bob")
    assert said == f"fast: the tools of search {search_id} are mounted already; nothing was changed."
    assert len(found.records(EventRow, kind=MOUNTED)) == 1


def test_where_all_tools_are_gone_no_grasp_is_promised(fast: Fast, lake: Lake) -> None:
    search(lake)
    gone = ["--gone", "B01T0", "--gone", "quick/B01T1"]
    answer = fast("print", "mounted", "quick", "--operator", "ada", *gone, "--lake", lake.root)
    assert answer.out == "0 kept tools mounted, 2 gone; the campaign goes on without these grasps.\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["quick", "--operator", "ada", "--gone", "B01T9"], "quick/B01T9 is not one of the tools that are asked for"),
        (["quick", "--operator", "ada", "--gone", "other/B01T0"], "other/B01T0 is not one of the tools"),
        (["quick", "--operator", "ada", "--gone", ""], "is not one of the tools that are asked for (quick/B01T0, "),
        (["quack", "--operator", "ada"], "campaign `quack` is not in this lake; did you mean `quick`?"),
        (["quick", "--operator", " "], "kept tools: `operator` is '', it must be a text that is not empty"),
        (["quick"], "`fast print mounted` needs --operator: Who mounted them."),
    ],
)
def test_a_wrong_word_on_kept_tools_is_refused(fast: Fast, lake: Lake, words: list[str], said: str) -> None:
    search_id = search(lake)
    assert said in refuse(fast, lake, "print", "mounted", *words)
    assert read_mounting(Lake.open(lake.root), search_id) is None


def test_where_no_search_waits_nothing_is_mounted(fast: Fast, lake: Lake) -> None:
    nobody = "fast: no search of campaign quick waits for kept tools; nothing was changed."
    assert refuse(fast, lake, "print", "mounted", "quick", "--operator", "ada") == nobody
    ask_person(lake, "quick")
    assert refuse(fast, lake, "print", "mounted", "quick", "--operator", "ada") == nobody


def test_a_tool_that_was_never_mounted_cannot_be_kept(fast: Fast, lake: Lake) -> None:
    search_id = search(lake)
    torn = GraspRequest(tool_id="quick/B01T3", object_id=3, setup=FAST)
    write_requests(lake, search_id, [torn], "quick", current_provenance())
    said = refuse(fast, lake, "print", "mounted", "quick", "--operator", "ada")
    assert f"search {search_id} asks for grasps of quick/B01T3, which this campaign never printed" in said


def answer_words(*words: str) -> list[str]:
    return ["gap", "answer", *words, "--operator", "ada", "--campaign", "quick"]


def test_a_number_is_kept_and_a_second_one_replaces_it(fast: Fast, lake: Lake) -> None:
    ask_person(lake, "quick")
    for number in (0.14, -0.12):
        answer = fast(*answer_words("walls", str(number)), "--lake", lake.root)
        assert answer.out == f"walls {number:g} is kept; `fast gap` goes on with it.\n", answer.err
    found = Lake.open(lake.root)
    assert read_readings(found, "quick") == (Reading(kind="walls", value=-0.12),)
    (row,) = found.records(EventRow, kind=KIND)
    assert json.loads(row.payload_json)["operator"] == "ada"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["walls", "nan"], "the answer: `value` is nan, it must be a finite number; change it."),
        (["walls", "inf"], "the answer: `value` is inf, it must be a finite number"),
        (["walls", "120"], "walls: 120 mm, usual is 0.05 or so, um? It would be 0.12 mm (it is -1 to 1 mm)."),
        (["walls", "0.12mm"], 'unable to convert "0.12mm" into a number'),
        (["walls"], "give a number, or --undo and no number; nothing was changed."),
        (["weight", "0.1"], "`weight` says nothing of any effect, it must be one of "),
        (["walls", "0.1", "--operator", " "], "nobody said who measured it; give a name."),
        (["walls", "0.1", "--campaign", "quack"], "campaign `quack` is not in this lake; did you mean `quick`?"),
    ],
)
def test_a_number_that_cannot_be_is_refused(fast: Fast, lake: Lake, words: list[str], said: str) -> None:
    ask_person(lake, "quick")
    given = ["gap", "answer", *words]
    given += [] if "--operator" in words else ["--operator", "ada"]
    given += [] if "--campaign" in words else ["--campaign", "quick"]
    assert said in refuse(fast, lake, *given)
    assert read_readings(Lake.open(lake.root), "quick") == ()


def test_a_number_that_no_search_asked_for_is_kept_too(fast: Fast, lake: Lake) -> None:
    kept = "dead_weight 0.1 is kept; `fast gap` goes on with it. No search asked for it.\n"
    assert fast(*answer_words("dead_weight", "0.1"), "--lake", lake.root).out == kept
    assert read_readings(Lake.open(lake.root), "quick") == (Reading(kind="dead_weight", value=0.1),)
    assert fast(*answer_words("dead_weight"), "--undo", "--lake", lake.root).status == 0
    assert read_readings(Lake.open(lake.root), "quick") == ()
    for campaign, number in (("one", 0.1), ("two", 0.2)):  # neither takes the place of the other
        write_reading(lake, campaign, name_unasked(campaign), Reading(kind="dead_weight", value=number), "ada")
    assert read_readings(lake, "one") == (Reading(kind="dead_weight", value=0.1),)
    assert "no search `P9` has ended in this lake; leave out --search" in refuse(
        fast, lake, "gap", "next", "--search", "P9"
    )
    search(lake)  # it asks the bench
    assert "No search asked for it." in fast(*answer_words("dead_weight", "0.1"), "--lake", lake.root).out
    ask_person(lake, None)  # of the whole lake, not of this campaign
    assert "it is search P0 that asks for `walls`: leave out --campaign" in refuse(
        fast, lake, *answer_words("walls", "0.1")
    )
    assert fast("gap", "answer", "walls", "0.1", "--operator", "ada", "--lake", lake.root).status == 0
    assert Reading(kind="walls", value=0.1) in read_readings(Lake.open(lake.root), None)


def test_what_a_campaign_asks_of_a_person_is_found_without_its_name(fast: Fast, lake: Lake) -> None:
    ask_person(lake, "quick")
    said = refuse(fast, lake, "gap", "answer", "walls", "0.1", "--operator", "ada")
    assert "it is search P0 that asks for `walls`: add --campaign quick; nothing was changed." in said
    assert fast("gap", "next", "--lake", lake.root).out == "Please measure the walls.\n"
    assert fast(*answer_words("walls", "0.1"), "--lake", lake.root).status == 0
    assert fast("gap", "next", "--lake", lake.root).out.startswith("No grasp is asked for")


def test_a_confirmation_on_the_command_line_ends_the_form(
    fast: Fast, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[tuple[Any, ...]] = []
    monkeypatch.setattr("fast.flows.campaign.forms.close_forms", lambda lake, *which: closed.append(which))
    assert fast("print", "confirm", "B01", "--operator", "ada", "--lake", proposed_lake(tmp_path)).status == 0
    assert closed == [("quick", 1, "said by ada on the command line")]
