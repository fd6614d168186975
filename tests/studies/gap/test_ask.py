"""The study of asking: worlds follow from their secret, a broken seal voids the run, and what counts as an answer."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fast.models.errors import UsageError
from fast.models.gap.ask.predict import Pair
from fast.models.gap.ask.settings import list_settings
from fast.models.records import GraspSetup
from tests.studies.benchmarks.base import Options
from tests.studies.gap import ask
from tests.studies.gap.ask import Asking, list_alike, measure_asking, say
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
    assert draw_key("a", "member", "small", 3) == draw_key("a", "member", "small", 3)
    assert draw_key("a", "member", "small", 3) != draw_key("b", "member", "small", 3)
    assert draw_key("a", "member", "small", 3).amplitude < 0.07 <= draw_key("a", "member", "large", 3).amplitude
    assert [draw_key("a", "member", "large", n).law for n in range(5)] == list(MEMBERS)
    hidden = draw_key("a", "unknown", "large", 1)
    assert (hidden.law in hidden.without, hidden.answer) == (True, "unknown")
    assert draw_key("a", "nothing", "large", 1).answer == "none"


def test_a_law_that_nobody_may_name_is_not_in_the_catalogue() -> None:
    bench = Bench.of(draw_key("a", "unknown", "small", 3))
    assert bench.key.law == "stress_relaxation"
    assert "stress_relaxation" in bench.data.training.names
    assert "stress_relaxation" not in bench.catalogue


def test_where_nothing_is_hidden_traces_come_as_late_at_any_speed() -> None:
    """A pair of grasps has the same delay twice: their difference is noise alone."""
    bench = Bench.of(draw_key("a", "nothing", "large", 2))
    fast = next(one for one in list_settings(GraspSetup()) if one.setup.lift_speed_mm_per_s == 20.0)
    (changes,) = bench.answer({Pair(0, 0, fast): 30}).experiments.values()
    standard_error = changes.std(axis=0) / np.sqrt(len(changes))
    assert (np.abs(changes.mean(axis=0)) < 5.0 * standard_error + 0.1).all()


def test_sealed_worlds_are_counted(made_up: None, tmp_path: Path) -> None:
    tables = measure_asking(Options(worlds=5, results=tmp_path / "worlds.jsonl"))
    for row in tables["asking"]:
        assert (row["members"], row["asked"], row["right"], row["wrong"]) == (5, 5, 1, 4)
        assert (row["of_family"], row["in_set"]) == (3, 0)
        assert row["answered_within_1.5_of_promised"] == 5
        assert row["chosen_over_random"] == pytest.approx(8 / 30)
        assert (row["unknown_truths"], row["unknown_named"]) == (2, 2)
        assert (row["nothing"], row["nothing_named"], row["nothing_grasps"]) == (2, 2, 16)


def test_effects_that_are_left_alike_are_a_set() -> None:
    believed = [SimpleNamespace(name=name, probability=p) for name, p in [("a", 0.3), ("b", 0.6), ("unknown", 0.1)]]
    assert list_alike(believed) == ("b", "a")  # type: ignore[arg-type]


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
