"""A panel that is not measured yet is rehearsed, and what it needs is simulated for the search to come."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from fast.flows.cli.main import app
from fast.flows.gap import plan
from fast.flows.gap.plan import look_ahead
from fast.flows.progress import ProgressReporter
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.models.gap.data import GapData
from fast.models.gap.evidence.rehearsal import Rehearsal, Rehearsed
from fast.models.gap.evidence.trials import Signs
from fast.models.gap.evidence.visible import VisibleSize, _is_alike
from fast.models.records import EffectValue
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.scientist.propose import draw_first_designs, propose_initial_tools
from fast.tasks.simulation.plan import SimulationPlan
from tests.flows.cli.cli_lakes import Fast
from tests.tasks.calibration.trace_lake import PROVENANCE
from tests.tasks.gap.gap_lake import plan_rows

CONFIG = """name = "ahead"
seed = 4
[schedule]
initial_tools = 4
tools_per_batch = 4
[objects]
ids = [1, 14, 22, 30]
repeats = 2
[bench]
kind = "folder"
"""
SILENT = ProgressReporter(lambda _: None, lambda _: None)


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A campaign, made-up answers in the place of finite elements, and worlds that are there."""
    seen: list[GapData] = []

    def simulate(lake: Lake, plans: Sequence[SimulationPlan], *_: Any) -> None:
        lake.append(plan_rows(plans), PROVENANCE)

    def rehearse(data: GapData, *_: Any) -> Rehearsal:
        seen.append(data)
        assert data.usable.grasps.steps_n.shape == (3 * 3 * 2, 120)
        return Rehearsal.of([Rehearsed("listed", Signs(10.0 * n, 1.0), size=0.01 * n) for n in range(1, 21)])

    monkeypatch.setattr(plan, "simulate_missing", simulate)
    monkeypatch.setattr(plan, "rehearse_panel", rehearse)
    path = tmp_path / "ahead.toml"
    path.write_text(CONFIG)
    return path


def test_a_panel_says_what_it_will_tell_and_what_one_less_would_cost(config: Path, tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    outlook = look_ahead(lake, config, 3, 3, 20, 1, SILENT)
    assert (len(outlook.tools), len(outlook.objects), outlook.repeats) == (3, 3, 2)
    assert outlook.sentence == f"3 tools on 3 objects, 2 times each. {outlook.rehearsal.describe_seen_size()}"
    by_name = {one.planned.effect: one for one in outlook.sizes}
    offset = by_name["load_cell_offset"]
    assert offset.planned.value is not None
    assert offset.fewer_objects.value is not None
    sizes = [abs(one.value.parameters["offset_n"]) for one in offset[:2] if one is not None and one.value is not None]
    assert sizes[0] < sizes[1]
    for size in outlook.sizes:  # of the same sign and shape, or they say nothing
        for less in (size.fewer_objects, size.fewer_tools, size.if_measured):
            known = size.planned.value
            assert less is None or known is None or less.value is None or _is_alike(less.value, known)
    gains = [
        size.planned.share / size.if_measured.share
        for size in outlook.sizes
        if size.if_measured is not None and size.planned.share is not None and size.if_measured.share is not None
    ]
    assert min(gains) >= 1.0
    assert max(gains) > 1.05  # a person's number is evidence, too


def test_a_size_says_all_that_it_holds_for() -> None:
    parameters = {"backlash_mm": 0.05, "ramp_s": 0.2, "ramp_power": 1.0}
    both = VisibleSize("lift_start_error", EffectValue(effect="lift_start_error", parameters=parameters))
    assert both.words == "backlash 0.05 mm, ramp 0.2 s, ramp power 1"


def test_a_panel_that_nobody_gave_a_size_is_no_larger_than_the_campaign(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = Rehearsal.of([Rehearsed("listed", Signs(10.0 * n, 1.0), size=0.01 * n) for n in range(1, 21)])
    monkeypatch.setattr(plan, "rehearse_panel", lambda *_: seen)
    outlook = look_ahead(Lake.open(tmp_path / "lake", create=True), config, None, None, 20, 1, SILENT)
    assert (len(outlook.tools), len(outlook.objects)) == (4, 4)


def test_a_plan_that_cannot_be_made_makes_no_lake(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Fast(capsys).refused("gap", "plan", tmp_path / "none.toml", "--lake", tmp_path / "lake")
    Fast(capsys).refused("gap", "plan", config, "--tools", "99", "--lake", tmp_path / "lake")
    assert not (tmp_path / "lake").exists()


def test_the_bank_is_that_of_the_tools_that_the_campaign_will_print(config: Path, tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    campaign = Campaign(lake, load_config(config), config_path=config)
    drawn = draw_first_designs(campaign)
    propose_initial_tools(campaign)
    printed = {tool.design.design_id for tool in campaign.state().tools}
    assert printed == {design.design_id for design in drawn}


def test_a_panel_that_the_campaign_does_not_have_is_refused(config: Path, tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    with pytest.raises(UsageError, match="a panel of 5 tools cannot be rehearsed: the campaign begins with 4"):
        look_ahead(lake, config, 5, 3, 20, 1, SILENT)
    with pytest.raises(UsageError, match="a panel of 1 object cannot be rehearsed"):
        look_ahead(lake, config, 3, 1, 20, 1, SILENT)


def test_the_command_prints_what_is_seen_and_taken_for_what(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    app(
        ["gap", "plan", str(config), "--lake", str(tmp_path / "lake"), "--tools", "3", "--objects", "3", "--json"],
        result_action="return_value",
    )
    told = json.loads(capsys.readouterr().out)
    assert told["summary"].startswith("3 tools on 3 objects")
    assert {"effect", "seen from", "of the force", "an object less", "a tool less", "if measured"} == set(
        told["sizes"][0]
    )
