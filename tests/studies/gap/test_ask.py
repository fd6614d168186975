"""The study of asking: worlds follow from their secret, a broken seal voids the run, and what counts as an answer."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fast.models.errors import UsageError
from tests.studies.benchmarks.base import Options
from tests.studies.gap import ask
from tests.studies.gap.ask import Asking, measure_asking, say
from tests.studies.gap.ask_worlds import MEMBERS, Bench, draw_key


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody is asked: every world is said to lag, after 8 of 6 promised grasps, and after 30 at random."""

    def answer(name: str, bench: Bench) -> Asking:
        lag = "load_cell_lag"
        return Asking(world=name, before="", possible=MEMBERS, promised=6, spent=8, minutes=2.0, says=lag, at_random=30)

    monkeypatch.setattr(ask, "ask_world", answer)
    monkeypatch.setattr(ask.Bench, "of", lambda key: None)


def test_worlds_follow_from_their_secret() -> None:
    assert draw_key("a", "member", 3) == draw_key("a", "member", 3)
    assert draw_key("a", "member", 3) != draw_key("b", "member", 3)
    assert [draw_key("a", "member", n).law for n in range(5)] == list(MEMBERS)
    hidden = draw_key("a", "unknown", 1)
    assert (hidden.law in hidden.without, hidden.answer) == (True, "unknown")


def test_a_law_that_nobody_may_name_is_not_in_the_catalogue() -> None:
    bench = Bench.of(draw_key("a", "unknown", 3))
    assert bench.key.law == "stress_relaxation"
    assert "stress_relaxation" in bench.data.training.names
    assert "stress_relaxation" not in bench.catalogue


def test_sealed_worlds_are_counted(made_up: None, tmp_path: Path) -> None:
    tables = measure_asking(Options(worlds=5, results=tmp_path / "worlds.jsonl"))
    (row,) = tables["asking"]
    assert (row["members"], row["asked"], row["right"], row["wrong"]) == (5, 5, 1, 4)
    assert row["answered_within_1.5_of_promised"] == 5
    assert row["chosen_over_random"] == pytest.approx(8 / 30)
    assert (row["unknown_truths"], row["unknown_after_asking"]) == (2, 0)


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("worlds-keys.jsonl", lambda text: text.replace('"amplitude":0.', '"amplitude":1.', 1)),
        ("worlds-answers.jsonl", lambda text: text.replace('"spent":8', '"spent":4', 1)),
    ],
)
def test_a_broken_seal_voids_the_run(made_up: None, tmp_path: Path, file: str, change: Callable[[str], str]) -> None:
    options = Options(worlds=5, results=tmp_path / "worlds.jsonl")
    measure_asking(options)
    path = tmp_path / file
    broken = change(path.read_text())
    assert broken != path.read_text()
    path.write_text(broken)
    with pytest.raises(UsageError, match="does not fit its hash; this run is void"):
        measure_asking(options)


@pytest.mark.parametrize(
    ("chances", "said"),
    [
        ({"lag": 0.9, "shift": 0.04, "unknown": 0.06}, "lag"),
        ({"lag": 0.9, "shift": 0.05, "unknown": 0.05}, ""),  # odds of 18 to 1
        ({"lag": 0.3, "shift": 0.1, "unknown": 0.6}, "unknown"),
        ({"lag": 0.4, "none": 0.6}, "none"),
    ],
)
def test_what_counts_as_an_answer(chances: dict[str, float], said: str) -> None:
    believed: Any = [SimpleNamespace(name=name, probability=chance) for name, chance in chances.items()]
    assert say(believed) == said
