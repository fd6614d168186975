"""A batch of tools for studies of the bench: confirmed on a lake of its own, measured with made-up grasps."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fast.hardware.bench import Bench, open_virtual_bench
from fast.hardware.station.station import MeasuredGrasp
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import World
from fast.lake.store import Lake
from fast.tasks.bench.measure import BenchUse, OpenBench, measure_batch
from fast.tasks.bench.print import PrintConfirmation, confirm_print
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.state import ProposedTool
from fast.tasks.scientist.observe import unfinished_tools
from fast.tasks.scientist.propose import propose_initial
from tests.studies.benchmarks.fingerprints import Label, fingerprint

CAMPAIGN_ID = "study"


@dataclass(frozen=True)
class Batch:
    """What is measured: one tray of tools, each on these objects, so many times."""

    n_tools: int
    object_ids: tuple[int, ...]
    n_repeats: int

    @property
    def config(self) -> CampaignConfig:
        """The campaign of this batch alone."""
        schedule = {
            "initial_tools": self.n_tools,
            "tools_per_batch": self.n_tools,
            "initial_simulations": 0,
            "guided_batches": 0,
        }
        objects = {"ids": self.object_ids, "repeats": self.n_repeats, "order": "random"}
        data = {"name": CAMPAIGN_ID, "schedule": schedule, "objects": objects, "bench": {"world": ""}}
        return CampaignConfig.model_validate(data)

    @property
    def labels(self) -> list[Label]:
        """Every grasp that the batch needs."""
        tools = [f"{CAMPAIGN_ID}/B01T{slot}" for slot in range(self.n_tools)]
        return [(tool, o, repeat) for tool in tools for o in self.object_ids for repeat in range(self.n_repeats)]

    def open(self, root: Path) -> Campaign:
        """The campaign on the lake at `root`, which must be there."""
        return Campaign(Lake.open(root), self.config)

    def make(self, root: Path) -> Campaign:
        """The campaign on a new lake, its tools proposed and confirmed as printed."""
        campaign = Campaign(Lake.open(root, create=True), self.config)
        propose_initial(campaign)
        word = PrintConfirmation(operator="nobody", confirmed_by="auto")
        confirm_print(campaign.lake, CAMPAIGN_ID, 1, word)
        return campaign


def rack_of(tools: Sequence[ProposedTool]) -> dict[int, MountedTool]:
    """The tools by slot, as a bench is told of them."""
    return {tool.slot: MountedTool(tool.tool_id, tool.design) for tool in tools}


def lockstep_bench(world: World, mounted: Sequence[ProposedTool]) -> AbstractContextManager[Bench]:
    """A bench of this process, with made-up grasps."""
    return open_virtual_bench(world, rack_of(mounted), physics=fingerprint, wires="memory")


def measure_missing(
    campaign: Campaign,
    world: World,
    on_grasp: Callable[[ProposedTool, MeasuredGrasp], None],
    should_stop: Callable[[], bool] = lambda: False,
    open_bench: OpenBench | None = None,
) -> None:
    """What a campaign does with a confirmed batch: go on where the lake says it stands, in lockstep by default."""
    tools = unfinished_tools(campaign, campaign.state(), 1)
    if not tools:
        return
    opened = open_bench or partial(lockstep_bench, world)
    measure_batch(campaign, tools, BenchUse(opened, world.world_hash, should_stop, on_grasp))
