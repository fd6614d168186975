"""One attempt at a simulated grasp in a worker process: what came out, why it failed, and what it cost."""

import logging
import os
import resource
import sys
import tempfile
import time
from concurrent.futures import BrokenExecutor, CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import MeshingFailed, SimulationFailed
from fast.models.ids import canonical_json, content_id
from fast.models.objects.catalogue import get_object
from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, GraspSetup, GraspSimulation, Placement
from fast.models.simulation.effects.catalogue import build_effects
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.mesh.solid import SolidMesh
from fast.models.simulation.placement import needs_full_width
from fast.models.simulation.version import SimulatorVersion, check_tier
from fast.tasks.simulation.pool import EngineWorker

logger = logging.getLogger(__name__)

ATTEMPTS = 2
# Wall time past a grasp's own deadline after which its worker is taken to hang; compiling kernels takes its time
HANG_MARGIN_S = 600.0
WARM_UP_OBJECT = 30  # a cube
MESH_CACHE_FORMAT = 2
MESHES_KEPT = 4  # half and full width of a design, for two designs


@dataclass(frozen=True)
class GraspJob:
    """A grasp to simulate; `deadline_s` is wall time. Meshes are cached beside the lake at `lake_root` if given."""

    design: Design
    obj: RigidObject  # as a whole: a worker on another machine has no lake to ask for an own object
    version: SimulatorVersion
    setup: GraspSetup
    deadline_s: float
    lake_root: Path | None = None
    placement: Placement = Placement()

    @property
    def object_id(self) -> int:
        """Number of the object."""
        return self.obj.object_id


@dataclass(frozen=True)
class Attempt:
    """Outcome of a job: a result, or None with the reason of the failure and its message."""

    result: GraspSimulation | None
    """None: it failed."""
    reason: str
    """One word of why."""
    message: str
    """The sentence of why."""
    cpu_s: float
    """The worker's CPU time for everything."""
    mesh_cpu_s: float
    """The part spent on the mesh; none where the worker still had it."""
    wall_s: float
    """From start to end."""
    worker: int = 0
    """Id of its process."""
    max_rss_mb: float = 0.0
    """Most memory that the process has held so far."""


def attempt_grasp(job: GraspJob) -> Attempt:
    """Mesh and simulate; a failed grasp is an outcome like any other. Runs in a worker process.

    Raises:
        UsageError: the job's tier was removed.
    """
    from fast.models.simulation.grasp import simulate_grasp  # compiled kernels are loaded in workers only

    wall, started, meshed = time.perf_counter(), time.process_time(), time.process_time()
    result, reason, message = None, "", ""
    try:
        check_tier(job.version.tier)
        _load_kernels()
        wall, started = time.perf_counter(), time.process_time()
        version_json = canonical_json(job.version.model_dump())
        mesh = _mesh_of(job.design, version_json, needs_full_width(job.obj, job.placement), job.lake_root)
        meshed = time.process_time()
        result = simulate_grasp(
            job.design, job.obj, job.version, job.setup, placement=job.placement, mesh=mesh, deadline_s=job.deadline_s
        )
    except (SimulationFailed, MeshingFailed) as error:
        reason, message = error.reason, str(error)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        reason, message = "arithmetic", f"{type(error).__name__}: {error}"
    ended = time.process_time()
    return Attempt(
        result=result,
        reason=reason,
        message=message,
        cpu_s=ended - started,
        mesh_cpu_s=meshed - started,
        wall_s=time.perf_counter() - wall,
        worker=os.getpid(),
        max_rss_mb=_max_rss_mb(),
    )


@cache
def _load_kernels() -> None:
    """Have the solver's kernels loaded by a short grasp.

    After an update they are compiled first, on a busy machine for minutes. That time belongs to no grasp: counted
    against a deadline, it would be kept as a failure for good.
    """
    from fast.models.simulation.grasp import simulate_grasp

    setup = GraspSetup(max_lift_mm=1.0)
    simulate_grasp(BEST_PUBLISHED, get_object(WARM_UP_OBJECT), setup=setup)


def _max_rss_mb() -> float:
    unit_bytes = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit_bytes / 1e6


@lru_cache(maxsize=MESHES_KEPT)
def _mesh_of(design: Design, version_json: str, full_width: bool, lake_root: Path | None) -> SolidMesh:
    """Return the mesh that this process made or read last time, else from the lake's cache, else a new one."""
    version = SimulatorVersion.model_validate_json(version_json)
    if lake_root is not None:
        return cached_mesh(lake_root, design, version, full_width=full_width)
    effects = build_effects(version.effects)
    return build_mesh(design, version.mesh, full_width=full_width, effects=effects)


def cached_mesh(lake_root: Path, design: Design, version: SimulatorVersion, *, full_width: bool) -> SolidMesh:
    """Return the mesh of a design for a simulator version: from the cache beside the lake's tables, else made, cached.

    It is cached by content, so that a mesher that is not repeatable runs once per body.

    Raises:
        MeshingFailed: the mesher gave no usable mesh.
    """
    content = {
        "format": MESH_CACHE_FORMAT,
        "fem_version": version.fem_version,
        "design": design.content,
        "mesh": version.mesh.model_dump(),
        "effects": [e.model_dump() for e in version.effects],
        "full_width": full_width,
    }
    path = lake_root / ".state" / "meshes" / f"{content_id('M', content)}.npz"
    try:
        with np.load(path) as arrays:
            return SolidMesh.from_arrays(dict(arrays))
    except FileNotFoundError:
        pass
    except (OSError, ValueError, KeyError) as error:
        logger.warning("cached mesh %s is unreadable (%s); meshing again", path.name, error)
    effects = build_effects(version.effects)
    mesh = build_mesh(design, version.mesh, full_width=full_width, effects=effects)
    _store_mesh(path, mesh)
    return mesh


def _store_mesh(path: Path, mesh: SolidMesh) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    with os.fdopen(handle, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **mesh.to_arrays())
    os.replace(temporary, path)


def await_attempt(worker: EngineWorker, job: GraspJob, future: "Future[Attempt]") -> Attempt:
    """Return what the worker says; kill one that hangs, ask again where one died (once may be bad luck)."""
    started = time.monotonic()
    limit_s = hang_limit_s(job.deadline_s)
    for attempt in range(ATTEMPTS):
        if attempt > 0:
            future = worker.submit(attempt_grasp, job)
        try:
            return future.result(timeout=None if worker.ends_hangs else limit_s)
        except FutureTimeoutError:
            worker.restart()
            message = f"no answer for {limit_s:.0f} s; worker killed"
            return _lost("hang", message, started)
        except (BrokenExecutor, CancelledError):
            logger.warning("a worker died at %s on object %d", job.design.design_id, job.object_id)
    return _lost("worker_died", f"its worker died {ATTEMPTS} times", started)


def hang_limit_s(deadline_s: float) -> float:
    """Return the wall time after which a worker at a grasp with this deadline is taken to hang."""
    return deadline_s + HANG_MARGIN_S


def _lost(reason: str, message: str, started: float) -> Attempt:
    """Make an attempt of which nobody is left to say what CPU time it took; at most its wall time."""
    wall_s = time.monotonic() - started
    return Attempt(None, reason, message, cpu_s=wall_s, mesh_cpu_s=0.0, wall_s=wall_s)
