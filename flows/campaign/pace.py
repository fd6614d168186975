"""How fast each kind of a campaign's work goes, how long what is left takes at that pace, and when a person is needed.

Bench and simulations of a stage go on side by side and share the machine, so each has a pace while both go on and one
while it is alone. A guided simulation waits for its proposal, an initial one does not, so these are kinds of their own.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.campaign.state import CampaignState
from fast.tasks.scientist.observe import unfinished_tools

LEAST = 3  # of them, before a case counts as seen: the first one began in the other case
WINDOW = 200  # grasps, or simulated designs, over which a pace is taken
LONGEST_GAP_S = 90.0  # between grasps; a longer one is a break, such as a print
PROPOSAL_S = 0.3  # of a guided simulation, before one was seen: a proposal and its share of a fit at 500 designs


@dataclass(frozen=True)
class StageLeft:
    """Grasps to measure and grasps to simulate that a stage still owes."""

    grasps: int
    simulated: int
    is_guided: bool


def count_left(campaign: Campaign, state: CampaignState) -> list[StageLeft]:
    """Count what each stage owes from the present one on, the present one first; rejected tools are not owed."""
    schedule, n_objects = campaign.config.schedule, len(campaign.object_ids)
    present = find_stage(campaign, state)
    n_grasps = count_printed_left(campaign, state, present) + _count_unprinted_left(campaign, state, present)
    left = [StageLeft(n_grasps, count_simulated_left(campaign, state, present), present > 0)]
    for stage in range(present + 1, schedule.n_stages):
        n_tools = sum(schedule.tools_of(batch) for batch in schedule.batches_of(stage))
        n_designs = schedule.simulations_of(stage) + (n_tools if campaign.config.simulator.simulate_tools else 0)
        n_each = campaign.config.objects.n_grasps_without(state.left_out.objects(schedule.batches_of(stage)[0]))
        left.append(StageLeft(n_tools * n_each, n_designs * n_objects, True))
    return left


def name_uncounted(config: CampaignConfig) -> str:
    """Name what a campaign does between two stages that no time left counts: it hangs on what was measured."""
    parts = [("gap searches", config.gap.active), ("nights", config.night.active)]
    return " and ".join(name for name, is_done in parts if is_done)


def find_stage(campaign: Campaign, state: CampaignState) -> int:
    """Find the last stage whose tools are proposed."""
    proposed = {tool.batch for tool in state.tools}
    schedule = campaign.config.schedule
    return max((s for s in range(schedule.n_stages) if proposed & set(schedule.batches_of(s))), default=0)


def count_printed_left(campaign: Campaign, state: CampaignState, stage: int) -> int:
    """Count the grasps still to be measured with those tools of a stage that are printed."""
    plan, limit = campaign.config.objects.list_grasps(0), campaign.config.max_grasp_attempts
    batches = campaign.config.schedule.batches_of(stage)
    tools = [tool for batch in batches for tool in unfinished_tools(campaign, state, batch)]
    return sum(len(state.missing_grasps(tool, plan, limit)) for tool in tools)


def _count_unprinted_left(campaign: Campaign, state: CampaignState, stage: int) -> int:
    """Count the grasps of a stage with tools that are not printed yet."""
    plan, limit = campaign.config.objects.list_grasps(0), campaign.config.max_grasp_attempts
    tools = [tool for batch in campaign.config.schedule.batches_of(stage) for tool in state.tools_of(batch)]
    return sum(len(state.owed_grasps(tool, plan, limit)) for tool in tools if tool.tool_id not in state.confirmed)


def count_simulated_left(campaign: Campaign, state: CampaignState, stage: int) -> int:
    """Count a stage's grasps still to be simulated: of its proposals, of its tools, and of proposals to come."""
    schedule, n_objects = campaign.config.schedule, len(campaign.object_ids)
    batches = schedule.batches_of(stage)
    proposed = state.simulations_of(batches[-1])
    designs = [p.design.design_id for p in proposed]
    if campaign.config.simulator.simulate_tools:
        designs += [tool.design.design_id for batch in batches for tool in state.tools_of(batch)]
    n_left = sum(len(state.missing_objects(design_id, campaign.object_ids)) for design_id in designs)
    return n_left + n_objects * (schedule.simulations_of(stage) - len(proposed))


@dataclass
class _Kind:
    """Units of one kind that ended lately: when the one before had, the seconds it took, and how many it was."""

    longest_gap_s: float = math.inf
    last_s: float | None = None
    steps: dict[bool, deque[tuple[float, int]]] = field(
        default_factory=lambda: {shared: deque(maxlen=WINDOW) for shared in (False, True)}
    )

    def note(self, n: int, now_s: float, is_shared: bool) -> None:
        """Note that `n` more units ended."""
        if self.last_s is not None and now_s - self.last_s <= self.longest_gap_s:
            self.steps[is_shared].append((now_s - self.last_s, n))
        self.last_s = now_s

    def s_each(self, is_shared: bool, least: int = LEAST) -> float | None:
        """Return seconds per unit while the other kind goes on too, or not; None before that was seen so often."""
        steps = self.steps[is_shared]
        return sum(s for s, _ in steps) / sum(n for _, n in steps) if len(steps) >= least else None


