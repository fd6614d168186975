"""Simulate a design on its objects: one FEM grasp per object in a worker process, one row per grasp."""

import logging
from collections.abc import Callable
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from lake.tables import SimTraceRow, SimulationRow, SimulatorVersionRow
from models.errors import MeshingFailed, SimulationFailed
from models.ids import canonical_json
from models.records import Design, GraspSetup, GraspSimulation, SimulatorVersion
from tasks.campaign import Campaign
from tasks.mesh_cache import cached_mesh
from tasks.pool import WorkerPool

logger = logging.getLogger(__name__)

ATTEMPTS = 2
HANG_MARGIN_S = 60.0  # wall time past a grasp's own deadline after which its worker is taken to hang


def simulate_design(
    campaign: Campaign, design: Design, *, pool: WorkerPool, should_stop: Callable[[], bool] = lambda: False
) -> int:
    """Simulate a design on the objects it misses, one after the other; each result, or failure, is a row at once.

    `should_stop` is asked before each object. Returns the number of failed grasps.
    """
    append_version(campaign)
    n_failed = 0
    for object_id in campaign.state().missing_objects(design.design_id, campaign.object_ids):
        if should_stop():
            break
        n_failed += _simulate_grasp(campaign, design, object_id, pool)
    return n_failed


def append_version(campaign: Campaign) -> None:
    """Make sure that the lake describes the campaign's simulator."""
    version = campaign.version
    if not campaign.lake.has(SimulatorVersionRow, version.version_id):
        campaign.lake.append([SimulatorVersionRow.of(version)], campaign.provenance())


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


def _simulate_grasp(campaign: Campaign, design: Design, object_id: int, pool: WorkerPool) -> bool:
    """One grasp in a worker process, and its row; True when it failed."""
    version_id, setup = campaign.version.version_id, campaign.config.grasp
    key: dict[str, Any] = {
        "simulation_id": SimulationRow.make_id(design.design_id, object_id, version_id, setup.setup_id),
        "design_id": design.design_id,
        "object_id": object_id,
        "version_id": version_id,
        "setup_id": setup.setup_id,
        "setup_json": canonical_json(setup.model_dump()),
    }
    provenance = campaign.provenance(parents=[design.design_id, version_id])
    try:
        result = _solve(campaign, design, object_id, pool)
    except (SimulationFailed, MeshingFailed) as error:
        logger.warning("simulation of %s on object %d failed: %s", design.design_id, object_id, error)
        row = SimulationRow(**key, status="failed", reason=error.reason, cpu_s=0.0)
        campaign.lake.append([row], provenance)
        return True
    trace = SimTraceRow.of(key["simulation_id"], result.trace)
    campaign.lake.append([trace, _result_row(key, result)], provenance)
    return False


def _solve(campaign: Campaign, design: Design, object_id: int, pool: WorkerPool) -> GraspSimulation:
    """Result of a worker; a worker that hangs or dies is a failed simulation.

    A dying worker takes its neighbours' work along, so the first death is not held against this grasp.
    """
    deadline_s = campaign.config.simulator.grasp_deadline_s
    arguments = (design, object_id, campaign.version, campaign.config.grasp, deadline_s, str(campaign.lake.root))
    for _ in range(ATTEMPTS):
        try:
            return pool.submit(_simulate_in_worker, *arguments).result(timeout=deadline_s + HANG_MARGIN_S)
        except FutureTimeoutError as error:
            pool.restart()
            raise SimulationFailed(
                f"no answer for {deadline_s + HANG_MARGIN_S:.0f} s; worker killed", "hang"
            ) from error
        except (BrokenProcessPool, CancelledError):
            logger.warning("a worker died while %s was simulated on object %d", design.design_id, object_id)
    raise SimulationFailed(f"its worker died {ATTEMPTS} times", "worker_died")


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
