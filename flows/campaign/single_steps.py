"""Single steps of a campaign by themselves: measure one batch, or simulate what is owed."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fast.flows.campaign.process import keep_physics, open_campaign_bench
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.models.errors import FastError
from fast.models.units import spell_count
from fast.tasks.bench.measure import BenchUse
from fast.tasks.campaign import prefect_tasks as steps
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import load_config, world_path
from fast.tasks.campaign.prefect_tasks import unmapped
from fast.tasks.campaign.requests import lease_name, require_acknowledgement
from fast.tasks.campaign.setup import enter, read_world
from fast.tasks.campaign.simulator_versions import at_present
from fast.tasks.scientist.observe import proposed_designs, unfinished_tools
from fast.tasks.simulation.pool import WorkerPool


def measure_one_batch(config_path: Path, lake: str, batch: int) -> str:
    """Make the missing grasps of a confirmed batch on the virtual bench; a sentence says how many.

    Raises:
        FastError: the campaign runs, the batch is not confirmed, or the bench stopped.
    """
    with _held_campaign(config_path, lake) as campaign:
        state, name = campaign.state(), f"{campaign.campaign_id} B{batch:02d}"
        if not state.is_confirmed(batch):
            raise FastError(f"batch {name} is not confirmed; say what became of it with `fast print confirm` first.")
        tools = unfinished_tools(campaign, state, batch)
        if not tools:
            return f"nothing is missing of {name}"
        world = read_world(world_path(config_path, campaign.config))
        physics = WorkerPool(campaign.config.execution.physics_workers)
        try:
            use = BenchUse(
                lambda mounted: open_campaign_bench(campaign, world, keep_physics(campaign, physics), mounted),
                world.world_hash,
            )
            steps.measure_batch(f"B{batch:02d}", unmapped(campaign), unmapped(tools), unmapped(use))
        finally:
            physics.close()
        return f"{spell_count(len(tools), 'tool')} of {name} measured"


def simulate_missing(config_path: Path, lake: str) -> str:
    """Simulate the proposed designs of a campaign on the objects they miss; a sentence says how many.

    Raises:
        FastError: the campaign runs.
    """
    with _held_campaign(config_path, lake) as campaign:
        state = campaign.state()
        not_owed = {s.design.design_id for s in state.night}  # a night simulates what its time allows
        designs = {key: d for key, d in proposed_designs(state).items() if key not in not_owed}
        owed = [d for key, d in designs.items() if state.missing_objects(key, campaign.object_ids)]
        pool = WorkerPool(campaign.config.execution.simulation_workers)
        try:
            jobs = [
                steps.simulate_design.submit(
                    f"simulated design {number} of {len(owed)}",
                    unmapped(campaign),
                    unmapped(design),
                    unmapped(pool),
                    unmapped(lambda: False),
                )
                for number, design in enumerate(owed, start=1)
            ]
            n_failed = sum(job.result() for job in jobs)
        finally:
            pool.close()
        simulated = f"{spell_count(len(owed), 'design')} of {campaign.campaign_id} simulated"
        return f"{simulated}, {spell_count(n_failed, 'grasp')} failed"


@contextmanager
def _held_campaign(config_path: Path, lake: str) -> Iterator[Campaign]:
    """Hold a campaign of the lake that no other process runs meanwhile."""
    campaign = Campaign(Lake.open(lake), load_config(config_path))
    name = campaign.campaign_id
    with exclusive(campaign.lake.storage, lease_name(name), f"campaign {name} is being run"):
        require_acknowledgement(campaign.lake, name, False)
        enter(campaign, config_path)
        yield at_present(campaign)
