"""`fast compare`: landscapes, races of every strategy, what the table says, and continuing a killed comparison."""

import numpy as np
import pytest

from flows.scientist import study
from flows.scientist.figure import races_figure
from flows.scientist.landscape import emulated_landscape, synthetic_landscape
from flows.scientist.landscape_run import Course, RaceSchedule, run_race
from flows.scientist.strategies import REFERENCE, STRATEGIES, STRATEGY_BY_NAME
from flows.scientist.study import Entry, read_courses, run_study
from flows.scientist.verdict import paired_rows, summary_rows
from models.design.space import random_unit
from models.errors import UsageError
from models.scientist.surrogate.observations import ObservationSet
from tests.flows.cli.cli_lakes import Fast
from tests.flows.synthetic_lake import Campaign, build

SHORT = RaceSchedule(
    initial_tools=6,
    initial_simulations=8,
    rounds=2,
    tools_per_round=3,
    simulations_per_round=4,
    simulations_at_once=2,
)


@pytest.fixture
def fast(capsys):
    return Fast(capsys)


def course(strategy: str, seed: int, best_n: tuple[float, ...], batch_n: tuple[float, ...] | None = None) -> Course:
    return Course(
        landscape=f"made up {seed}",
        strategy=strategy,
        seed=seed,
        optimum_n=20.0,
        best_n=best_n,
        batch_mean_n=batch_n or best_n,
        n_measured=10,
        n_simulated=0,
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_landscape_is_hard_and_its_simulator_half_right(seed):
    landscape, x = synthetic_landscape(seed), random_unit(4000, np.random.default_rng(1))
    real, simulated = landscape.real(x), landscape.simulated(x)
    assert real.max() < landscape.best_n  # four thousand random designs do not find it
    assert np.mean(real) < 0.65 * landscape.best_n
    assert 0.25 < np.corrcoef(real, simulated)[0, 1] < 0.8
    assert real[np.argsort(-simulated)[:10]].mean() < 0.9 * landscape.best_n
    assert 0.01 < landscape.fails(x).mean() < 0.06
    np.testing.assert_array_equal(real, synthetic_landscape(seed).real(x))


def test_an_emulated_landscape_simulates_what_it_was_given():
    x = random_unit(120, np.random.default_rng(2))
    y = 20 + 6 * np.sin(2 * x[:, 0]) + 5 * x[:, 5]
    landscape = emulated_landscape(ObservationSet(x, np.zeros(120), y, np.zeros(120)), seed=3)
    unseen = random_unit(200, np.random.default_rng(4))
    np.testing.assert_allclose(
        landscape.simulated(unseen), 20 + 6 * np.sin(2 * unseen[:, 0]) + 5 * unseen[:, 5], atol=0.6
    )
    assert 0.3 < np.corrcoef(landscape.real(unseen), landscape.simulated(unseen))[0, 1] < 0.999


@pytest.mark.parametrize("strategy", STRATEGIES, ids=lambda strategy: strategy.name)
def test_every_strategy_keeps_to_the_budget(strategy):
    result = run_race(synthetic_landscape(1), strategy, SHORT, seed=1)
    assert result.n_measured == (6 + 2 * 3 if strategy.tools else 3)
    assert result.n_simulated == (8 + 2 * 4 if strategy.simulations else 0)
    assert len(result.best_n) == (3 if strategy.tools else 1)
    assert (np.diff(result.best_n) >= 0).all()
    assert max(result.batch_mean_n) <= result.optimum_n


def test_strategies_begin_alike_and_races_repeat():
    first, second = (
        run_race(synthetic_landscape(1), STRATEGY_BY_NAME[name], SHORT, 1) for name in ("random", REFERENCE)
    )
    assert first.best_n[0] == second.best_n[0]
    assert run_race(synthetic_landscape(1), STRATEGY_BY_NAME[REFERENCE], SHORT, 1) == second
    assert run_race(synthetic_landscape(2), STRATEGY_BY_NAME[REFERENCE], SHORT, 2).best_n != second.best_n


def test_the_table_counts_regret_rounds_and_wins():
    reference = [course(REFERENCE, seed, (10.0, 15.0, 19.5)) for seed in range(3)]
    other = [course("random", seed, (10.0, 12.0 + seed, 14.0 + seed), (9.0, 9.0, 20.0)) for seed in range(3)]
    summary = {row["strategy"]: row for row in summary_rows([*reference, *other])}
    assert summary[REFERENCE]["final_regret_n"] == pytest.approx(0.5)
    assert summary[REFERENCE]["mean_regret_n"] == pytest.approx(2.75)
    assert summary[REFERENCE]["rounds_to_97_percent"] == 2
    assert (summary["random"]["reached_97_percent"], summary["random"]["rounds_to_97_percent"]) == (0, None)
    (paired,) = paired_rows([*reference, *other], REFERENCE)
    assert (paired["best_wins"], paired["last_batch_wins"], paired["n_pairs"]) == (0, 3, 3)
    assert paired["mean_regret_gain_n"] == pytest.approx(2.75 - 6.0)
    assert paired["match_share"] == 0.5  # 15 N after one round of two equals what `random` has at its end
    assert 0 < paired["p"] < 0.1


def test_a_strategy_that_measures_once_is_paired_by_what_it_reached():
    pairs = [course(REFERENCE, 0, (10.0, 18.0)), course("simulation only", 0, (16.0,))]
    (row,) = paired_rows(pairs, REFERENCE)
    assert (row["best_gain_n"], row["mean_regret_gain_n"]) == (-2.0, None)


def test_a_killed_comparison_is_continued(tmp_path, monkeypatch):
    path, entries = tmp_path / "races.jsonl", [Entry(name, 1, SHORT) for name in ("random", REFERENCE)]
    said: list[str] = []
    whole = run_study(entries, path, 1, said.append)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(lines[0] + lines[1][:40])
    kept = next(iter(read_courses(path, {entry.key for entry in entries}).values()))
    again = run_study(entries, path, 1, said.append)
    assert [c.model_copy(update={"cpu_s": 0.0}) for c in again] == [c.model_copy(update={"cpu_s": 0.0}) for c in whole]
    assert kept in again
    assert "1 races known, 1 to run" in said
    path.write_text("{}\n")
    with pytest.raises(UsageError, match="line 1 is no course of a comparison"):
        run_study(entries, path, 1, said.append)


def test_the_figure_shows_every_strategy():
    courses = [
        course(REFERENCE, 0, (10.0, 18.0)),
        course("simulation only", 0, (16.0,)),
        course("random", 0, (9.0, 11.0)),
    ]
    left, right = races_figure(courses, REFERENCE).axes
    assert [line.get_label() for line in left.get_lines()] == [REFERENCE, "simulation only", "random"]
    assert [label.get_text() for label in right.get_yticklabels()] == ["random", "simulation only", REFERENCE]


def test_the_command_writes_table_and_picture(fast, tmp_path, monkeypatch):
    monkeypatch.setattr(study, "_run", lambda entries, n, tell: (course(e.strategy, e.seed, (10.0, 12.0)).model_copy(
        update={"landscape": e.key[0]}) for e in entries))  # fmt: skip
    answer = fast(
        "compare", "--races", "2", "--strategies", f"random;{REFERENCE}", "--figure", str(tmp_path / "c.png"), "--json"
    )
    assert [row["n_races"] for row in answer.json["strategies"]] == [2, 2]
    assert (tmp_path / "c.png").stat().st_size > 10_000
    assert (
        fast("compare", "--strategies", "randon").err == "fast: There is no strategy `randon`; did you mean `random`?\n"
    )


def test_a_lake_with_few_simulations_is_not_emulated(fast, tmp_path):
    from lake.store import Lake

    build(Lake.open(tmp_path / "lake", create=True), Campaign(campaign_id="quick", n_measured_batches=1))
    answer = fast("compare", "--emulate", str(tmp_path / "lake"))
    assert (answer.status, "completely simulated designs, 30 are needed" in answer.err) == (2, True)
