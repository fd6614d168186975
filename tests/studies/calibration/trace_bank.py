"""Grasps for the study of trace-level calibration: a grid of simulations, and the truth of a world, kept in a file."""

import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fast.hardware.virtual.world.file import Scatter, World
from fast.hardware.virtual.world.physics import build_request, simulate_request
from fast.hardware.virtual.world.physics_cache import physics_id
from fast.models.calibration.traces.theta_grid import ThetaGrid
from fast.models.design.space import numbered_design
from fast.models.errors import MeshingFailed, SimulationFailed
from fast.models.ids import content_id
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup, GraspSimulation, Record, Theta, Trace
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.placement import needs_full_width
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.simulation.pool import WorkerPool
from tests.studies.benchmarks.base import Options
from tests.studies.benchmarks.outcomes import RecordFile, read_records

SETUP = GraspSetup()
DEADLINE_S = 300.0
PLACEMENT_SD_MM = 0.2
WORLD_SEED = 7
_DIGITS = 5  # of forces in N and lifts in mm


class BankJob(Record):
    """A grasp: of the simulator, or of the world with its finer mesh, other contact law and misplaced objects."""

    kind: Literal["simulated", "true"]
    design: int
    object_id: int
    theta: Theta


class BankTrace(Record):
    """A job and its trace; without samples where the grasp failed. `code` is the id of the code that made it."""

    job: BankJob
    code: str
    lift_mm: tuple[float, ...] = ()
    force_n: tuple[float, ...] = ()
    cpu_s: float = 0.0

    @property
    def job_id(self) -> str:
        """Id of the job's content."""
        return job_id(self.job)

    @property
    def trace(self) -> Trace | None:
        """The samples; their times are not kept."""
        if not self.lift_mm:
            return None
        lift_mm = np.array(self.lift_mm)
        return Trace(np.arange(len(lift_mm), dtype=float), lift_mm, np.array(self.force_n))


@dataclass(frozen=True)
class Bank:
    """Finished grasps by job."""

    traces: dict[str, BankTrace]

    def trace(self, job: BankJob) -> Trace | None:
        """The trace of a job; None where it failed or is not done yet."""
        found = self.traces.get(job_id(job))
        return None if found is None else found.trace

    @property
    def cpu_s(self) -> float:
        """What all of them cost."""
        return sum(trace.cpu_s for trace in self.traces.values())


def job_id(job: BankJob) -> str:
    """Id derived from the content."""
    return content_id("U", job.model_dump(mode="json"))


def bank_jobs(
    designs: Sequence[int], objects: Sequence[int], grid: ThetaGrid, truths: Sequence[Theta]
) -> list[BankJob]:
    """The grid of every design and object at 10 MPa, since E is a factor; and the truth of each."""
    jobs = []
    for design in designs:
        for object_id in objects:
            thetas = [Theta(young_modulus_mpa=10.0, friction=mu, poisson_ratio=nu) for mu, nu in grid.points]
            jobs += [BankJob(kind="simulated", design=design, object_id=object_id, theta=theta) for theta in thetas]
            jobs += [BankJob(kind="true", design=design, object_id=object_id, theta=theta) for theta in truths]
    return jobs


def fill_bank(jobs: Sequence[BankJob], options: Options) -> Bank:
    """Traces of the jobs that are done: those in the results file, else simulated now, up to the time limit."""
    code = physics_id()
    known = {t.job_id: t for t in read_records(options.results, BankTrace, "trace of a bank") if t.code == code}
    missing = [job for job in jobs if job_id(job) not in known]
    if missing:
        options.tell(f"{len(jobs) - len(missing)} grasps known, {len(missing)} to simulate")
        with RecordFile(options.results) as file:
            for trace in _simulated(missing, code, options, file):
                known[trace.job_id] = trace
    wanted = {job_id(job) for job in jobs}
    return Bank({key: trace for key, trace in known.items() if key in wanted})


def _simulated(jobs: Sequence[BankJob], code: str, options: Options, file: RecordFile) -> Iterable[BankTrace]:
    """Traces as their chunks (a design and object each) end."""
    chunks: dict[tuple[int, int], list[BankJob]] = {}
    for job in jobs:
        chunks.setdefault((job.design, job.object_id), []).append(job)
    n_workers = options.workers or 1
    pool, started = WorkerPool(n_workers), time.monotonic()
    try:
        with ThreadPoolExecutor(n_workers) as threads:
            limit_s = 60.0 * options.limit_minutes

            def work(chunk: list[BankJob]) -> list[BankTrace]:
                is_late = time.monotonic() - started > limit_s
                return [] if is_late else pool.call(simulate_chunk, chunk, code)

            futures = [threads.submit(work, chunk) for chunk in chunks.values()]
            for n_done, future in enumerate(as_completed(futures), start=1):
                for trace in future.result():
                    file.append(trace)
                    yield trace
                if n_done % 8 == 0:
                    options.tell(f"{n_done} of {len(chunks)} pairs of a design and an object")
    finally:
        pool.close()


def simulate_chunk(jobs: Sequence[BankJob], code: str) -> list[BankTrace]:
    """Simulate the jobs of one design and object, which share a mesh. Runs in a worker process."""
    traces = []
    for job in jobs:
        started = time.process_time()
        try:
            result = _simulate(job)
        except (SimulationFailed, MeshingFailed):
            traces.append(BankTrace(job=job, code=code, cpu_s=time.process_time() - started))
            continue
        lift_mm, force_n = (
            np.round(values, _DIGITS).tolist() for values in (result.trace.lift_mm, result.trace.force_n)
        )
        cpu_s = time.process_time() - started
        traces.append(BankTrace(job=job, code=code, lift_mm=tuple(lift_mm), force_n=tuple(force_n), cpu_s=cpu_s))
    return traces


def _simulate(job: BankJob) -> GraspSimulation:
    design, obj = numbered_design(job.design), get_object(job.object_id)
    if job.kind == "true":
        world = World(seed=WORLD_SEED, theta=job.theta, scatter=Scatter(placement_sd_mm=PLACEMENT_SD_MM))
        return simulate_request(build_request(world, f"study/B01T{job.design}", design, job.object_id, SETUP))
    version = SimulatorVersion(theta=job.theta)
    mesh = build_mesh(design, version.mesh, full_width=needs_full_width(obj))
    return simulate_grasp(design, obj, version, SETUP, mesh=mesh, deadline_s=DEADLINE_S)
