"""Strategies as whole campaigns, with grasps that cost nothing: budgets, equal beginnings, kills, the paper's table."""

import tomllib
from functools import partial
from itertools import count

import numpy as np
import pytest

from fast.flows.campaign.status import read_status
from fast.flows.scientist import campaign_runs as campaigns
from fast.flows.scientist.campaign_runs import (
    BASELINE,
    STRATEGIES,
    PlannedCampaign,
    StrategyRun,
    run_campaigns,
    toml_of,
)
from fast.flows.scientist.campaign_table import campaign_rows, campaigns_figure, paired_campaign_rows
from fast.hardware.virtual.world.file import Scatter, World
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, FitRow, GraspRow, ProposalRow, SimulationRow
from fast.models.design.space import to_unit
from fast.models.records import EffectValue
from fast.models.scientist.surrogate.observations import SIM
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.scientist.fit import fitted_before
from fast.tasks.scientist.observe import observe
from fast.tasks.scientist.simulation_only import as_target
from tests.flows.cli.cli_lakes import Fast, write_config
from tests.studies.benchmarks.fingerprints import fingerprint
from tests.tasks.simulation.made_up import append_grasp, append_simulation

CONFIG = CampaignConfig.model_validate(
    {
        "name": "small",
        "seed": 1,
        "schedule": {
            "initial_tools": 3,
            "tools_per_batch": 3,
            "guided_batches": 1,
            "initial_simulations": 4,
            "simulations_per_batch": 2,
        },
        "objects": {"ids": [4, 7], "repeats": 1},
        "bench": {"world": "world.toml"},
    }
)


def simulated_n(design) -> float:
    return float(10.0 + 5.0 * to_unit([design])[0] @ np.arange(9.0) / 9.0)


def made_up_simulation(campaign: Campaign, design, *, pool) -> int:
    for object_id in campaign.state().missing_objects(design.design_id, campaign.object_ids):
        append_simulation(campaign, design, object_id, simulated_n(design) + object_id)
    return 0


def made_up_batch(campaign: Campaign, tools, use) -> None:
    """The gantry's part, at once: half the simulated force less a penalty, and some noise."""
    for tool in tools:
        for object_id, repeat in campaign.state().missing_grasps(tool, campaign.config.objects.list_grasps(0), 1):
            noise = np.random.default_rng([campaign.config.seed, tool.batch, tool.slot, object_id]).normal(0, 0.2)
            force_n = 0.5 * simulated_n(tool.design) - 3.0 * to_unit([tool.design])[0, 8] + object_id + noise
            append_grasp(campaign, tool, object_id, repeat, force_n)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, tuple[PlannedCampaign, StrategyRun]]:
    """The paper's strategies, run to their end without worker process, finite elements or bench."""
    plan = [planned_campaign(tmp_path_factory.mktemp("whole"), name) for name in STRATEGIES]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaigns, "simulate_design", made_up_simulation)
        patch.setattr(campaigns, "measure_batch", made_up_batch)
        runs = run_campaigns(plan, lambda line: None)
    return {planned.strategy.name: (planned, run) for planned, run in zip(plan, runs, strict=True)}


def planned_campaign(folder, name: str, seed: int = 1) -> PlannedCampaign:
    return PlannedCampaign(STRATEGIES[name], seed, CONFIG, World(), folder)


def lake_of(planned: PlannedCampaign) -> Lake:
    return Lake.open(planned.lake_folder)


def proposals(planned: PlannedCampaign) -> list[tuple]:
    rows = lake_of(planned).rows(ProposalRow)
    return sorted((r["batch"], r["fidelity"], r["index"], r["design_id"], r["acquisition"]) for r in rows)


def grasps(planned: PlannedCampaign) -> dict[str, float]:
    return {r["grasp_id"]: r["peak_force_n"] for r in lake_of(planned).rows(GraspRow)}


def test_every_strategy_keeps_its_budget_and_all_begin_alike(whole):
    runs = {name: run for name, (_, run) in whole.items()}
    assert {name: (c.n_measured, c.n_simulated) for name, c in runs.items()} == {
        "random": (6, 0),
        "simulation only": (3, 6),
        "measured only": (6, 0),
        BASELINE: (6, 6 + 6),
    }
    first = {name: [p for p in proposals(r) if p[0] == 1] for name, (r, _) in whole.items()}
    assert [p for p in first[BASELINE] if p[1] == "real"] == first["random"] == first["measured only"]
    assert [p for p in first[BASELINE] if p[1] == "sim"] == first["simulation only"]
    assert runs["random"].batches_n[0] == runs[BASELINE].batches_n[0]  # the same draws of scatter and noise
    assert runs["random"].best_n[0] <= runs["random"].best_n[-1]


