"""`fast compare`: landscapes, runs of every strategy, what the table says, and continuing a killed comparison."""

import numpy as np
import pytest

from flows.scientist import landscape_study
from flows.scientist.landscape import emulated_landscape, synthetic_landscape
from flows.scientist.landscape_run import LandscapeRun, RunSchedule, run_strategy
from flows.scientist.landscape_study import PlannedRun, read_runs, run_planned
from flows.scientist.landscape_table import paired_rows, runs_figure, summary_rows
from flows.scientist.strategies import REFERENCE, STRATEGIES
from models.design.space import random_unit
from models.errors import UsageError
from models.scientist.surrogate.observations import ObservationSet
from tests.flows.cli.cli_lakes import Fast
from tests.flows.synthetic_lake import Campaign, build

SHORT = RunSchedule(
    initial_tools=6,
    initial_simulations=8,
    rounds=2,
    tools_per_round=3,
    simulations_per_round=4,
    simulations_at_once=2,
)
SHORTEST = SHORT.model_copy(update={"rounds": 1, "tools_per_round": 1, "simulations_per_round": 2})


@pytest.fixture
def fast(capsys):
    return Fast(capsys)


def made_up(
    strategy: str, seed: int, best_n: tuple[float, ...], batch_n: tuple[float, ...] | None = None
) -> LandscapeRun:
    return LandscapeRun(
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


@pytest.mark.parametrize("strategy", STRATEGIES.values(), ids=lambda strategy: strategy.name)
def test_every_strategy_keeps_to_the_budget(strategy):
    result = run_strategy(synthetic_landscape(1), strategy, SHORT, seed=1)
    assert result.n_measured == (6 + 2 * 3 if strategy.tools else 3)
    assert result.n_simulated == (8 + 2 * 4 if strategy.simulations else 0)
    assert len(result.best_n) == (3 if strategy.tools else 1)
    assert (np.diff(result.best_n) >= 0).all()
    assert max(result.batch_mean_n) <= result.optimum_n


def test_strategies_begin_alike_and_runs_repeat():
    first, second = (
        run_strategy(synthetic_landscape(1), STRATEGIES[name], SHORTEST, 1) for name in ("random", REFERENCE)
    )
    assert first.best_n[0] == second.best_n[0]
    assert run_strategy(synthetic_landscape(1), STRATEGIES[REFERENCE], SHORTEST, 1) == second
    assert run_strategy(synthetic_landscape(2), STRATEGIES[REFERENCE], SHORTEST, 2).best_n != second.best_n


def test_the_table_counts_regret_rounds_and_wins():
    reference = [made_up(REFERENCE, seed, (10.0, 15.0, 19.5)) for seed in range(3)]
    other = [made_up("random", seed, (10.0, 12.0 + seed, 14.0 + seed), (9.0, 9.0, 20.0)) for seed in range(3)]
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
    pairs = [made_up(REFERENCE, 0, (10.0, 18.0)), made_up("simulation only", 0, (16.0,))]
    (row,) = paired_rows(pairs, REFERENCE)
    assert (row["best_gain_n"], row["mean_regret_gain_n"]) == (-2.0, None)


def test_a_killed_comparison_is_continued(tmp_path, monkeypatch):
    path, plan = tmp_path / "races.jsonl", [PlannedRun(name, 1, SHORTEST) for name in ("random", REFERENCE)]
    said: list[str] = []
    whole = run_planned(plan, path, 1, said.append)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(lines[0] + lines[1][:40])
    kept = next(iter(read_runs(path, {planned.key for planned in plan}).values()))
    again = run_planned(plan, path, 1, said.append)
    assert [c.model_copy(update={"cpu_s": 0.0}) for c in again] == [c.model_copy(update={"cpu_s": 0.0}) for c in whole]
    assert kept in again
    assert "1 runs known, 1 to run" in said
    path.write_text("{}\n")
    with pytest.raises(UsageError, match="line 1 is no run of a comparison"):
        run_planned(plan, path, 1, said.append)


def test_the_figure_shows_every_strategy():
    runs = [
        made_up(REFERENCE, 0, (10.0, 18.0)),
        made_up("simulation only", 0, (16.0,)),
        made_up("random", 0, (9.0, 11.0)),
    ]
    left, right = runs_figure(runs, REFERENCE).axes
    assert [line.get_label() for line in left.get_lines()] == [REFERENCE, "simulation only", "random"]
    assert [label.get_text() for label in right.get_yticklabels()] == ["random", "simulation only", REFERENCE]


def test_the_command_writes_table_and_picture(fast, tmp_path, monkeypatch):
    def run_all(plan, n_workers, tell):
        for planned in plan:
            run = made_up(planned.strategy, planned.seed, (10.0, 12.0))
            yield run.model_copy(update={"landscape": planned.key[0]})

    monkeypatch.setattr(landscape_study, "_run_all", run_all)
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