class Pace:
    """Paces of the kinds of work, from what ended in this process. Safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._grasps, self._initial, self._guided = _Kind(LONGEST_GAP_S), _Kind(), _Kind()
        self._between_s: float | None = None
        self._stage: StageLeft | None = None

    def see(self, stage: StageLeft) -> None:
        """Note what the present stage owes now, as the lake says."""
        with self._lock:
            self._stage = stage

    def note_grasp(self) -> None:
        """Note that a grasp was measured."""
        with self._lock:
            is_shared = self._stage is not None and self._stage.simulated > 0
            self._grasps.note(1, time.monotonic(), is_shared)

    def note_simulated(self, n_objects: int) -> None:
        """Note that a design was simulated on so many objects."""
        with self._lock:
            stage = self._stage
            kind = self._guided if stage is not None and stage.is_guided else self._initial
            kind.note(n_objects, time.monotonic(), stage is not None and stage.grasps > 0)

    def note_between(self, seconds: float, n_batches: int) -> None:
        """Note what closing a stage and proposing the next, with its print trays, took."""
        with self._lock:
            self._between_s = seconds / n_batches
            # What came before it is no part of a grasp or a simulation.
            self._grasps.last_s = self._initial.last_s = self._guided.last_s = None

    def seconds_left(self, left: Sequence[StageLeft], n_objects: int) -> float | None:
        """Return the time for what the stages owe, the present one first; None before the needed paces are known."""
        with self._lock:
            parts = [self._of_stage(stage, n_objects) for stage in left]
            between_s = (len(left) - 1) * (self._between_s or 0.0)
        known = [part for part in parts if part is not None]
        return sum(known) + between_s if len(known) == len(parts) else None

    def _of_stage(self, stage: StageLeft, n_objects: int) -> float | None:
        """Return the time of a stage: both kinds side by side until one is done, then the other alone."""
        kind, extra_s = self._guided if stage.is_guided else self._initial, 0.0
        if stage.is_guided and self._s_each(kind, True) is None:
            kind, extra_s = self._initial, PROPOSAL_S / n_objects
        shared, alone = [], []
        for n, each, more_s in ((stage.grasps, self._grasps, 0.0), (stage.simulated, kind, extra_s)):
            paces = self._s_each(each, True), self._s_each(each, False)
            if n and (paces[0] is None or paces[1] is None):
                return None
            shared.append(n * ((paces[0] or 0.0) + more_s))
            alone.append(n * ((paces[1] or 0.0) + more_s))
        shared_s = min(shared)
        return shared_s + sum(one * _rest(of_both, shared_s) for one, of_both in zip(alone, shared, strict=True))

    def _s_each(self, kind: _Kind, is_shared: bool) -> float | None:
        """Return seconds per unit; of an unseen case, those of the other, as others differ between the two."""
        seen, other = kind.s_each(is_shared), kind.s_each(not is_shared)
        if seen is None and other is None:
            few = kind.s_each(is_shared, 1)
            return few if few is not None else kind.s_each(not is_shared, 1)
        if seen is not None or other is None:
            return seen
        return other * self._slower() if is_shared else other / self._slower()

    def _slower(self) -> float:
        """Return how much longer a unit takes while both kinds go on, mean of the kinds with both cases seen."""
        pairs = [(kind.s_each(True), kind.s_each(False)) for kind in (self._grasps, self._initial, self._guided)]
        ratios = [shared / alone for shared, alone in pairs if shared and alone]
        return sum(ratios) / len(ratios) if ratios else 1.0


def _rest(whole_s: float, done_s: float) -> float:
    """Return the share of the work that is left after so much of its time."""
    return 1.0 - done_s / whole_s if whole_s > 0 else 0.0


@dataclass(frozen=True)
class Forecast:
    """`batch`: what a person will print next, None when nothing is left to print; `in_s`: 0 now, None not known yet.

    `is_proposed`: whether its tools are chosen.
    """

    batch: int | None
    in_s: float | None
    is_proposed: bool = True

    def in_words(self, now: datetime) -> str:
        """Write a sentence for people; `now` in their own time."""
        if self.batch is None:
            return "No person is needed any more."
        if self.in_s is None:
            return f"A person is needed for B{self.batch:02d}; when is not known yet."
        if self.in_s == 0 and not self.is_proposed:
            return f"FAST is choosing the tools of B{self.batch:02d}; then a person is needed."
        if self.in_s == 0:
            return f"A person is needed now: print and mount B{self.batch:02d}."
        at = (now + timedelta(seconds=self.in_s)).astimezone()  # the clocks may change
        day = "" if at.date() == now.date() else f" on {at:%A, %d %B}"
        return f"Next time a person is needed: {at:%H:%M %Z}{day}, for B{self.batch:02d}."


def forecast(
    campaign: Campaign, state: CampaignState, s_per_grasp: float | None, s_per_simulation: float | None
) -> Forecast:
    """Forecast the next print, from the state of the lake and recent seconds per measured and simulated grasp."""
    schedule = campaign.config.schedule
    stage = find_stage(campaign, state)
    bench_s = _time(count_printed_left(campaign, state, stage), s_per_grasp)
    for batch in schedule.batches_of(stage):
        if state.tools_of(batch) and not state.is_confirmed(batch):
            return Forecast(batch, bench_s)
    if stage + 1 >= schedule.n_stages:
        return Forecast(None, None)
    # The next tools are proposed when both the bench and the simulations of this stage are done.
    simulated_s = _time(count_simulated_left(campaign, state, stage), s_per_simulation)
    known = [bench_s, simulated_s]
    in_s = None if None in known else max(s for s in known if s is not None)
    is_night = campaign.config.gap.active or campaign.config.night.active
    # When a night ends depends on what it finds.
    return Forecast(schedule.batches_of(stage + 1)[0], None if is_night else in_s, is_proposed=False)


def _time(n_left: int, s_each: float | None) -> float | None:
    if n_left == 0:
        return 0.0
    return None if s_each is None else n_left * s_each