def test_simulation_alone_climbs_and_prints_what_simulated_best(whole):
    planned, _ = whole["simulation only"]
    lake = lake_of(planned)
    designs = {row.design_id: row.design for row in lake.records(DesignRow)}
    rows = lake.rows(ProposalRow)
    ranked = sorted({r["design_id"] for r in rows if r["fidelity"] == "sim"}, key=lambda i: -simulated_n(designs[i]))
    printed = [r["design_id"] for r in sorted(rows, key=lambda r: r["index"]) if r["fidelity"] == "real"]
    assert printed == ranked[:3]
    assert {r["acquisition"] for r in rows} == {"random", "ei", "best_simulated"}
    by_rule = {rule: [simulated_n(designs[r["design_id"]]) for r in rows if r["acquisition"] == rule]
               for rule in ("random", "ei")}  # fmt: skip
    assert np.mean(by_rule["ei"]) > max(by_rule["random"])
    # The surrogate that improvement is sought with is that of the simulations, at the fidelity that is sought.
    campaign = Campaign(lake, planned.own_config)
    data = observe(campaign, campaign.state(), ())
    surrogate = fitted_before(lake.rows(FitRow)[-1], data)
    points = to_unit(list(designs.values()))
    np.testing.assert_allclose(as_target(surrogate).mean(points, 1), surrogate.mean(points, SIM), rtol=1e-5)


@pytest.mark.parametrize("name", [BASELINE, "simulation only"])
def test_a_killed_comparison_goes_on_to_the_same_end(tmp_path, monkeypatch, whole, name):
    uninterrupted, expected = whole[name]
    killed = planned_campaign(tmp_path, name)

    def dying(step, calls, at, *arguments, **options):
        if next(calls) in at:
            raise KeyboardInterrupt
        return step(*arguments, **options)

    monkeypatch.setattr(campaigns, "simulate_design", partial(dying, made_up_simulation, count(), (3, 9)))
    monkeypatch.setattr(campaigns, "measure_batch", partial(dying, made_up_batch, count(), (0, 2)))
    n_kills = 0
    while True:
        try:
            assert run_campaigns([killed], lambda line: None) == [expected]
            break
        except KeyboardInterrupt:
            n_kills += 1
    assert n_kills == (4 if name == BASELINE else 2)
    assert proposals(killed) == proposals(uninterrupted)
    assert grasps(killed) == grasps(uninterrupted)
    n_rows = [len(lake_of(planned).rows(SimulationRow)) for planned in (uninterrupted, killed)]
    assert n_rows[0] == n_rows[1]


def test_side_by_side_measures_the_same_in_the_order_of_the_plan(whole):
    """Campaigns that are done: processes only read them, and nothing is simulated."""
    known = [whole[name] for name in (BASELINE, "random")]
    lines: list[str] = []
    assert run_campaigns([planned for planned, _ in known], lines.append, n_workers=2) == [run for _, run in known]
    said = [line.partition("|")[2].strip() for line in lines]
    assert said[0].startswith("1 of 2 campaigns, ")
    assert said[1] == "2 of 2 campaigns, 0 s left"


def test_on_the_bench_seeds_differ_in_noise_and_strategies_do_not(tmp_path, monkeypatch):
    """Three tools on the virtual bench, grasps that cost nothing."""
    solved = []
    monkeypatch.setattr(campaigns, "_solve", lambda pool, request: solved.append(request) or fingerprint(request))
    schedule = CONFIG.schedule.model_copy(update={"guided_batches": 0})
    config = CONFIG.model_copy(update={"schedule": schedule})
    world = World(scatter=Scatter(repeat_sd=0.02))
    plan = [PlannedCampaign(STRATEGIES[name], seed, config, world, tmp_path)
             for name, seed in (("random", 1), ("measured only", 1), ("random", 2))]  # fmt: skip
    run_campaigns(plan, lambda line: None)
    one, same, other = (grasps(planned) for planned in plan)
    assert len(one) == 3 * 2
    assert one == same
    assert one.keys() == other.keys()
    assert all(one[grasp_id] != other[grasp_id] for grasp_id in one)
    assert len(solved) == 2 * 6  # the second strategy finds what the first has solved
    assert {planned.own_world.theta for planned in plan} == {world.theta}


