"""A small campaign, for tests of tasks and of the flows over them."""

from pathlib import Path

from lake.store import Lake
from tasks.campaign.campaign import Campaign
from tasks.campaign.config import CampaignConfig


def small_campaign(folder: Path) -> Campaign:
    """A campaign on an empty lake: two initial tools, one guided batch of two, two objects."""
    config = CampaignConfig.model_validate(
        {
            "name": "small",
            "seed": 3,
            "schedule": {
                "initial_tools": 2,
                "tools_per_batch": 2,
                "guided_batches": 1,
                "initial_simulations": 2,
                "simulations_per_batch": 2,
            },
            "objects": {"ids": [4, 7], "repeats": 2, "order": "fixed"},
            "bench": {"world": "world.toml"},
        }
    )
    return Campaign(Lake.open(folder / "lake", create=True), config)
