"""Simulate a file of designs on objects in one call: the same grasps as `fast simulate`, in worker processes."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

from fast.flows.progress import Bar, ProgressReporter, RateEstimate
from fast.models.objects.catalogue import get_object, name_object
from fast.models.records import GraspSetup, Placement
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.own_designs import OwnDesign
from fast.tasks.simulation.attempt import Attempt, GraspJob, answer, attempt_grasp
from fast.tasks.simulation.pool import WorkerPool

_DEADLINE_S = 120.0  # of one grasp, as in a campaign


@dataclass(frozen=True)
class SimulatedDesign:
    """A design with its outcome on each object, in the order of the objects."""

    own: OwnDesign
    object_ids: tuple[int, ...]
    attempts: tuple[Attempt, ...]

    @property
    def forces_n(self) -> list[float | None]:
        """Peak pull-off force on each object; None where the simulation failed."""
        return [None if one.result is None else one.result.peak_force_n for one in self.attempts]

    @property
    def row(self) -> dict[str, object]:
        """A line of the table: mean and range over the objects that could be simulated, and why others could not."""
        known = [force_n for force_n in self.forces_n if force_n is not None]
        failed = sorted({one.reason for one in self.attempts if one.result is None})
        return {
            "name": self.own.name,
            "design": self.own.design.design_id,
            "objects": len(known),
            "mean_n": sum(known) / len(known) if known else None,
            "min_n": min(known, default=None),
            "max_n": max(known, default=None),
            "failed": ", ".join(failed),
        }


def simulate_designs(
    designs: Sequence[OwnDesign],
    object_ids: Sequence[int],
    version: SimulatorVersion,
    setup: GraspSetup,
    placement: Placement,
    n_workers: int,
    reporter: ProgressReporter,
) -> list[SimulatedDesign]:
    """Every design on every object, the designs side by side; the one with the largest mean force first.

    A grasp that fails is left out of the mean of its design, and counted.
    """
    total, done, rate = len(designs) * len(object_ids), 0, RateEstimate()
    pool = WorkerPool(n_workers)

    def tell(own: OwnDesign, object_id: int, attempt: Attempt) -> None:
        nonlocal done
        done += 1
        found = attempt.reason if attempt.result is None else f"{attempt.result.peak_force_n:.1f} N"
        bar = Bar("simulated", done, total, rate.seconds_left(total - done))
        reporter.report(f"{own.name} on {name_object(object_id)}: {found}", [bar])

    job = partial(GraspJob, version=version, setup=setup, deadline_s=_DEADLINE_S, placement=placement)
    try:
        with ThreadPoolExecutor(n_workers) as threads:
            found = list(threads.map(partial(_simulate, pool, job, tuple(object_ids), tell), designs))
    finally:
        pool.close()
    return sorted(found, key=lambda one: -(float(str(one.row["mean_n"] or 0.0))))


def _simulate(
    pool: WorkerPool,
    job: Callable[..., GraspJob],
    object_ids: tuple[int, ...],
    tell: Callable[[OwnDesign, int, Attempt], None],
    own: OwnDesign,
) -> SimulatedDesign:
    """All objects of a design in one worker, which keeps its mesh."""
    attempts = []
    with pool.lend() as worker:
        for object_id in object_ids:
            wanted = job(own.design, get_object(object_id))
            attempts.append(answer(worker, wanted, worker.submit(attempt_grasp, wanted)))
            tell(own, object_id, attempts[-1])
    return SimulatedDesign(own, object_ids, tuple(attempts))
