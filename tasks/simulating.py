"""Simulate a design on its objects: one FEM grasp per object in a worker process, one row per grasp."""

import logging
from collections.abc import Sequence
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from lake.provenance import current_provenance
from lake.store import Lake
from lake.tables import SimTraceRow, SimulationRow, SimulatorVersionRow
from models.errors import MeshingFailed, SimulationFailed
from models.ids import canonical_json
from models.records import Design, GraspSetup, GraspSimulation, SimulatorVersion
from tasks.mesh_cache import cached_mesh
from tasks.pool import WorkerPool

logger = logging.getLogger(__name__)

HANG_MARGIN_S = 60.0  # wall time past a grasp's own deadline after which its worker is taken to hang


def simulate_design(
    lake: Lake,
    design: Design,
    object_ids: Sequence[int],
    version: SimulatorVersion,
    setup: GraspSetup,
    *,
    pool: WorkerPool,
    deadline_s: float,
    config_hash: str = "",
) -> int:
    """Simulate `design` on every object, appending each result as it arrives; failures are rows too.

    Returns the number of failed grasps.
    """
    append_version(lake, version, config_hash)
    futures = {
        object_id: pool.submit(_simulate_in_worker, design, object_id, version, setup, deadline_s, str(lake.root))
        for object_id in object_ids
    }
    wait_s = (deadline_s + HANG_MARGIN_S) * max(len(futures), 1)
    return sum(
        _collect(lake, future, design, object_id, version, setup, pool=pool, wait_s=wait_s, config_hash=config_hash)
        for object_id, future in futures.items()
    )


def append_version(lake: Lake, version: SimulatorVersion, config_hash: str = "") -> None:
    """Make sure that the lake describes this simulator version."""
    if not lake.has(SimulatorVersionRow, version.version_id):
        lake.append([SimulatorVersionRow.of(version)], current_provenance(config_hash))


def _simulate_in_worker(
    design: Design, object_id: int, version: SimulatorVersion, setup: GraspSetup, deadline_s: float, lake_root: str
) -> GraspSimulation:
    """Runs in a worker process: mesh (cached by content) and solve."""
    from models.effects.catalogue import build_effects
    from models.fem.grasp import simulate_grasp
    from models.objects.catalogue import get_object

    effects = build_effects(version.effects)
    obj = get_object(object_id)
    mesh = cached_mesh(Path(lake_root), design, version, full_width=not obj.mirror_y, effects=effects)
    return simulate_grasp(design, obj, version, setup, effects=effects, mesh=mesh, deadline_s=deadline_s)


def _collect(
    lake: Lake,
    future: "Future[GraspSimulation]",
    design: Design,
    object_id: int,
    version: SimulatorVersion,
    setup: GraspSetup,
    *,
    pool: WorkerPool,
    wait_s: float,
    config_hash: str,
) -> int:
    key: dict[str, Any] = {
        "simulation_id": SimulationRow.make_id(design.design_id, object_id, version.version_id, setup.setup_id),
        "design_id": design.design_id,
        "object_id": object_id,
        "version_id": version.version_id,
        "setup_id": setup.setup_id,
        "setup_json": canonical_json(setup.model_dump()),
    }
    provenance = current_provenance(config_hash, parents=[design.design_id, version.version_id])
    try:
        result = future.result(timeout=wait_s)
    except (SimulationFailed, MeshingFailed) as error:
        reason = error.reason
        logger.warning("simulation of %s on object %d failed: %s", design.design_id, object_id, error)
    except FutureTimeoutError:
        pool.restart()
        reason = "hang"
        logger.warning(
            "simulation of %s on object %d hung for %.0f s; worker killed", design.design_id, object_id, wait_s
        )
    except (BrokenProcessPool, CancelledError):
        reason = "worker_died"
        logger.warning("the worker simulating %s on object %d died", design.design_id, object_id)
    else:
        lake.append([SimTraceRow.of(key["simulation_id"], result.trace), _result_row(key, result)], provenance)
        return 0
    lake.append([SimulationRow(**key, status="failed", reason=reason, cpu_s=0.0)], provenance)
    return 1


def _result_row(key: dict[str, Any], result: GraspSimulation) -> SimulationRow:
    return SimulationRow(
        **key,
        status="ok",
        reason="",
        peak_force_n=result.peak_force_n,
        contact_force_n=result.contact_force_n,
        work_j=result.work_j,
        n_dof=result.n_dof,
        n_newton=result.n_newton,
        cpu_s=result.cpu_s,
    )
