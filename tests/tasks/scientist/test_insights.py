"""What a campaign of the lake has taught: cards, advice after each batch, and an end by itself."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from fast.flows.campaign.status import format_status, read_status
from fast.lake.tables.campaign import CampaignRow, EventRow, GraspRow
from fast.models.scientist.insights.cards import Card
from fast.models.scientist.insights.stopping import BatchAhead, Outlook
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.settings import Schedule
from fast.tasks.scientist.backtest import backtest
from fast.tasks.scientist.insights.advice import ADVICE, Advice, describe_stop, has_stopped, note_advice, read_advice
from fast.tasks.scientist.insights.facts import read_cost, read_facts
from fast.tasks.scientist.insights.insights import Insights, find_insights
from fast.tasks.scientist.observe import observe
from fast.tasks.scientist.propose import propose_guided, propose_initial
from tests.tasks.campaign.small_campaign import begun, small_campaign
from tests.tasks.simulation.made_up import append_grasp

SCHEDULE = {
    "initial_tools": 12, "tools_per_batch": 6, "guided_batches": 3, "initial_simulations": 0,
    "simulations_per_batch": 0,
}  # fmt: skip


def measured(folder: Path, **schedule) -> Campaign:
    """Twelve tools: lower fingers hold more, on object 4 alone."""
    campaign = small_campaign(
        folder, schedule={**SCHEDULE, **schedule}, objects={"ids": [4, 7, 30, 31], "repeats": 2, "order": "fixed"},
        simulator={"simulate_tools": False},
    )  # fmt: skip
    propose_initial(campaign)
    for batch in (1, 2):
        confirm_print(campaign.lake, "small", batch, PrintConfirmation(operator="ada"))
    rng = np.random.default_rng(0)
    for tool in campaign.state().tools:
        for object_id, repeat in campaign.config.objects.list_grasps(0):
            low = (120.0 - tool.design.height_mm) if object_id == 4 else 0.0
            append_grasp(campaign, tool, object_id, repeat, 20.0 + low + 0.1 * rng.normal())
    return campaign


@pytest.fixture(scope="module")
def campaign(tmp_path_factory) -> Campaign:
    return measured(tmp_path_factory.mktemp("insights"))


@pytest.fixture(scope="module")
def found(campaign: Campaign) -> Insights:
    return find_insights(campaign)


def test_the_parameter_that_matters_is_told(found: Insights) -> None:
    (outcome,) = found.outcomes
    first = outcome.effects[0]
    assert (found.n_tools, outcome.outcome, first.parameter) == (12, "mean_peak_n", "height_mm")
    # 30 N on one object of four; 128 worlds know the ends of an interval of 3 N to half a N.
    assert first.size.low - 0.5 <= 7.5 <= first.size.high + 0.5
    assert any(card.sentence.startswith("Height: less is better") for card in found.cards)
    assert Insights.model_validate_json(found.model_dump_json()) == found


def test_classes_tell_where_it_matters(found: Insights) -> None:
    sizes = {one.object_class: one.sizes["height_mm"] for one in found.outcomes[0].classes}
    strongest = max(sizes, key=lambda name: sizes[name].middle)
    assert strongest == "cylinder"  # of both objects, 30 N on one of them
    assert sizes[strongest].low < 15.0 < sizes[strongest].high + 1.0
    assert all(abs(size.middle) < 3.0 for name, size in sizes.items() if name != strongest)


def test_one_object_that_decides_everything_is_a_red_card(campaign: Campaign, found: Insights) -> None:
    facts = read_facts(campaign, campaign.state(), None)
    assert (facts.object_share, facts.n_objects, facts.n_grasps, facts.n_failed) == (
        pytest.approx(1.0, abs=0.02), 4, 96, 0,
    )  # fmt: skip
    assert facts.repeats_share == pytest.approx(0.0, abs=0.05)
    card = next(card for card in found.cards if card.name == "objects")
    assert card.tone == "red"
    assert "worst_peak_n" in card.next_step


def test_a_batch_costs_what_batches_took(campaign: Campaign) -> None:
    cost = read_cost(campaign, campaign.state())
    assert cost.n_tools == 6
    assert cost.material_g is not None
    assert cost.material_g > 100.0


def test_what_was_taken_back_did_not_fail_and_a_virtual_bench_has_no_time(tmp_path: Path) -> None:
    campaign = begun(small_campaign(tmp_path))
    tool = campaign.state().tools[0]
    started = datetime(2026, 3, 3, 9, tzinfo=UTC)
    rows = campaign.lake.records(GraspRow, tool_id=tool.tool_id, object_id=4)
    rows = [row.model_copy(update={"started_at": started + timedelta(hours=row.repeat)}) for row in rows]
    gone = {"status": "failed", "details_json": '{"taken_back_by":"ada"}'}
    campaign.lake.append([rows[0].model_copy(update=gone), *rows[1:]], campaign.provenance())
    facts = read_facts(campaign, campaign.state(), None)
    assert facts.n_failed == 0
    assert read_cost(campaign, campaign.state()).bench_h is None
    campaign.lake.append([row.model_copy(update={"bench": "real"}) for row in rows], campaign.provenance())
    assert read_cost(campaign, campaign.state()).bench_h == 1.0


def test_too_few_tools_say_how_many_it_takes(tmp_path: Path) -> None:
    found = find_insights(begun(small_campaign(tmp_path)))
    assert found.outlook is None
    assert found.cards[0].sentence == "2 tools are measured; advice takes 3 at least, and an effect 10."


def test_advice_is_kept_once_a_batch_and_shown_in_the_status(tmp_path: Path) -> None:
    campaign = store_config(measured(tmp_path))
    assert read_status(campaign.lake, "small")["advice"] is None
    advice = note_advice(campaign)
    assert advice is not None
    assert note_advice(campaign) == advice
    assert read_advice(campaign.lake, "small") == [advice]
    assert len(campaign.lake.records(EventRow, kind=ADVICE)) == 1
    status = read_status(campaign.lake, "small")
    assert status["advice"] == advice.model_dump()
    lines = format_status(status | {"failures": 1}, "L").splitlines()
    assert lines[2].startswith("           1 attempt failed: fast sql --lake L ")
    assert status["failures"] == 0
    assert f"next batch after B02: {advice.sentence}" in lines
    assert any(line.startswith("health     red: ") for line in lines)


def store_config(campaign: Campaign) -> Campaign:
    """The campaign, with its config in the lake."""
    schedule = ", ".join(f"{name} = {value}" for name, value in SCHEDULE.items())
    text = (
        f'name = "small"\nbench = {{world = "world.toml"}}\nschedule = {{{schedule}}}\n'
        "objects = {ids = [4, 7, 30, 31], repeats = 2}\n"
    )
    campaign.lake.append([CampaignRow(campaign_id="small", name="small", config_toml=text)], campaign.provenance())
    return campaign


def test_nobody_who_wants_no_advice_gets_any(tmp_path: Path) -> None:
    campaign = measured(tmp_path, stop="never")
    assert note_advice(campaign) is None
    assert campaign.lake.records(EventRow, kind=ADVICE) == []


def said(campaign: Campaign, *chances: float) -> Campaign:
    for batch, chance in enumerate(chances, start=3 - len(chances)):
        advice = Advice(after_batch=batch, chance=chance, sentence="", health="", tone="green")
        append_event(campaign.lake, "small", ADVICE, "", **advice.model_dump())
    return campaign


@pytest.mark.parametrize(
    ("stop", "chances", "ends"),
    [
        ("by itself", (0.015, 0.01), True),
        ("by itself", (0.3, 0.015), False),
        ("by itself", (0.015,), False),
        ("by itself", (0.015, 0.3), False),
        ("advice", (0.015, 0.01), False),
        ("by itself", (0.05, 0.015), False),
    ],
)
def test_a_campaign_ends_by_itself_after_two_batches_that_say_no(tmp_path: Path, stop, chances, ends) -> None:
    campaign = said(measured(tmp_path, stop=stop), *chances)
    assert has_stopped(campaign) is ends
    assert has_stopped(campaign, 1) is ends
    assert has_stopped(campaign, 0) is False  # its tools are there
    if ends:
        assert "was 2 % and 1 % after the last 2 batches" in describe_stop(campaign)


def test_the_end_is_no_part_of_what_decides_results() -> None:
    hashes = {
        small_hash(Schedule(**SCHEDULE, stop=stop, stop_margin=margin))
        for stop, margin in (("advice", 0.05), ("by itself", 0.05), ("never", 0.2))
    }
    assert len(hashes) == 1


def small_hash(schedule: Schedule) -> str:
    from fast.tasks.campaign.config import CampaignConfig

    return CampaignConfig.model_validate(
        {"name": "small", "seed": 3, "schedule": schedule, "bench": {"world": "world.toml"}}
    ).config_hash


def test_advice_is_the_sentence_of_the_card() -> None:
    from fast.tasks.scientist.insights.advice import make_advice

    outlook = Outlook(margin=0.05, best_n=20.0, ahead=(BatchAhead(chance=0.04, gain_n=0.0),), n_tools=6)
    cards = (
        Card(topic="stop", name="next batch", sentence="It is 4 %.", next_step="Stop printing."),
        Card(topic="health", name="drift", tone="yellow", sentence="It drifts.", next_step="Look."),
    )
    advice = make_advice(Insights(campaign_id="small", n_tools=12, cards=cards, outlook=outlook), 2)
    assert (advice.sentence, advice.tone, advice.health) == ("Stop printing. It is 4 %.", "yellow", "It drifts.")
    assert not advice.is_end


def test_strategies_are_replayed_on_the_campaign(campaign: Campaign) -> None:
    rows = backtest(campaign, 1, lambda line: None)
    assert [(row["objective"], row["strategy"], row["n_batch"]) for row in rows] == [
        ("mean_peak_n", "random", 6), ("mean_peak_n", "measured only", 6),
        ("mean_peak_n", "random", 3), ("mean_peak_n", "measured only", 3),
    ]  # fmt: skip
    assert all(0.5 < row["share"] <= 1.0 for row in rows)


def test_what_is_taught_without_simulations_is_told_while_the_next_batch_hangs(tmp_path: Path) -> None:
    """The fit behind a proposed batch is in the lake, and has no numbers of simulations."""
    campaign = measured(tmp_path)
    propose_guided(campaign, 3)
    state = campaign.state()
    facts = read_facts(campaign, state, fit_surrogate(observe(campaign, state, (1, 2))))
    assert facts.surrogate is not None
    assert (facts.surrogate.n_sim, facts.surrogate.sim_loo_rmse_n) == (0, None)
    assert facts.surrogate.loo_rmse_n is not None
    assert find_insights(campaign).outlook is not None
