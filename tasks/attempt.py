"""One attempt at a simulated grasp in a worker process: what came out, why it failed, and what it cost."""

import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from models.effects.catalogue import build_effects
from models.errors import MeshingFailed, SimulationFailed
from models.ids import canonical_json
from models.mesh.build import build_mesh
from models.mesh.solid import SolidMesh
from models.objects.catalogue import get_object
from models.records import Design, GraspSetup, GraspSimulation, SimulatorVersion
from tasks.mesh_cache import cached_mesh

MESHES_KEPT = 4  # half and full width of a design, for two designs


@dataclass(frozen=True)
class GraspJob:
    """A grasp to simulate; `deadline_s` is wall time, meshes are cached beside the lake at `lake_root` if given."""

    design: Design
    object_id: int
    version: SimulatorVersion
    setup: GraspSetup
    deadline_s: float
    lake_root: Path | None = None


@dataclass(frozen=True)
class Attempt:
    """Outcome of a job: a result, or None with the reason of the failure and its message.

    `cpu_s` is the worker's CPU time for everything, `mesh_cpu_s` the part spent on the mesh (none where the worker
    still had it); `wall_s` is from start to end.
    """

    result: GraspSimulation | None
    reason: str
    message: str
    cpu_s: float
    mesh_cpu_s: float
    wall_s: float


def attempt_grasp(job: GraspJob) -> Attempt:
    """Mesh and simulate; a failed grasp is an outcome like any other. Runs in a worker process."""
    from models.fem.grasp import simulate_grasp  # compiled kernels are loaded in workers only

    wall, started, meshed = time.perf_counter(), time.process_time(), time.process_time()
    result, reason, message = None, "", ""
    try:
        obj = get_object(job.object_id)
        version_json = canonical_json(job.version.model_dump())
        mesh = _mesh_of(job.design, version_json, not obj.mirror_y, job.lake_root)
        meshed = time.process_time()
        result = simulate_grasp(job.design, obj, job.version, job.setup, mesh=mesh, deadline_s=job.deadline_s)
    except (SimulationFailed, MeshingFailed) as error:
        reason, message = error.reason, str(error)
    ended = time.process_time()
    return Attempt(result, reason, message, ended - started, meshed - started, time.perf_counter() - wall)


@lru_cache(maxsize=MESHES_KEPT)
def _mesh_of(design: Design, version_json: str, full_width: bool, lake_root: Path | None) -> SolidMesh:
    """The mesh that this process made or read last time, else from the lake's cache, else a new one."""
    version = SimulatorVersion.model_validate_json(version_json)
    if lake_root is not None:
        return cached_mesh(lake_root, design, version, full_width=full_width)
    effects = build_effects(version.effects)
    return build_mesh(design, version.mesh, full_width=full_width, effects=effects)
