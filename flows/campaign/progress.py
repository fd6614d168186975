"""Progress of a campaign for people: one line when something happened, with an estimate of what is left."""

import logging
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from fast.flows.campaign.pace import Pace, StageLeft, count_left, name_uncounted
from fast.flows.progress import Bar
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.simulator_versions import at_present
from fast.tasks.campaign.state import CampaignState, PlannedGrasp

MOST_CPU = 1e-3  # of a core: a look reads all rows that are new, and a bench measures for days

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Workload:
    """How much of a campaign is done, in grasps measured and grasps simulated."""

    grasps_done: int
    grasps_total: int
    simulated_done: int
    simulated_total: int
    simulated_before: int = 0
    """Of those done, by an older simulator version alone."""

    @property
    def fraction(self) -> float:
        """Done share of all grasps, measured and simulated."""
        total = self.grasps_total + self.simulated_total
        return (self.grasps_done + self.simulated_done) / total if total else 1.0


def count_work(campaign: Campaign, state: CampaignState) -> Workload:
    """Count what is done and what the schedule asks for.

    Rejected tools, given-up grasps and what a person left out are not owed.
    """
    config = campaign.config
    schedule, per_tool = config.schedule, config.objects.n_grasps
    rejected = sum(status == "rejected" for status in state.confirmed.values())
    n_tools = schedule.initial_tools + schedule.guided_batches * schedule.tools_per_batch - rejected
    given_up = sum(n >= config.max_grasp_attempts for n in state.failures.values())
    n_designs = sum(schedule.simulations_of(stage) for stage in range(schedule.n_stages))
    designs = {s.design.design_id for s in state.simulations}
    if config.simulator.simulate_tools:
        n_designs += n_tools + rejected
        designs |= {tool.design.design_id for tool in state.tools}
    wanted = set(campaign.object_ids)
    simulated = sum(len(wanted & state.ever_simulated(design_id)) for design_id in designs)
    by_present = sum(len(wanted & state.simulated.get(design_id, set())) for design_id in designs)
    return Workload(
        grasps_done=sum(len(cells) for cells in state.measured.values()),
        grasps_total=n_tools * per_tool - given_up - _count_left_out(campaign, state),
        simulated_done=simulated,
        simulated_total=n_designs * len(wanted),
        simulated_before=simulated - by_present,
    )


def _count_left_out(campaign: Campaign, state: CampaignState) -> int:
    """Count the grasps that nobody makes since a person left them out: of proposed tools, and of those to come."""
    if not state.left_out.words:
        return 0
    objects, schedule, limit = campaign.config.objects, campaign.config.schedule, campaign.config.max_grasp_attempts
    cells, n_out = objects.list_grasps(0), 0
    for tool in state.tools:
        if state.confirmed.get(tool.tool_id) != "rejected":
            is_done, failed = state.measured.get(tool.tool_id, set()), state.failures
            n_out += sum(
                state.left_out.covers(tool.batch, tool.slot, cell)
                for cell in cells
                if cell not in is_done and failed.get((tool.tool_id, cell), 0) < limit
            )
    proposed = {tool.batch for tool in state.tools}
    batches = {batch for stage in range(schedule.n_stages) for batch in schedule.batches_of(stage)} - proposed
    for batch in batches:
        n_out += schedule.tools_of(batch) * (objects.n_grasps - objects.n_grasps_without(state.left_out.objects(batch)))
    return n_out


class CampaignProgress:
    """Reports what happened, at most once per `interval_s` unless a design was simulated.

    What the lake holds is read with `MOST_CPU` of a core; between two looks grasps are counted as they come.
    """

    def __init__(
        self, campaign: Campaign, report: Callable[[str, Sequence[Bar]], None], interval_s: float = 5.0
    ) -> None:
        self.pace = Pace()
        self._campaign = campaign
        self._report = report
        self._interval_s = interval_s
        self._next_line_s = self._next_look_s = 0.0
        self._load: Workload | None = None
        self._counted: dict[str, set[PlannedGrasp]] = {}
        self._left: list[StageLeft] = []
        self._lock = threading.Lock()

    def grasp(self, what: str, owed: tuple[str, PlannedGrasp] | None) -> None:
        """Report a grasp that was just measured; `owed`: its tool and cell, if it went well and is of the schedule."""
        self.pace.note_grasp()
        with self._lock:
            # The look of a design that was simulated meanwhile may have found it in the lake already.
            if owed is not None and self._load is not None and owed[1] not in self._counted.get(owed[0], ()):
                self._load = replace(self._load, grasps_done=min(self._load.grasps_done + 1, self._load.grasps_total))
                self._left[0] = replace(self._left[0], grasps=max(self._left[0].grasps - 1, 0))
            now = time.monotonic()
            if now >= self._next_line_s:
                self._line(what, is_look_due=now >= self._next_look_s)

    def simulated(self, what: str) -> None:
        """Report a design that was just simulated on all objects."""
        self.pace.note_simulated(len(self._campaign.object_ids))
        with self._lock:
            self._line(what, is_look_due=True)

    def _line(self, what: str, *, is_look_due: bool) -> None:
        """Report `what` just happened, with counts and the time left."""
        if self._load is None or is_look_due:
            before_s = time.thread_time()
            state = at_present(self._campaign).state()
            self._load, self._left = count_work(self._campaign, state), count_left(self._campaign, state)
            self._counted = state.measured
            self._next_look_s = time.monotonic() + (time.thread_time() - before_s) / MOST_CPU
        self.pace.see(self._left[0])
        left_s = self.pace.seconds_left(self._left, len(self._campaign.object_ids))
        self._report(what, _bars(self._load, left_s, name_uncounted(self._campaign.config)))
        self._next_line_s = time.monotonic() + self._interval_s


def _bars(load: Workload, left_s: float | None, uncounted: str) -> list[Bar]:
    """Make the bars of bench and simulations, which end together; the time leaves out what people take to print."""
    return [
        Bar("grasps", load.grasps_done, load.grasps_total, left_s, uncounted=uncounted),
        Bar("simulated", load.simulated_done, load.simulated_total, left_s, uncounted=uncounted),
    ]
