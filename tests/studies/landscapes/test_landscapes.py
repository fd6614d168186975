"""Strategies on landscapes: runs of every strategy, what the table says, and continuing a killed comparison."""

from dataclasses import replace

import numpy as np
import pytest

from fast.flows.scientist.campaign_runs import BASELINE
from fast.models.design.space import random_unit
from fast.models.errors import UsageError
from tests.studies.benchmarks.base import Options
from tests.studies.landscapes import compare, study
from tests.studies.landscapes.bank import BELIEVED, EFFECT, THETA, TRUE
from tests.studies.landscapes.landscape import NOISE_SD_N, PRINT_SD, emulator_error, landscape_of, read_landscape
from tests.studies.landscapes.made_up import believed_n, made_up_bank, true_n, write_bank
from tests.studies.landscapes.run import LandscapeRun, RunSchedule, run_strategy
from tests.studies.landscapes.strategies import LANDSCAPE_STRATEGIES, LOOP, LOOP_DISCOVERED
from tests.studies.landscapes.study import NAMED_SHARE, plan_runs, read_runs, run_planned, with_discovery
from tests.studies.landscapes.table import landscape_rows, paired_rows, runs_figure, sign_flip_p, summary_rows

SHORT = RunSchedule(
    initial_tools=6,
    initial_simulations=8,
    rounds=2,
    tools_per_round=3,
    simulations_per_round=4,
    simulations_at_once=2,
)
SHORTEST = SHORT.model_copy(update={"rounds": 1, "tools_per_round": 1, "simulations_per_round": 2})


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


@pytest.fixture(scope="module")
def landscapes():
    bank = made_up_bank()
    return [landscape_of(bank, number) for number in range(2)]


@pytest.mark.parametrize("number", [0, 1])
def test_a_landscape_is_what_was_simulated_and_its_simulators_too(landscapes, number):
    """Emulators hold between the designs of the bank, and the optimum is no worse than any design's force."""
    landscape, x = landscapes[number], random_unit(400, np.random.default_rng(1))
    assert np.median(np.abs(landscape.real(x) / true_n(x, number) - 1.0)) < 0.05
    assert np.median(np.abs(landscape.simulators[BELIEVED](x) / believed_n(x) - 1.0)) < 0.05
    assert np.median(np.abs(landscape.simulators[THETA](x) / (0.8 * believed_n(x)) - 1.0)) < 0.05
    assert landscape.simulators[EFFECT](x) == pytest.approx(landscape.real(x), rel=1e-6)
    assert landscape.best_n >= landscape.real(x).max()
    assert 0.0 < emulator_error(made_up_bank(), number, TRUE) < 0.1


def test_a_measurement_has_the_scatter_of_prints_and_noise(landscapes):
    x = np.repeat(random_unit(1, np.random.default_rng(0)), 4000, axis=0)
    true_force_n = landscapes[0].real(x)[0]
    measured_n = landscapes[0].measure(x, np.random.default_rng(2))
    assert measured_n.std() == pytest.approx(np.hypot(PRINT_SD * true_force_n, NOISE_SD_N), rel=0.05)


@pytest.mark.parametrize("strategy", LANDSCAPE_STRATEGIES.values(), ids=lambda strategy: strategy.name)
def test_every_strategy_keeps_to_the_budget(landscapes, strategy):
    result = run_strategy(landscapes[1], strategy, SHORT, seed=1)
    assert result.n_measured == (6 + 2 * 3 if strategy.tools else 3)
    assert result.n_simulated == strategy.n_night + (8 + 2 * 4 if strategy.simulations else 0)
    assert len(result.best_n) == (3 if strategy.tools else 1)
    assert (np.diff(result.best_n) >= 0).all()
    assert max(result.batch_mean_n) <= result.optimum_n


def test_strategies_begin_alike_and_runs_repeat(landscapes):
    first, second = (
        run_strategy(landscapes[0], LANDSCAPE_STRATEGIES[name], SHORTEST, 1) for name in ("random", BASELINE)
    )
    assert first.best_n[0] == second.best_n[0]
    assert run_strategy(landscapes[0], LANDSCAPE_STRATEGIES[BASELINE], SHORTEST, 1) == second
    assert run_strategy(landscapes[0], LANDSCAPE_STRATEGIES[BASELINE], SHORTEST, 2).best_n != second.best_n


def test_only_the_loop_asks_the_simulator_after_the_night(landscapes):
    asked = {name: set() for name in LANDSCAPE_STRATEGIES}
    for name, strategy in LANDSCAPE_STRATEGIES.items():

        def watched(simulator, force, name=name):
            return lambda x: asked[name].add(simulator) or force(x)

        simulators = {key: watched(key, force) for key, force in landscapes[0].simulators.items()}
        run_strategy(replace(landscapes[0], simulators=simulators), strategy, SHORTEST, 1)
    assert asked[LOOP[EFFECT]] == {EFFECT}
    assert asked[LOOP[THETA]] == {THETA}
    assert asked[BASELINE] == {BELIEVED}
    assert asked["measured only"] == asked["random"] == set()


