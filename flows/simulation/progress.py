"""Simulate what a lake lacks of some plans, with lines of progress that say how long it takes."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from flows.progress import ProgressReporter, RateEstimate, describe_time_left
from lake.maintenance import compact
from lake.store import Lake
from lake.tables.campaign import SimTraceRow, SimulationRow
from tasks.simulation.plan import PointDone, SimulationPlan, missing_objects, simulate_plan

_PROGRESS_INTERVAL_S = 10.0


def n_missing(lake: Lake, plans: Sequence[SimulationPlan]) -> int:
    """Grasps of plans that the lake has no result or failure of."""
    return sum(len(objects) for plan in plans for _, objects in missing_objects(lake, plan))


def simulate_missing(
    lake: Lake,
    plans: Sequence[SimulationPlan],
    n_workers: int,
    reporter: ProgressReporter,
    should_stop: Callable[[], bool] = lambda: False,
) -> None:
    """Simulate what the lake lacks of the plans, one after the other; killed, the same call continues."""
    total = n_missing(lake, plans)
    if not total:
        return
    counter = _SimulationCounter(reporter, total)
    n_failed = 0
    for plan in plans:
        counter.begin(n_missing(lake, [plan]))
        n_failed += simulate_plan(lake, plan, n_workers, counter.tell, should_stop)
    for row_type in (SimTraceRow, SimulationRow):
        compact(lake, row_type)
    failed = f"; {n_failed} failed" if n_failed else ""
    reporter.progress(f"simulated {total - n_missing(lake, plans)} grasps{failed}")


@dataclass
class _SimulationCounter:
    """A line of progress with the time left, at most one in ten seconds."""

    reporter: ProgressReporter
    total: int
    before: int = 0
    of_plan: int = 0
    rate: RateEstimate = field(default_factory=RateEstimate)
    last_s: float = -_PROGRESS_INTERVAL_S

    def begin(self, n_grasps: int) -> None:
        """The next plan lacks so many grasps."""
        self.before, self.of_plan = self.before + self.of_plan, n_grasps

    def tell(self, done: PointDone) -> None:
        """Note that a point ended."""
        now = time.monotonic()
        made = self.before + self.of_plan - (done.n_grasps - done.n_done)
        self.rate.update(made, now)
        if now - self.last_s < _PROGRESS_INTERVAL_S:
            return
        self.last_s = now
        left = describe_time_left(self.rate.seconds_left(self.total - made))
        failed = f", {done.n_failed} failed" if done.n_failed else ""
        self.reporter.progress(
            f"{time.strftime('%H:%M:%S')}  simulated {made}/{self.total} missing grasps{failed}  |  {left}"
        )
