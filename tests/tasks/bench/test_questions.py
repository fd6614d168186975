"""What a bench asks a person: it waits, is answered once, and neither a kill nor a restart loses question or answer."""

import threading
from contextlib import contextmanager, nullcontext
from types import SimpleNamespace

import pytest

from fast.flows.campaign.operator_prompts import Prompts
from fast.flows.cli.campaign import open_lake
from fast.flows.progress import ProgressReporter
from fast.hardware.bench import open_virtual_bench
from fast.hardware.parts.safe_state import StopAskedError
from fast.hardware.questions import AskedField, BenchQuestion
from fast.hardware.tools.changer import IS_IT
from fast.hardware.virtual.world.file import World
from fast.lake.tables.campaign import EventRow, GraspRow
from fast.models.errors import InterlockError, UsageError
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.bench.questions import answer_question, list_open_questions, make_ask
from fast.tasks.scientist.propose import propose_initial
from tests.hardware.safety.scenario_bench import physics
from tests.studies.benchmarks.made_up_batch import measure_missing, rack_of
from tests.waiting import wait_for

QUESTION = BenchQuestion(
    key="pads", sentence="The pads are worn.", choices=("new pads", "go on"),
    fields=(AskedField(name="mass_g", label="mass, g"), AskedField(name="lot", label="lot", kind="text")),
)  # fmt: skip


class Killed(BaseException):
    """The process died here."""


def die():
    raise Killed


def answer(campaign, choice="new pads", **values):
    (asked,) = list_open_questions(campaign.lake, "small")
    return answer_question(campaign.lake, "small", asked.question_id, choice, values, "ada")


def test_a_question_and_its_answer_outlive_the_process_that_asked(campaign):
    lake = campaign.lake
    with pytest.raises(Killed):
        make_ask(lake, "small", die)(QUESTION)
    assert [one.question for one in list_open_questions(lake, "small")] == [QUESTION]
    for choice, values, words in (
        ("old pads", {}, "`old pads` is no choice; there are new pads, go on"),
        ("new pads", {}, "mass, g is not filled in"),
        ("new pads", {"mass_g": "much", "lot": "a"}, "`much` is not a number"),
    ):
        with pytest.raises(UsageError, match=words):
            answer(campaign, choice, **values)
    assert answer(campaign, mass_g="2,5", lot="L7") == "The bench is told: new pads."
    said = make_ask(lake, "small", die)(QUESTION)  # started again: the answer that came meanwhile
    assert (said.choice, said.values, said.operator) == ("new pads", {"mass_g": 2.5, "lot": "L7"}, "ada")
    with pytest.raises(StopAskedError):  # the same is asked anew another time; a stop does not wait for the answer
        make_ask(lake, "small", lambda: True)(QUESTION)
    assert len(list_open_questions(lake, "small")) == 1
    first = lake.records(EventRow, kind="bench_answered")[0].payload["question_id"]
    with pytest.raises(UsageError, match="answered already"):
        answer_question(lake, "small", first, "go on", {}, "grace")


def test_people_hear_of_a_question_until_it_is_answered(campaign):
    """In the terminal and by message: one that only the page showed kept a bench waiting for a night."""
    said, sent = [], []
    teller = SimpleNamespace(send=lambda *words: sent.append(words))
    prompts = Prompts(campaign, ProgressReporter(said.append, said.append), teller)
    for _ in range(2):  # the second process finds the question open
        with pytest.raises(Killed):
            make_ask(campaign.lake, "small", die, prompts.call_person)(QUESTION)
    assert len(said) == len(sent) == 2
    assert said[0].startswith(
        "A person is needed: The pads are worn.\nAnswer on the lab's page, or 'new pads' or 'go on'"
    )
    assert "fast campaign answer small CHOICE --operator NAME --lake" in said[0]
    assert sent[0][:2] == ("needs_you", "FAST needs you: the bench of small asks")
    answer(campaign, mass_g="2,5", lot="L7")
    make_ask(campaign.lake, "small", die, prompts.call_person)(QUESTION)
    assert len(said) == 2


@pytest.mark.parametrize("choice", [IS_IT, "stop here"])
def test_a_campaign_goes_on_with_a_heavy_tool_if_a_person_says_so(campaign, choice):
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada"))

    @contextmanager
    def open_heavy(mounted):
        with open_virtual_bench(World(seed=7), rack_of(mounted), physics, wires="memory") as bench:
            bench.virtual.inject("tool_heavy")
            yield bench

    def say():
        lake = open_lake(campaign.lake.root)
        for _ in campaign.state().tools_of(1):
            wait_for(lambda: list_open_questions(lake, "small"), 60.0)
            answer(campaign, choice)
            if choice != IS_IT:
                return

    person = threading.Thread(target=say)
    person.start()
    refused = pytest.raises(InterlockError, match="put it back with `fast gantry park --real BENCH.toml`")
    with nullcontext() if choice == IS_IT else refused:
        measure_missing(campaign, World(seed=7), lambda *_: None, open_bench=open_heavy)
    person.join()
    made = [row["status"] for row in campaign.lake.rows(GraspRow)]
    assert made == (["ok"] * 8 if choice == IS_IT else [])
