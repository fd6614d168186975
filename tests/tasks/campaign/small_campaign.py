"""A small campaign, for tests of tasks and of the flows over them."""

from pathlib import Path

from fast.lake.store import Lake
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.scientist.propose import propose_initial
from tests.tasks.simulation.made_up import append_grasp, append_simulation


def small_campaign(folder: Path, **sections: object) -> Campaign:
    """A campaign on an empty lake: two initial tools, one guided batch of two, two objects; more `sections`."""
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
            **sections,
        }
    )
    return Campaign(Lake.open(folder / "lake", create=True), config)


def begun(campaign: Campaign, **word) -> Campaign:
    """Initial tools printed (`word` of the person) and measured, they and the initial designs simulated."""
    propose_initial(campaign)
    confirm_print(campaign.lake, "small", 1, PrintConfirmation(operator="ada", **word))
    state = campaign.state()
    for number, tool in enumerate(state.tools):
        if state.confirmed[tool.tool_id] == "printed":
            for object_id, repeat in campaign.config.objects.list_grasps(0):
                append_grasp(campaign, tool, object_id, repeat, 10.0 + number + object_id)
    for number, design in enumerate([s.design for s in state.simulations] + [t.design for t in state.tools]):
        for object_id in campaign.object_ids:
            append_simulation(campaign, design, object_id, 5.0 + number)
    return campaign