def test_a_config_survives_as_toml():
    effects = (EffectValue(effect="load_cell_gain", parameters={"gain": 1.1}),)
    simulator = CONFIG.simulator.model_copy(update={"effects": effects})
    for grasp in ({}, {"closed_gap_mm": 16}):
        given = CONFIG.model_dump(mode="json", exclude_unset=True) | {"grasp": grasp}
        config = CampaignConfig.model_validate(given).model_copy(update={"simulator": simulator})
        again = CampaignConfig.model_validate(tomllib.loads(toml_of(config)))
        assert again == config
        assert again.grasp.setup_id == config.grasp.setup_id  # by which what is simulated is found
        assert again.simulator.version.version_id == config.simulator.version.version_id


def test_the_lake_of_a_strategy_is_a_campaign_like_any_other(whole):
    planned, run = whole[BASELINE]
    status = read_status(lake_of(planned), "small")
    assert (status["grasps"], status["simulated"]) == ("12/12", "24/24")
    assert status["best_n"] == pytest.approx(run.best_n[-1])


def made_up(strategy: str, seed: int, *batches_n: tuple[float, ...]) -> StrategyRun:
    return StrategyRun(strategy, seed, batches_n, 7, 1.0)


def test_table_and_picture_are_of_last_batches_and_best_tools():
    runs = [
        made_up(BASELINE, 1, (10.0, 12.0), (18.0, 20.0)),
        made_up(BASELINE, 2, (10.0, 13.0), (15.0, 11.0)),
        made_up("random", 1, (10.0, 12.0), (12.0, 11.0)),
        made_up("random", 2, (10.0, 13.0), (16.0, 15.0)),
        made_up("simulation only", 1, (18.0, 9.0)),
    ]
    summary = {row["strategy"]: row for row in campaign_rows(runs)}
    assert (summary[BASELINE]["last_batch_n"], summary[BASELINE]["best_n"]) == (16.0, 17.5)
    assert summary[BASELINE]["last_batch_sd_n"] == pytest.approx(np.sqrt((2.0 + 8.0) / 2))
    assert (summary[BASELINE]["best_of_all_n"], summary[BASELINE]["n_measured"]) == (20.0, 4)
    paired = {row["strategy"]: row for row in paired_campaign_rows(runs, BASELINE)}
    assert (paired["random"]["n_pairs"], paired["random"]["best_wins"]) == (2, 1)
    assert paired["random"]["last_batch_gain_n"] == pytest.approx((-7.5 + 2.5) / 2)
    assert (paired["random"]["best_gain_n"], paired["random"]["best_gain_median_n"]) == (-3.5, -3.5)
    low, high = (float(end) for end in paired["random"]["best_gain_ci95_n"].split(" to "))
    half = 12.706 * np.std([-8.0, 1.0], ddof=1) / np.sqrt(2)  # Student's t of one degree of freedom
    assert (low, high) == pytest.approx((-3.5 - half, -3.5 + half), abs=0.01)
    assert paired["simulation only"]["best_gain_ci95_n"] is None
    assert (paired["simulation only"]["n_pairs"], paired["simulation only"]["best_gain_n"]) == (1, -2.0)
    left, right = campaigns_figure(runs, BASELINE).axes
    assert {BASELINE, "random", "simulation only"} <= {line.get_label() for line in left.get_lines()}
    assert left.get_xticks().tolist() == [2, 4]
    assert [label.get_text() for label in right.get_yticklabels()] == ["simulation only", "random", BASELINE]


def test_the_command_compares_campaigns_and_knows_its_strategies(capsys, tmp_path, monkeypatch):
    fast, config = Fast(capsys), write_config(tmp_path)
    compared: list[tuple[str, int]] = []

    def run(plan, tell, n_workers):
        assert n_workers == 2
        compared.extend((r.strategy.name, r.seed) for r in plan)
        return [made_up(r.strategy.name, r.seed, (10.0, 12.0), (13.0, 14.0 + r.seed)) for r in plan]

    monkeypatch.setattr(campaigns, "run_campaigns", run)
    picture = tmp_path / "c.png"
    answer = fast("compare", config, "--races", "2", "--workers", "2", "--figure", picture, "--json")
    assert compared == [(name, seed) for seed in (1, 2) for name in STRATEGIES]
    assert [row["best_n"] for row in answer.json["strategies"]] == [15.5] * 4
    assert answer.json["campaigns"][0] == {
        "strategy": "random", "seed": 1, "batches_n": [[10.0, 12.0], [13.0, 15.0]], "n_simulated": 7,
        "simulation_cpu_s": 1.0,
    }  # fmt: skip
    assert picture.stat().st_size > 10_000
    said = fast.refused("compare", config, "--strategies", "randon")
    assert "There is no strategy `randon`; did you mean `random`?" in said
