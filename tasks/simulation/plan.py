"""Simulate designs with a theta of their own, side by side: the points of a hypercube, or tools at a new theta."""

import threading
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass

from fast.lake.provenance import Provenance, current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, SimulatorVersionRow
from fast.lake.tables.catalogue_rows import version_rows
from fast.lake.tables.row import Row
from fast.models.objects.catalogue import get_object
from fast.models.records import Design, GraspSetup, Placement, find_setup_id
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.state import tuples
from fast.tasks.simulation.attempt import GraspJob, attempt_grasp, await_attempt
from fast.tasks.simulation.pool import WorkerPool
from fast.tasks.simulation.simulate import simulation_rows


@dataclass(frozen=True)
class SimulationPlan:
    """Designs, each with its simulator version, to be simulated on the same objects in the same way.

    `config_hash` and `seed` are those of what chose the points; every row names them.
    """

    points: tuple[tuple[Design, SimulatorVersion], ...]
    object_ids: tuple[int, ...]
    setup: GraspSetup
    config_hash: str = ""
    seed: int = 0
    deadline_s: float = 120.0
    placement: Placement = Placement()

    @property
    def n_grasps(self) -> int:
        """Grasps of the whole plan."""
        return len(self.points) * len(self.object_ids)

    @property
    def setup_id(self) -> str:
        """Id of setup and placement."""
        return find_setup_id(self.setup, self.placement)

    def provenance(self, parents: Sequence[str] = ()) -> Provenance:
        """Return the provenance of the rows of this plan."""
        return current_provenance(self.config_hash, self.seed, parents)


@dataclass(frozen=True)
class PointDone:
    """Progress: a point ended. `n_done` of `n_grasps` grasps of the plan are in the lake, failed ones too."""

    n_failed: int
    n_done: int
    n_grasps: int


def simulate_plan(
    lake: Lake,
    plan: SimulationPlan,
    n_workers: int,
    on_point: Callable[[PointDone], None] = lambda _: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> int:
    """Simulate what the lake lacks of a plan; a worker takes its next point the moment it is free.

    All grasps of a point, failed or not, are in the lake when its last one ends: a killed process is continued by the
    same call, and has lost one point for each worker. Returns the number of grasps that failed in this call.
    `should_stop` is asked before each grasp.
    """
    missing = missing_objects(lake, plan)
    if not missing:
        return 0
    _describe(lake, plan)
    done = _Count(plan, plan.n_grasps - sum(len(objects) for _, objects in missing))
    pool = WorkerPool(min(n_workers, len(missing)))
    stopping = threading.Event()

    def has_stopped() -> bool:
        return stopping.is_set() or should_stop()

    try:
        with ThreadPoolExecutor(min(n_workers, len(missing)), thread_name_prefix="hypercube") as threads:
            futures = [
                threads.submit(_simulate_point, lake, plan, point, objects, pool, has_stopped)
                for point, objects in missing
            ]
            try:
                for future in as_completed(futures):
                    on_point(done.add(*future.result()))
            except BaseException:
                stopping.set()  # the other points end after their grasp
                raise
    finally:
        pool.close()
    return done.n_failed


def missing_objects(lake: Lake, plan: SimulationPlan) -> list[tuple[tuple[Design, SimulatorVersion], list[int]]]:
    """List points of a plan with the objects that the lake has no result or failure of, in order."""
    known: dict[tuple[str, str], set[int]] = defaultdict(set)
    sql = "SELECT design_id, version_id, object_id FROM simulations WHERE setup_id = ?"
    for design_id, version_id, object_id in tuples(lake, sql, plan.setup_id):
        known[design_id, version_id].add(object_id)
    found = []
    for design, version in plan.points:
        done = known.get((design.design_id, version.version_id), set())
        objects = [object_id for object_id in plan.object_ids if object_id not in done]
        if objects:
            found.append(((design, version), objects))
    return found


class _Count:
    """How far a plan is; used by one thread."""

    def __init__(self, plan: SimulationPlan, n_done: int) -> None:
        self._n_grasps, self._n_done = plan.n_grasps, n_done
        self.n_failed = 0

    def add(self, n_made: int, n_failed: int) -> PointDone:
        """Count the grasps of a point."""
        self._n_done += n_made
        self.n_failed += n_failed
        return PointDone(n_failed, self._n_done, self._n_grasps)


def _simulate_point(
    lake: Lake,
    plan: SimulationPlan,
    point: tuple[Design, SimulatorVersion],
    objects: Sequence[int],
    pool: WorkerPool,
    should_stop: Callable[[], bool],
) -> tuple[int, int]:
    """Simulate a design on the objects it misses in one worker; returns the numbers of grasps made and failed.

    Its rows are written together: a file for each of 53,000 grasps would take longer to write than some to simulate.
    """
    design, version = point
    rows: list[Row] = []
    n_made = n_failed = 0
    with pool.lend() as worker:
        for object_id in objects:
            if should_stop():
                break
            job = GraspJob(
                design, get_object(object_id), version, plan.setup, plan.deadline_s, lake.root, placement=plan.placement
            )
            attempt = await_attempt(worker, job, worker.submit(attempt_grasp, job))
            n_made += 1
            if attempt.result is None:
                n_failed += 1
            rows += simulation_rows(job, attempt)
    if rows:
        lake.append(rows, plan.provenance([design.design_id, version.version_id]))
    return n_made, n_failed


def _describe(lake: Lake, plan: SimulationPlan) -> None:
    """Make sure that the lake has every design and simulator version of a plan: thousands, in one file each."""
    known_designs, known_versions = lake.ids(DesignRow), lake.ids(SimulatorVersionRow)
    rows: list[Row] = []
    for design, version in plan.points:
        if design.design_id not in known_designs:
            rows.append(DesignRow.of(design))
        if version.version_id not in known_versions:
            rows += version_rows(version)
    if rows:
        lake.append(rows, plan.provenance())
