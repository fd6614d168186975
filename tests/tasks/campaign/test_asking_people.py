"""A person is asked, reminded, and let go when the answer is there."""

from types import SimpleNamespace
from typing import Any

import pytest

from fast.tasks.campaign.prefect_tasks import ask_person


class Heard:
    """A prompt that notes what was called."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def ask(self) -> None:
        self.calls.append("ask")

    def remind(self) -> None:
        self.calls.append("remind")

    def close(self) -> None:
        self.calls.append("close")


@pytest.mark.parametrize(
    ("stops_after", "expected"),
    [(99, ["ask", "remind", "remind", "close"]), (1, ["ask", "remind"])],
    ids=["answered", "stopped"],
)
def test_a_person_is_reminded_until_the_answer_is_there_or_the_campaign_stops(
    stops_after: int, expected: list[str]
) -> None:
    campaign: Any = SimpleNamespace(config=SimpleNamespace(execution=SimpleNamespace(print_poll_s=0.0)))
    prompt, is_open = Heard(), iter([True, True, False])
    is_told = ask_person(campaign, prompt, lambda: next(is_open), lambda: prompt.calls.count("remind") >= stops_after)
    assert (is_told, prompt.calls) == ("close" in expected, expected)
