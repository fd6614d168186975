"""Simulate what a lake lacks of some plans, with lines of progress that say how long it takes."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import accumulate

from fast.flows.progress import Bar, ProgressReporter, RateEstimate
from fast.lake.maintenance import compact
from fast.lake.store import Lake
from fast.lake.tables.campaign import SimTraceRow, SimulationRow
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.simulation.plan import PointDone, SimulationPlan, missing_objects, simulate_plan

_PROGRESS_INTERVAL_S = 10.0
_PARTS = 10**6  # of all the work, in which its progress is counted


def n_missing(lake: Lake, plans: Sequence[SimulationPlan]) -> int:
    """Count the grasps of plans that the lake has no result or failure of."""
    return sum(len(objects) for plan in plans for _, objects in missing_objects(lake, plan))


def simulate_missing(
    lake: Lake,
    plans: Sequence[SimulationPlan],
    n_workers: int,
    reporter: ProgressReporter,
    should_stop: Callable[[], bool] = lambda: False,
    cost_s: Callable[[SimulatorVersion], float | None] = lambda _: None,
) -> None:
    """Simulate what the lake lacks of the plans, one after the other; killed, the same call continues.

    cost_s: about how long a grasp takes with a version, as far as it is known: grasps on a fine mesh come last, and the
    time left would be told too short without.
    """
    missing = [
        cost_s(version) for plan in plans for (_, version), objects in missing_objects(lake, plan) for _ in objects
    ]
    total = len(missing)
    if not total:
        return
    known = [cost for cost in missing if cost is not None]
    worth = [float(cost or 0.0) for cost in missing] if len(known) == total else [1.0] * total
    counter = _SimulationCounter(reporter, total, list(accumulate(worth, initial=0.0)))
    n_failed = 0
    for plan in plans:
        if should_stop():
            break
        counter.begin(n_missing(lake, [plan]))
        n_failed += simulate_plan(lake, plan, n_workers, counter.note, should_stop)
    for row_type in (SimTraceRow, SimulationRow):
        compact(lake, row_type)
    failed = f"; {n_failed} failed" if n_failed else ""
    reporter.progress(f"simulated {total - n_missing(lake, plans)} grasps{failed}")


@dataclass
class _SimulationCounter:
    """A line of progress with the time left, at most one in ten seconds."""

    reporter: ProgressReporter
    """Is told."""
    total: int
    """Grasps to be made."""
    worth: Sequence[float]
    """Of the first 0, 1, ... total grasps, in any unit of time."""
    made: int = 0
    """So far."""
    of_plan: int = 0
    """Grasps of the plan that is under way."""
    before_plan: int = 0
    """Made before it."""
    failed: int = 0
    """So far."""
    failed_before_plan: int = 0
    """Failed before it."""
    rate: RateEstimate = field(default_factory=RateEstimate)
    """How fast they come."""
    last_s: float = -_PROGRESS_INTERVAL_S
    """When it last spoke."""

    def begin(self, n_grasps: int) -> None:
        """Begin the next plan, which lacks so many grasps."""
        self.before_plan, self.failed_before_plan, self.of_plan = self.made, self.failed, n_grasps

    def note(self, done: PointDone) -> None:
        """Note that a point ended."""
        now = time.monotonic()
        self.made = self.before_plan + self.of_plan - (done.n_grasps - done.n_done)
        self.failed = self.failed_before_plan + done.n_failed
        share = self.worth[self.made] / self.worth[-1]
        self.rate.update(round(_PARTS * share), now)
        if now - self.last_s < _PROGRESS_INTERVAL_S:
            return
        self.last_s = now
        left_s = self.rate.seconds_left(round(_PARTS * (1.0 - share)))
        note = f" missing grasps, {self.failed} failed" if self.failed else " missing grasps"
        self.reporter.report("", [Bar("simulated", self.made, self.total, left_s, note)])
