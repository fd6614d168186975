"""Every reason that a simulation may fail for has words for people."""

import re
from pathlib import Path
from typing import get_args

import pytest

from fast.models.errors import REASON_WORDS, spell_reason
from fast.models.simulation.solver.newton import Outcome

ROOT = Path(__file__).parents[2]


def test_every_reason_has_words():
    sources = [*(ROOT / "models/simulation").rglob("*.py"), *(ROOT / "tasks/simulation").rglob("*.py")]
    text = "\n".join(path.read_text() for path in sources)
    said = set(re.findall(r"(?:reason=|reason, message = |_lost\(|return )\"([a-z_]+)\"(?:[,)]|, None)", text))
    said |= set(re.findall(r"Failed\([^()]*(?:\([^()]*\)[^()]*)*, ?\s*\"([a-z_]+)\",?\s*\)", text))
    assert {"time_out", "crash", "deep_penetration", "hang"} <= said
    assert said | set(get_args(Outcome)) - {"converged"} == set(REASON_WORDS)


@pytest.mark.parametrize(
    ("reason", "words"), [("max_steps", REASON_WORDS["max_steps"]), ("tip torn", "tip torn"), ("", "")]
)
def test_a_reason_is_said_in_words(reason, words):
    assert spell_reason(reason) == words
