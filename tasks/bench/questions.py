"""Questions of a bench to a person: events of the lake, which outlive the process that asked.

A process that is started again and asks the same finds the question open, or the answer that came meanwhile.
"""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fast.hardware.parts.safe_state import StopAskedError, Verb
from fast.hardware.questions import Ask, BenchAnswer, BenchQuestion
from fast.lake.order import OLDEST_FIRST
from fast.lake.query.engine import Mark
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.errors import UsageError
from fast.models.ids import content_id
from fast.tasks.campaign.campaign import stored_provenance
from fast.tasks.campaign.requests import append_event

ASKED, ANSWERED, HEARD = "bench_asks", "bench_answered", "bench_heard"  # kinds of the events
LOOK_S = 0.5
logger = logging.getLogger(__name__)
_ALL = f"""
    SELECT kind, payload_json ->> '$.question_id' AS question_id, payload_json -> '$.said' AS said FROM events
    WHERE campaign_id = $campaign AND kind IN ('{ASKED}', '{ANSWERED}', '{HEARD}') ORDER BY {OLDEST_FIRST}, event_id
"""


@dataclass(frozen=True)
class OpenQuestion:
    """A question that waits for an answer."""

    question_id: str
    question: BenchQuestion


def list_open_questions(lake: Lake, campaign_id: str) -> list[OpenQuestion]:
    """List the questions of a campaign's bench that nobody has answered, the oldest first."""
    asked, answers, heard = _read(lake, campaign_id)
    over = answers.keys() | heard
    return [OpenQuestion(name, question) for name, question in asked.items() if name not in over]


def answer_question(
    lake: Lake, campaign_id: str, question_id: str, choice: str, values: Mapping[str, str], operator: str
) -> str:
    """Answer a question of a bench; a sentence says what was answered.

    Raises:
        UsageError: it is answered already, there is no such choice, or a field cannot be used.
    """
    found = next((one for one in list_open_questions(lake, campaign_id) if one.question_id == question_id), None)
    if found is None:
        raise UsageError("this question is answered already, or the bench asks it no more; nothing was changed.")
    question = found.question
    if choice not in question.choices:
        raise UsageError(f"`{choice}` is no choice; there are {', '.join(question.choices)}. Nothing was changed.")
    read: dict[str, float | str] = {}
    for field in question.fields:
        text = values.get(field.name, "").strip()
        if not text:
            raise UsageError(f"{field.label} is not filled in; nothing was changed.")
        read[field.name] = read_number(field.label, text) if field.kind == "number" else text
    answer = BenchAnswer(choice=choice, values=read, operator=operator)
    message = f"{operator} answered: {choice} ({question.sentence})"
    said = answer.model_dump(mode="json")
    payload = {"question_id": question_id, "said": said}
    row = EventRow.of([ANSWERED, question_id], ANSWERED, message, payload, campaign_id)
    lake.append([row], stored_provenance(lake, campaign_id))
    return f"The bench is told: {choice}."


def withdraw_questions(lake: Lake, campaign_id: str) -> None:
    """Withdraw what the bench asked: it works no more, and needs no answer."""
    for one in list_open_questions(lake, campaign_id):
        append_event(lake, campaign_id, HEARD, f"asked no more: {one.question.sentence}", question_id=one.question_id)


def make_ask(
    lake: Lake, campaign_id: str, should_stop: Callable[[], bool], call: Callable[[BenchQuestion], object] | None = None
) -> Ask:
    """Make what a campaign's bench asks a person with; it waits for the answer, or until somebody stops.

    `call` has people hear of a question that waits; None: the log does.
    """

    def ask(question: BenchQuestion) -> BenchAnswer:
        asked, answers, heard = _read(lake, campaign_id)
        n_heard = sum(one.key == question.key for name, one in asked.items() if name in heard)
        question_id = content_id("E", [campaign_id, question.key, n_heard])
        if question_id not in asked:
            said = question.model_dump(mode="json")
            append_event(lake, campaign_id, ASKED, question.sentence, question_id=question_id, said=said)
        if question_id not in answers and call is not None:
            call(question)
        elif question_id not in answers:
            logger.warning("%s Answer on the lab's page, or with `fast campaign answer`.", question.sentence)
        answer = _wait(lake, campaign_id, question_id, should_stop)
        append_event(lake, campaign_id, HEARD, f"the bench heard: {answer.choice}", question_id=question_id)
        return answer

    return ask


def _wait(lake: Lake, campaign_id: str, question_id: str, should_stop: Callable[[], bool]) -> BenchAnswer:
    mark: Mark | None = None
    while True:
        now = lake.mark(EventRow)
        if now != mark:
            mark, answers = now, _read(lake, campaign_id)[1]
            if question_id in answers:
                return answers[question_id]
        if should_stop():
            raise StopAskedError(Verb.STOP)
        time.sleep(LOOK_S)


def _read(lake: Lake, campaign_id: str) -> tuple[dict[str, BenchQuestion], dict[str, BenchAnswer], set[str]]:
    """Read questions and answers by question, and the questions that are over."""
    asked: dict[str, BenchQuestion] = {}
    answers: dict[str, BenchAnswer] = {}
    heard: set[str] = set()
    for row in lake.query(_ALL, {"campaign": campaign_id}).to_pylist():
        name = row["question_id"]
        if row["kind"] == ASKED:
            asked[name] = BenchQuestion.model_validate_json(row["said"])
        elif row["kind"] == ANSWERED:
            answers.setdefault(name, BenchAnswer.model_validate_json(row["said"]))
        else:
            heard.add(name)
    return asked, answers, heard


def read_number(label: str, text: str) -> float:
    """Read a number as a person writes it, with a point or a comma.

    Raises:
        UsageError: it is none.
    """
    try:
        return float(text.strip().replace(",", "."))
    except ValueError as error:
        raise UsageError(f"{label}: `{text}` is not a number; write it like 2.61. Nothing was changed.") from error
