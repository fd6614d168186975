"""Simulate a design on its objects: one worker process for all of them, one row per grasp as it ends."""

import logging
from collections.abc import Callable
from typing import Any

from lake.simulators import missing_version_rows
from lake.tables import SimTraceRow, SimulationRow, setup_columns
from models.ids import canonical_json
from models.records import Design, GraspSimulation
from tasks.attempt import Attempt, GraspJob, answer, attempt_grasp
from tasks.campaign import Campaign
from tasks.engine import Engine

logger = logging.getLogger(__name__)


def simulate_design(
    campaign: Campaign, design: Design, *, pool: Engine, should_stop: Callable[[], bool] = lambda: False
) -> int:
    """Simulate a design on the objects it misses, all in one worker; each result, or failure, is a row at once.

    The worker is given the next grasp before the row of the last one is written, so it never waits for the lake.
    `should_stop` is asked before each object. Returns the number of failed grasps.
    """
    append_version(campaign)
    n_failed = 0
    with pool.lend() as worker:
        last: tuple[GraspJob, Attempt] | None = None
        for object_id in campaign.state().missing_objects(design.design_id, campaign.object_ids):
            if should_stop():
                break
            job = _job(campaign, design, object_id)
            future = worker.submit(attempt_grasp, job)
            if last is not None:
                n_failed += _record(campaign, *last)
            last = job, answer(worker, job, future)
        if last is not None:
            n_failed += _record(campaign, *last)
    return n_failed


def append_version(campaign: Campaign) -> None:
    """Make sure that the lake describes the campaign's simulator and its effects."""
    rows = missing_version_rows(campaign.lake, campaign.version)
    if rows:
        campaign.lake.append(rows, campaign.provenance())


def _job(campaign: Campaign, design: Design, object_id: int) -> GraspJob:
    deadline_s = campaign.config.simulator.grasp_deadline_s
    return GraspJob(design, object_id, campaign.version, campaign.config.grasp, deadline_s, campaign.lake.root)


def _record(campaign: Campaign, job: GraspJob, attempt: Attempt) -> bool:
    """Write the row of a grasp, and its trace; True when it failed."""
    version_id, design_id = job.version.version_id, job.design.design_id
    key: dict[str, Any] = {
        "simulation_id": SimulationRow.make_id(design_id, job.object_id, version_id, job.setup.setup_id),
        "design_id": design_id,
        "object_id": job.object_id,
        "version_id": version_id,
        "cpu_s": attempt.cpu_s,
        **setup_columns(job.setup),
    }
    details: dict[str, Any] = {"wall_s": round(attempt.wall_s, 3)}
    provenance = campaign.provenance(parents=[design_id, version_id])
    if attempt.result is None:
        logger.warning("simulation of %s on object %d failed: %s", design_id, job.object_id, attempt.message)
        details["message"] = attempt.message
        row = SimulationRow(**key, status="failed", reason=attempt.reason, details_json=canonical_json(details))
        campaign.lake.append([row], provenance)
        return True
    trace = SimTraceRow.of(key["simulation_id"], attempt.result.trace)
    campaign.lake.append([trace, _result_row(key, attempt.result, details)], provenance)
    return False


def _result_row(key: dict[str, Any], result: GraspSimulation, details: dict[str, Any]) -> SimulationRow:
    return SimulationRow(
        **key,
        status="ok",
        reason="",
        peak_force_n=result.peak_force_n,
        contact_force_n=result.contact_force_n,
        work_j=result.work_j,
        n_dof=result.n_dof,
        n_newton=result.n_newton,
        details_json=canonical_json(details | {"mesh_id": result.mesh_id}),
    )
