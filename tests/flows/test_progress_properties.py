"""What is said of progress is true, whatever happens: pauses, budgets that cut, resumed processes, failures."""

import re
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from types import SimpleNamespace
from unittest import mock

from hypothesis import given, settings
from hypothesis import strategies as st

from fast.flows.campaign import pace
from fast.flows.campaign import progress as campaign_progress
from fast.flows.campaign.pace import StageLeft
from fast.flows.campaign.progress import CampaignProgress, Workload
from fast.flows.progress import UNKNOWN, ProgressReporter
from fast.flows.simulation import progress as simulation_progress
from fast.flows.simulation.progress import simulate_missing
from fast.tasks.campaign.config import CampaignConfig
from fast.tasks.simulation.plan import PointDone

ALL_DONE = "0 s left"
EVENTS = ("grasp", "simulation", "both", "failed grasp", "given up", "resume")
GAPS_S = st.floats(0.01, 80) | st.floats(100, 1e5)  # work, or a print, a pause, a night


def small_config() -> CampaignConfig:
    """A config that searches no gaps and has no nights, of which no time left would be known."""
    return CampaignConfig.model_validate({"name": "small", "bench": {"world": "world.toml"}})


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(EVENTS), GAPS_S), min_size=1, max_size=40),
    st.integers(1, 30),
    st.integers(0, 30),
)
def test_a_campaign_says_what_is_done_and_never_that_it_ends_while_work_is_left(events, n_grasps, n_simulations):
    load = [Workload(0, n_grasps, 0, n_simulations)]
    clock = [0.0]
    lines: list[str] = []
    fake_time = SimpleNamespace(monotonic=lambda: clock[0], thread_time=lambda: 0.0)
    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(campaign_progress, "time", fake_time))
        stack.enter_context(mock.patch.object(campaign_progress, "count_work", side_effect=lambda *each: load[0]))
        stack.enter_context(mock.patch.object(campaign_progress, "at_present"))
        stack.enter_context(mock.patch.object(pace, "time", fake_time))
        stack.enter_context(
            mock.patch.object(campaign_progress, "count_left", side_effect=lambda *each: [left_of(load[0])])
        )
        campaign = SimpleNamespace(object_ids=(1,), config=small_config())
        new = partial(CampaignProgress, campaign, ProgressReporter(lines.append, lines.append).report)
        reporter, n_seen = new(), 0
        for event, gap_s in events:
            clock[0] += gap_s
            now = load[0]
            grasps = now.grasps_done + (event in ("grasp", "both"))
            total = max(now.grasps_total - (event == "given up"), now.grasps_done)
            simulated = now.simulated_done + (event in ("simulation", "both"))
            load[0] = Workload(min(grasps, total), total, min(simulated, n_simulations),
                               n_simulations)  # fmt: skip
            if event == "resume":
                reporter, n_seen = new(), 0
            if event in ("grasp", "both"):
                reporter.pace.note_grasp()
            if event in ("simulation", "both"):
                reporter.pace.note_simulated(1)
            reporter._line("something happened", is_look_due=True)
            n_seen += 1
            found = re.fullmatch(r".*grasps (\d+)/(\d+), simulated (\d+)/(\d+)  \|  (.*)", lines[-1])
            assert found is not None
            now = load[0]
            counted = (now.grasps_done, now.grasps_total, now.simulated_done, now.simulated_total)
            assert tuple(map(int, found.groups()[:4])) == counted
            is_complete = now.fraction >= 1.0
            assert (found[5] == ALL_DONE) == is_complete
            if n_seen < 2 and not is_complete:
                assert found[5] == UNKNOWN  # of a process that saw no two units end


def left_of(load: Workload) -> StageLeft:
    """What a campaign of one stage owes."""
    grasps, simulated = load.grasps_total - load.grasps_done, load.simulated_total - load.simulated_done
    return StageLeft(grasps, simulated, is_guided=False)


class Simulated:
    """A lake that only counts: which grasps of which points were simulated, and how many of them failed."""

    def __init__(self) -> None:
        self.done: set[tuple[str, int, int]] = set()
        self.failed = 0
        self.n_points = 0
        self.now_s = 0.0

    def missing_objects(self, lake, plan):
        found = []
        for place in range(plan.n_points):
            objects = [each for each in range(plan.n_objects) if (plan.name, place, each) not in self.done]
            if objects:
                found.append(((place, plan.name), objects))
        return found

    def simulate_plan(self, lake, plan, n_workers, on_point, should_stop):
        missing = self.missing_objects(lake, plan)
        n_all = plan.n_points * plan.n_objects
        n_done, n_failed = n_all - sum(len(objects) for _, objects in missing), 0
        for (place, _), objects in missing:
            self.now_s += 11.0
            if not should_stop():
                self.done |= {(plan.name, place, each) for each in objects}
                self.n_points += 1
                n_done += len(objects)
                n_failed += sum(each in plan.failing for each in objects)
                self.failed += sum(each in plan.failing for each in objects)
            on_point(PointDone(n_failed, n_done, n_all))
        return n_failed


PLANS = st.lists(
    st.builds(
        lambda n_points, n_objects, failing: SimpleNamespace(n_points=n_points, n_objects=n_objects, failing=failing),
        st.integers(0, 5), st.integers(1, 3), st.sets(st.integers(0, 2)),
    ),
    min_size=1, max_size=4,
)  # fmt: skip


def call(lake: Simulated, plans: list[SimpleNamespace], should_stop: Callable[[], bool], check: Callable[[str], None]):
    with ExitStack() as stack:
        for name in ("missing_objects", "simulate_plan"):
            stack.enter_context(mock.patch.object(simulation_progress, name, getattr(lake, name)))
        stack.enter_context(mock.patch.object(simulation_progress, "compact"))
        fake_time = SimpleNamespace(monotonic=lambda: lake.now_s)
        stack.enter_context(mock.patch.object(simulation_progress, "time", fake_time))
        simulate_missing(lake, plans, 1, ProgressReporter(check, check), should_stop)


@settings(max_examples=200, deadline=None)
@given(PLANS, st.lists(st.integers(0, 6), max_size=4))
def test_simulations_are_counted_as_they_are_made_through_budgets_failures_and_resumes(plans, budgets):
    for place, plan in enumerate(plans):
        plan.name = str(place)
    lake = Simulated()
    n_all = sum(plan.n_points * plan.n_objects for plan in plans)
    for budget in [*budgets, 10**6]:
        n_before, failed_before, stop_at = len(lake.done), lake.failed, lake.n_points + budget
        said: list[str] = []

        def check(line: str, n_before=n_before, failed_before=failed_before, said=said) -> None:
            said.append(line)
            n_made, n_failed = len(lake.done) - n_before, lake.failed - failed_before
            failed = f", {n_failed} failed" if n_failed else ""
            if " missing grasps" in line:
                assert line.split("  ", 1)[1].startswith(
                    f"simulated {n_made}/{n_all - n_before} missing grasps{failed}  |"
                )
                assert (line.rpartition("|  ")[2] == ALL_DONE) == (n_made == n_all - n_before)
            else:
                assert line == f"simulated {n_made} grasps{failed.replace(',', ';')}"

        call(lake, plans, lambda stop_at=stop_at: lake.n_points >= stop_at, check)
        assert bool(said) == (n_before < n_all)
    assert len(lake.done) == n_all
