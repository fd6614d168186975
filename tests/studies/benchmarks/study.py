"""Runs the grasps of a benchmark in worker processes: a design's objects in one worker, every outcome kept."""

import threading
import time
from collections import deque
from collections.abc import Collection, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from fast.lake.tables.campaign import SimulationRow
from fast.models.design.space import BEST_PUBLISHED, numbered_design
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup
from fast.models.simulation.version import find_tier
from fast.models.solver_code import solver_id
from fast.models.traces.step_features import is_usable, step_means
from fast.tasks.simulation.attempt import Attempt, GraspJob, attempt_grasp, await_attempt
from fast.tasks.simulation.pool import Worker
from tests.studies.benchmarks.base import Options
from tests.studies.benchmarks.outcomes import Outcome, RecordFile, read_outcomes

DEADLINE_S = 300.0  # wall time of one grasp: a reference grasp may take a minute on a loaded machine
SETUP = GraspSetup()
WARM_OBJECT, WARM_SETUP = 1, GraspSetup(max_lift_mm=2)  # enough to load the compiled kernels


@dataclass(frozen=True)
class Case:
    """A grasp to simulate: number of the design in the fixed sequence, object, and name of the simulator."""

    design: int
    object_id: int
    tier: str

    @property
    def job(self) -> GraspJob:
        """What a worker is told."""
        obj = get_object(self.object_id)
        return GraspJob(numbered_design(self.design), obj, find_tier(self.tier), SETUP, DEADLINE_S)

    @property
    def simulation_id(self) -> str:
        """The id that a lake would give this simulation."""
        version_id = find_tier(self.tier).version_id
        design_id = numbered_design(self.design).design_id
        return SimulationRow.make_id(design_id, self.object_id, version_id, SETUP.setup_id)


def cases_of(designs: Iterable[int], tiers: Sequence[str], objects: Sequence[int]) -> list[Case]:
    """Every design with every tier and object; the objects of a design and tier follow one another."""
    return [Case(design, object_id, tier) for design in designs for tier in tiers for object_id in objects]


def run_study(
    cases: Sequence[Case], options: Options, *, n_workers: int, lasting_tiers: Collection[str] = ()
) -> list[Outcome]:
    """Outcomes of the cases that are done, in the order of the cases: from the results file, else simulated now.

    Stops early, without an error, at the time limit of `options`.
    """
    known = read_outcomes(options.results, lasting_tiers)
    missing = [case for case in cases if case.simulation_id not in known]
    if missing:
        options.tell(f"{len(cases) - len(missing)} grasps known, {len(missing)} to simulate")
        with RecordFile(options.results) as file:
            made = _Part(missing, options, file).run(options.workers or n_workers)
        known |= {outcome.simulation_id: outcome for outcome in made}
    return [known[case.simulation_id] for case in cases if case.simulation_id in known]


class _Part:
    """What one process gets done of a study before it ends or the time is up."""

    def __init__(self, cases: Sequence[Case], options: Options, file: RecordFile) -> None:
        groups = groupby(cases, key=lambda case: (case.design, case.tier))
        self._chunks = deque(list(group) for _, group in groups)
        self._tiers = sorted({case.tier for case in cases})
        self._options, self._file = options, file
        self._made: list[Outcome] = []
        self._stopping = threading.Event()
        self._started, self._part = time.monotonic(), time.time()

    def run(self, n_workers: int) -> list[Outcome]:
        """Everything, with so many workers."""
        workers = [Worker() for _ in range(n_workers)]
        try:
            for worker in workers:  # one after the other, so that a first use compiles the kernels once
                self._warm(worker)
            self._started, self._part = time.monotonic(), time.time()
            with ThreadPoolExecutor(n_workers) as threads:
                users = [threads.submit(self._use, worker) for worker in workers]
                try:
                    for user in users:
                        user.result()
                finally:
                    self._stopping.set()
        finally:
            for worker in workers:
                worker.close()
        return self._made

    def _warm(self, worker: Worker) -> None:
        for tier in self._tiers:
            job = GraspJob(BEST_PUBLISHED, get_object(WARM_OBJECT), find_tier(tier), WARM_SETUP, DEADLINE_S)
            await_attempt(worker, job, worker.submit(attempt_grasp, job))

    def _use(self, worker: Worker) -> None:
        while not self._is_over() and (chunk := self._next_chunk()):
            outcomes = [self._simulate(worker, case) for case in chunk if not self._is_over()]
            self._report(chunk[0], outcomes)

    def _next_chunk(self) -> list[Case]:
        try:
            return self._chunks.popleft()
        except IndexError:
            return []

    def _is_over(self) -> bool:
        is_late = time.monotonic() - self._started > 60.0 * self._options.limit_minutes
        return is_late or self._stopping.is_set()

    def _simulate(self, worker: Worker, case: Case) -> Outcome:
        job = case.job
        attempt = await_attempt(worker, job, worker.submit(attempt_grasp, job))
        outcome = self._outcome(case, attempt)
        self._file.append(outcome)
        self._made.append(outcome)
        return outcome

    def _outcome(self, case: Case, attempt: Attempt) -> Outcome:
        result = attempt.result
        numbers: dict[str, Any] = {}
        if result is not None:
            numbers = {name: getattr(result, name) for name in _RESULT_COLUMNS}
            if is_usable(result.trace):
                numbers["step_means_n"] = tuple(step_means(result.trace).round(4).tolist())
        return Outcome(
            simulation_id=case.simulation_id,
            tier=case.tier,
            design=case.design,
            object_id=case.object_id,
            status="failed" if result is None else "ok",
            reason=attempt.reason,
            message=attempt.message,
            cpu_s=round(attempt.cpu_s, 4),
            setup_cpu_s=round(attempt.mesh_cpu_s + (0.0 if result is None else result.setup_cpu_s), 4),
            wall_s=round(attempt.wall_s, 4),
            worker=attempt.worker,
            max_rss_mb=round(attempt.max_rss_mb, 1),
            part=round(self._part, 3),
            ended_s=round(time.monotonic() - self._started, 3),
            solver=solver_id(),
            **numbers,
        )

    def _report(self, first: Case, outcomes: Sequence[Outcome]) -> None:
        failed = sum(not outcome.is_ok for outcome in outcomes)
        cpu_s = sum(outcome.cpu_s for outcome in outcomes)
        self._options.tell(
            f"design {first.design}, {first.tier}: {len(outcomes)} grasps, {failed} failed, {cpu_s:.1f} s of CPU; "
            f"{len(self._made)} in {(time.monotonic() - self._started) / 60:.1f} min"
        )


_RESULT_COLUMNS = (
    "peak_force_n",
    "contact_force_n",
    "work_j",
    "n_dof",
    "n_steps",
    "n_newton",
    "n_factorisations",
    "flag",
)