def test_the_table_counts_regret_rounds_and_wins():
    reference = [made_up(BASELINE, seed, (10.0, 15.0, 19.5)) for seed in range(3)]
    other = [made_up("random", seed, (10.0, 12.0 + seed, 14.0 + seed), (9.0, 9.0, 20.0)) for seed in range(3)]
    summary = {row["strategy"]: row for row in summary_rows([*reference, *other])}
    assert summary[BASELINE]["final_regret_n"] == pytest.approx(0.5)
    assert summary[BASELINE]["mean_regret_n"] == pytest.approx(2.75)
    assert summary[BASELINE]["rounds_to_97_percent"] == 2
    assert (summary["random"]["reached_97_percent"], summary["random"]["rounds_to_97_percent"]) == (0, None)
    (paired,) = paired_rows([*reference, *other], BASELINE)
    assert (paired["best_wins"], paired["last_batch_wins"], paired["n_pairs"]) == (0, 3, 3)
    assert paired["mean_regret_gain_n"] == pytest.approx(2.75 - 6.0)
    assert paired["regret_share"] == pytest.approx(6.0 / 2.75)
    assert paired["landscapes_better"] == "0 of 3"
    assert paired["p"] == 2 / 8  # three landscapes cannot say more
    assert paired["rounds_share"] == 3 / 2  # never there: one round more than there are
    assert landscape_rows([*reference, *other])[0] == {
        "landscape": "made up 0", "optimum_n": 20.0, BASELINE: 2.0, "random": 3.0,
    }  # fmt: skip


def test_seeds_of_a_landscape_are_no_independent_worlds():
    """Twenty seeds on two landscapes: one swap of both is as likely as what was seen."""
    runs = [
        made_up(name, seed, (10.0, best_n)).model_copy(update={"landscape": f"truth {seed % 2}"})
        for seed in range(20)
        for name, best_n in ((BASELINE, 15.0), ("random", 12.0))
    ]
    (paired,) = paired_rows(runs, BASELINE)
    assert (paired["n_pairs"], paired["landscapes_better"], paired["p"]) == (20, "0 of 2", 0.5)


@pytest.mark.parametrize(("gains", "p"), [([1.0] * 8, 2 / 256), ([1.0, -1.0], 1.0), ([], None), ([1.0] * 17, None)])
def test_swaps_of_whole_landscapes_are_counted_exactly(gains, p):
    assert sign_flip_p(np.array(gains)) == p


def test_a_strategy_that_measures_once_is_paired_by_what_it_reached():
    pairs = [made_up(BASELINE, 0, (10.0, 18.0)), made_up("simulation only", 0, (16.0,))]
    (row,) = paired_rows(pairs, BASELINE)
    assert (row["best_gain_n"], row["mean_regret_gain_n"]) == (-2.0, None)


def test_a_killed_comparison_is_continued(tmp_path, monkeypatch):
    path, plan = tmp_path / "races.jsonl", plan_runs(write_bank(tmp_path), 1, ("random", BASELINE), SHORTEST)[:2]
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
        made_up(BASELINE, 0, (10.0, 18.0)),
        made_up("simulation only", 0, (16.0,)),
        made_up("random", 0, (9.0, 11.0)),
    ]
    left, right = runs_figure(runs, BASELINE).axes
    assert [line.get_label() for line in left.get_lines()] == [BASELINE, "simulation only", "random"]
    assert [label.get_text() for label in right.get_yticklabels()] == ["random", "simulation only", BASELINE]


def test_the_study_writes_tables_and_picture(tmp_path, monkeypatch):
    def run_all(plan, n_workers, tell):
        for planned in plan:
            run = made_up(planned.strategy, planned.seed, (10.0, 12.0))
            yield run.model_copy(update={"landscape": planned.key[0]})

    monkeypatch.setattr(study, "_run_all", run_all)
    monkeypatch.setattr(compare, "BANK", write_bank(tmp_path))
    tables = compare.measure_landscapes(Options(n=2, figure=tmp_path / "c.png"))
    assert {row["n_races"] for row in tables["strategies"]} == {4}
    assert [row["strategy"] for row in tables["strategies"]] == [*LANDSCAPE_STRATEGIES, LOOP_DISCOVERED]
    assert (tmp_path / "c.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("name", "said"), [("other.json", "is no bank of landscapes"), ("none.json", "cannot be read")]
)
def test_a_file_that_is_no_bank_is_refused(tmp_path, name, said):
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(UsageError, match=said):
        plan_runs(tmp_path / name, 1, ("random",), SHORT)


def test_a_stored_landscape_is_read_once(tmp_path):
    path = write_bank(tmp_path)
    assert read_landscape(path, 1) is read_landscape(path, 1)
    assert read_landscape(path, 0).name != read_landscape(path, 1).name


def test_the_loop_as_discovered_is_either_loop_as_often_as_sealed_worlds_say():
    runs = [
        made_up(name, seed, (10.0, best_n))
        for seed in range(400)
        for name, best_n in ((LOOP[THETA], 15.0), (LOOP[EFFECT], 19.0))
    ]
    found = [run for run in with_discovery(runs) if run.strategy == LOOP_DISCOVERED]
    assert len(found) == 400
    assert np.mean([run.best_n[-1] == 19.0 for run in found]) == pytest.approx(NAMED_SHARE, abs=0.07)
