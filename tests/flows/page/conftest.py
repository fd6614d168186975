"""What tests of the page share."""

import pytest

from fast.tasks.bench import told_questions
from fast.tasks.simulation.pool import Worker


@pytest.fixture
def unsimulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is told is compared with its repeats alone, in this process."""
    monkeypatch.setattr(told_questions, "_simulate", lambda *_: None)
    monkeypatch.setattr(Worker, "call", lambda self, function, *words, **named: function(*words, **named))
