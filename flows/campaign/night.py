"""The night before a guided batch: designs are simulated with a new simulator version, as far as time allows.

What is simulated was decided once (`tasks.campaign.simulator_versions`) and is in the lake, as is how long it took: a
campaign that was killed goes on where it was, and a night that has ended is not repeated.
"""

import time
from collections.abc import Sequence

from prefect import task
from prefect.cache_policies import NO_CACHE

from fast.flows.campaign.loops import CampaignRun, SimulationJob, SimulationLoop
from fast.flows.progress import describe_duration
from fast.models.records import Design
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.night_story import Night, count_worker_seconds, end_night, find_night
from fast.tasks.campaign.prefect_tasks import unmapped
from fast.tasks.campaign.simulator_versions import at_stage, list_reruns
from fast.tasks.campaign.state import CampaignState
from fast.tasks.gap.cost import GraspCosts


@task(task_run_name="{label}", cache_policy=NO_CACHE)
def choose_version(label: str, campaign: Campaign, stage: int) -> Campaign:
    """Give the campaign the simulator version of a stage; if it is new, what is simulated with it is chosen."""
    return at_stage(campaign, stage)


@task(task_run_name="{label}", cache_policy=NO_CACHE)
def close_night(label: str, campaign: Campaign, old: SimulatorVersion, stage: int) -> Night:
    """Write down what the night has done."""
    return end_night(campaign, old, stage)


def begin_night(run: CampaignRun, stage: int) -> "NightLoop | None":
    """Choose the version of a stage; the loop that simulates with it, or None if there is nothing to be done."""
    if stage == 0 or not run.campaign.config.night.active:
        run.campaign = at_stage(run.campaign, stage)
        return None
    label = f"night before B{run.campaign.config.schedule.batches_of(stage)[-1]:02d}"
    old = at_stage(run.campaign, stage - 1).version
    run.campaign = choose_version(label, unmapped(run.campaign), stage)
    if run.campaign.version == old or find_night(run.campaign, stage) is not None:
        return None
    return NightLoop(run, stage, old, list_reruns(run.campaign, stage))


class NightLoop(SimulationLoop):
    """Simulates designs in order, and proposes nothing; begins none when its time is over."""

    def __init__(self, run: CampaignRun, stage: int, old: SimulatorVersion, designs: Sequence[Design]) -> None:
        super().__init__(run, stage)
        self._budget, self._designs = 0, designs
        self._stage, self._old, self._ids = stage, old, [design.design_id for design in designs]
        config = run.campaign.config
        spent_s = count_worker_seconds(run.campaign, stage) / config.execution.simulation_workers
        self._ends_s = time.monotonic() + 3600.0 * config.night.max_hours - spent_s
        self._s_per_grasp = GraspCosts.read(run.campaign.lake).of(run.campaign.version)

    def say_plan(self) -> str:
        """Say what is about to be simulated, and how long that takes."""
        left_s = self._estimate_s(self._run.campaign.state())
        until = "how long is not known yet" if left_s is None else f"about {describe_duration(left_s)}"
        version_id = self._run.campaign.version.version_id
        return f"B{self._batch:02d}: up to {len(self._designs)} designs are simulated with {version_id}, {until}"

    def close(self) -> Night:
        """Write down what the night has done."""
        campaign = self._run.campaign
        return close_night(f"end of the night before B{self._batch:02d}", unmapped(campaign), self._old, self._stage)

    def _find_unfinished(self, state: CampaignState) -> SimulationJob | None:
        return super()._find_unfinished(state) if time.monotonic() < self._ends_s else None

    def _estimate_s(self, state: CampaignState) -> float | None:
        """Estimate the time left, in seconds, with all workers; None if no such grasp has been simulated."""
        if self._s_per_grasp is None:
            return None
        n_grasps = sum(len(state.missing_objects(i, self._run.campaign.object_ids)) for i in self._ids)
        work_s = n_grasps * self._s_per_grasp / self._n_workers
        return max(min(work_s, self._ends_s - time.monotonic()), 0.0)

    def _known(self, state: CampaignState) -> list[SimulationJob]:
        left_s = self._estimate_s(state)
        left = "" if left_s is None else f", about {describe_duration(left_s)} left"
        total = len(self._designs)
        return [
            SimulationJob(design, f"night design {n} of {total}{left}") for n, design in enumerate(self._designs, 1)
        ]
