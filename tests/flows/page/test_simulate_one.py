"""One grasp simulated from the page: that of the campaign, with its scatter."""

from pathlib import Path

import pytest

from fast.flows.page.start import simulate_one
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.simulation.grasp import simulate_grasp
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config
from fast.tasks.campaign.setup import register
from fast.tasks.scientist.propose import propose_initial
from tests.flows.cli.cli_lakes import QUICK, write_config

OWN = """
[grasp]
closed_gap_mm = 30
max_lift_mm = 4
[tolerances]
wall_offset_mm = 0.05
offset_z_mm = 0
closed_gap_mm = 0
"""


@pytest.mark.parametrize("tool_id", ["nope", "other/B01T0"])
def test_a_tool_of_no_campaign_is_a_sentence(tmp_path: Path, tool_id: str) -> None:
    lake = Lake.open(tmp_path / "lake", create=True)
    with pytest.raises(UsageError, match=f"tool `{tool_id}` is of no campaign that this lake ran; name one like"):
        simulate_one(str(lake.root), tool_id, 2)


def test_it_is_the_grasp_of_the_campaign_and_says_how_prints_scatter(tmp_path: Path) -> None:
    text = QUICK + OWN
    campaign = Campaign(Lake.open(tmp_path / "lake", create=True), load_config(write_config(tmp_path, text)))
    register(campaign, text)
    propose_initial(campaign)
    tool = campaign.state().tools[0]
    found = simulate_one(str(campaign.lake.root), tool.tool_id, 2)
    alone = simulate_grasp(tool.design, get_object(2), campaign.version, campaign.config.grasp)
    assert found["peak_force_n"] == pytest.approx(alone.peak_force_n)
    assert max(found["traces"][0]["lift"]) <= 4.0
    assert 0.0 < found["peak_sd_n"] < 0.2 * found["peak_force_n"]
    assert found["sd_is_of"] == "wall offset 0.05 mm"
