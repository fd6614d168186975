"""The study of the insights: its arithmetic of stopping and of chances, and one race on a made-up bank."""

import json

import numpy as np
import pytest

from fast.models.scientist.insights.effects import Interval
from fast.models.scientist.insights.rules import MARGIN
from tests.studies.benchmarks.base import Options
from tests.studies.landscapes.made_up import write_bank
from tests.studies.scientist import insights
from tests.studies.scientist.insights import (
    Answer,
    Taught,
    chance_rows,
    effect_rows,
    matter_rows,
    simplest_rows,
    stop,
    stopping_rows,
)


def taught(best_n=(10.0, 20.0, 20.0, 20.0, 22.0), chances=(0.9, 0.01, 0.015, 0.5), **more) -> Taught:
    return Taught(
        landscape="made up", strategy=insights.MEASURED, seed=0, best_n=best_n, chances=chances,
        gains_n=(0.0,) * len(chances), widened=(1.0,), answers=more.get("answers", ()), simpler=more.get("simpler", ()),
        matter=more.get("matter", ()),
        cpu_s=0.0,
    )  # fmt: skip


def test_a_race_stops_after_two_batches_that_say_no() -> None:
    """Said before the second and the third batch: two are printed, two are saved of 11 trays."""
    loss, saved = stop(taught())
    assert loss == pytest.approx(1.0 - 20.0 / 22.0)
    assert saved == pytest.approx(2 * 10 / 110)
    assert stop(taught(chances=(0.9, 0.01, 0.5, 0.01))) == (0.0, 0.0)
    assert stopping_rows([taught()])[0]["prints_saved"] == pytest.approx(2 * 10 / 110)


def test_chances_are_held_against_what_came() -> None:
    rows = chance_rows([taught()])
    assert [row["n"] for row in rows] == [2, 0, 1, 1]
    assert (rows[3]["said"], rows[3]["came"]) == (0.9, 1.0)
    assert (rows[2]["said"], rows[2]["came"]) == (0.5, 1.0)  # 22 is a tenth above 20
    assert MARGIN < 0.1


def test_intervals_and_simpler_fingers_are_counted() -> None:
    answers = [
        Answer(kind="main", n_tools=30, said=Interval(middle=1.0, low=0.0, high=2.0), true=true) for true in (1.5, 3.0)
    ]
    race = taught(answers=answers, simpler=(("fewest ribs", 0.99), ("fewest ribs", 0.97)))
    assert effect_rows([race])[0]["held"] == 0.5
    assert simplest_rows([race])[0]["as_good"] == 0.5


def test_parameters_that_are_said_to_matter_are_held_against_the_true_ones() -> None:
    races = [taught(matter=((30, 0), (30, 3))), taught(matter=((30, 2), (60, 8)))]
    assert matter_rows(races) == [
        {"tools": 30, "named": 3, "first_three": pytest.approx(2 / 3)},
        {"tools": 60, "named": 1, "first_three": 0.0},
    ]


@pytest.mark.slow  # a race of the paper's schedule
def test_a_race_is_asked_and_kept(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(insights, "BANK", write_bank(tmp_path))
    monkeypatch.setattr(insights, "N_SEEDS", {insights.MEASURED: 1})
    monkeypatch.setattr(insights, "cost_rows", list)
    results = tmp_path / "races.jsonl"
    tables = insights.measure_insights(Options(results=results))
    assert {row["effect"] for row in tables["effects"]} == {"main", "pair"}
    races = [json.loads(line) for line in results.read_text().splitlines()]
    assert [len(race["chances"]) for race in races] == [8, 8]
    assert np.isfinite([answer["true"] for race in races for answer in race["answers"]]).all()
    again = insights.measure_insights(Options(results=results, limit_minutes=0.0))
    assert again == tables
