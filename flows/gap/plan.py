"""What a panel that is not measured yet will be able to tell: rehearsed before a finger is printed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fast.flows.progress import ProgressReporter
from fast.flows.simulation.progress import n_missing, simulate_missing
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.models.gap.data import GapData
from fast.models.gap.evidence.likelihood import EvidenceFit, Problem, fit_evidence
from fast.models.gap.evidence.rehearsal import Rehearsal, rehearse_panel
from fast.models.gap.evidence.visible import VisibleSize, find_measured_size, find_visible_sizes
from fast.models.gap.grasps import Grasps, of_one_setup
from fast.models.records import Design, GraspContext
from fast.models.traces.step_features import N_STEPS
from fast.models.traces.step_noise import SensorNoise
from fast.models.units import spell_count
from fast.tasks.campaign.campaign import Campaign, read_own_designs
from fast.tasks.campaign.config import CampaignConfig, load_config
from fast.tasks.gap.bank import plan_bank, read_bank
from fast.tasks.gap.panel import spread_objects
from fast.tasks.scientist.propose import draw_first_designs

MOST_TOOLS, MOST_OBJECTS = 8, 6  # of a panel that nobody gave a size
LEAST_TOOLS, LEAST_OBJECTS = 2, 2  # of a panel: one fewer of either is compared with it
_GRASP_S = 30.0  # between grasps on the gantry, about: for effects that go by the clock
_NOISE = SensorNoise(sd_n=0.1, correlation_s=0.05, rate_hz=80.0)  # of a usual load cell: a bench's own is not known


class SizeOutlook(NamedTuple):
    """Size of an effect that a panel will show, that with one object, and one tool, less, and with a measurement.

    if_measured: None where the catalogue knows nothing that a person could measure of the effect.
    """

    planned: VisibleSize
    fewer_objects: VisibleSize
    fewer_tools: VisibleSize
    if_measured: VisibleSize | None


@dataclass(frozen=True, eq=False)
class PanelOutlook:
    """What a panel will tell. rehearsal: made-up worlds of it. sizes: of effects that it will show."""

    tools: tuple[str, ...]
    objects: tuple[int, ...]
    repeats: int
    rehearsal: Rehearsal
    sizes: tuple[SizeOutlook, ...]

    @property
    def sentence(self) -> str:
        """From what size on causes will be seen."""
        panel = f"{len(self.tools)} tools on {len(self.objects)} objects, {spell_count(self.repeats, 'time')} each"
        return f"{panel}. {self.rehearsal.describe_seen_size()}"


def look_ahead(
    lake: Lake,
    config_path: Path,
    n_tools: int | None,
    n_objects: int | None,
    n_worlds: int,
    n_workers: int,
    reporter: ProgressReporter,
) -> PanelOutlook:
    """Rehearse the first tools of a campaign on objects of as many classes as there are; nothing is measured.

    The bank of simulations around them goes into the lake, where the search of the campaign will find it.

    Raises:
        UsageError: the panel is too small, or the campaign has fewer tools or objects.
        ConfigError: the config is wrong.
        FastError: a simulation process died.
    """
    config = load_config(config_path)
    own_designs = read_own_designs(config_path, config)
    campaign = Campaign(lake, config, config_path=config_path, own_designs=own_designs)
    n_tools, n_objects = choose_size(config, n_tools, n_objects)
    objects = spread_objects(set(config.objects.object_ids))[:n_objects]
    grasps = _plan_grasps(campaign, draw_first_designs(campaign)[:n_tools], tuple(sorted(objects)))
    version = campaign.config.simulator.version.model_copy(update={"effects": ()})
    plans = plan_bank(version, grasps.cells)
    if n_missing(lake, plans):
        simulate_missing(lake, plans, n_workers, reporter)
    data = GapData.of_all(grasps, read_bank(lake, version, grasps.cells))
    rehearsal = rehearse_panel(data, (), n_worlds, n_workers, reporter.progress)
    last_object, last_tool = len(grasps.objects) - 1, len(grasps.tools) - 1
    fit, lines = _foresee(data, np.ones(len(grasps.tool), dtype=bool)), rehearsal.thresholds
    planned = find_visible_sizes(fit, data.usable.names, lines)
    less = [
        find_visible_sizes(_foresee(data, is_taken), data.usable.names, lines, planned)
        for is_taken in (grasps.obj != last_object, grasps.tool != last_tool)
    ]
    measured = [find_measured_size(fit, lines, size) for size in planned]
    return PanelOutlook(
        tools=grasps.tools,
        objects=grasps.objects,
        repeats=campaign.config.objects.repeats,
        rehearsal=rehearsal,
        sizes=tuple(map(SizeOutlook, planned, *less, measured)),
    )


def choose_size(config: CampaignConfig, n_tools: int | None, n_objects: int | None) -> tuple[int, int]:
    """Choose how many of the campaign's first tools, and objects, are rehearsed; None takes 8 and 6, or all.

    Raises:
        UsageError: the panel is too small, or the campaign has fewer tools or objects.
    """
    most_tools, most_objects = config.schedule.initial_tools, len(config.objects.object_ids)
    n_tools = min(MOST_TOOLS, most_tools) if n_tools is None else n_tools
    n_objects = min(MOST_OBJECTS, most_objects) if n_objects is None else n_objects
    for what, n, least, most in (
        ("tools", n_tools, LEAST_TOOLS, most_tools),
        ("objects", n_objects, LEAST_OBJECTS, most_objects),
    ):
        if not least <= n <= most:
            asked = spell_count(n, what.removesuffix("s"))
            raise UsageError(
                f"a panel of {asked} cannot be rehearsed: the campaign begins with {most}, {least} are the least; give "
                f"--{what} between these."
            )
    return n_tools, n_objects


def _foresee(data: GapData, is_taken: np.ndarray) -> EvidenceFit:
    """Foresee the fit of the grasps that are taken (n), at the middle of the bank and without noise."""
    usable = data.usable
    taken = usable.select(np.flatnonzero(is_taken[: len(usable.grasps.tool)]))
    problem = Problem.of(taken)
    centre = taken.centre
    theta = np.array([centre.young_modulus_mpa, centre.friction, centre.poisson_ratio])
    return fit_evidence(problem.measured(problem.predict_steps(theta, ())))


def _plan_grasps(campaign: Campaign, designs: Sequence[Design], objects: tuple[int, ...]) -> Grasps:
    """Plan the grasps of a batch in the order in which the campaign makes them, with forces of 0."""
    plan = campaign.config.objects.model_copy(update={"ids": objects, "files": ()})
    tool: list[int] = []
    obj: list[int] = []
    contexts: list[GraspContext] = []
    for number in range(len(designs)):
        for place, (one, repeat) in enumerate(plan.list_grasps(campaign.seed("planned order", number))):
            n = len(contexts)
            tool.append(number)
            obj.append(objects.index(one))
            contexts.append(GraspContext(repeat=repeat, tool_grasps=place, batch_grasps=n, clock_s=_GRASP_S * n))
    return Grasps(
        tools=tuple(f"T{number:02d}" for number in range(len(designs))),
        designs=tuple(designs),
        objects=objects,
        tool=np.array(tool),
        obj=np.array(obj),
        contexts=tuple(contexts),
        steps_n=np.zeros((len(tool), N_STEPS)),
        grasp_ids=tuple(f"planned {number}" for number in range(len(tool))),
        noise=_NOISE,
        **of_one_setup(len(tool), campaign.config.grasp),
    )
