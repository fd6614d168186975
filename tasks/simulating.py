"""Simulate a design on its objects: one worker process for all of them, one row per grasp as it ends."""

import logging
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from lake.tables import SimTraceRow, SimulationRow, SimulatorVersionRow, setup_columns
from models.ids import canonical_json
from models.records import Design, GraspSimulation
from tasks.attempt import Attempt, GraspJob, attempt_grasp
from tasks.campaign import Campaign
from tasks.pool import Worker, WorkerPool

logger = logging.getLogger(__name__)

ATTEMPTS = 2
HANG_MARGIN_S = 60.0  # wall time past a grasp's own deadline after which its worker is taken to hang


def simulate_design(
    campaign: Campaign, design: Design, *, pool: WorkerPool, should_stop: Callable[[], bool] = lambda: False
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
            last = job, _answer(worker, job, future)
        if last is not None:
            n_failed += _record(campaign, *last)
    return n_failed


def append_version(campaign: Campaign) -> None:
    """Make sure that the lake describes the campaign's simulator."""
    version = campaign.version
    if not campaign.lake.has(SimulatorVersionRow, version.version_id):
        campaign.lake.append([SimulatorVersionRow.of(version)], campaign.provenance())


def _job(campaign: Campaign, design: Design, object_id: int) -> GraspJob:
    deadline_s = campaign.config.simulator.grasp_deadline_s
    return GraspJob(design, object_id, campaign.version, campaign.config.grasp, deadline_s, campaign.lake.root)


def _answer(worker: Worker, job: GraspJob, future: "Future[Attempt]") -> Attempt:
    """What the worker says; one that hangs is killed, one that died (once may be bad luck) is asked again."""
    started = time.monotonic()
    for attempt in range(ATTEMPTS):
        if attempt > 0:
            future = worker.submit(attempt_grasp, job)
        try:
            return future.result(timeout=job.deadline_s + HANG_MARGIN_S)
        except FutureTimeoutError:
            worker.restart()
            message = f"no answer for {job.deadline_s + HANG_MARGIN_S:.0f} s; worker killed"
            return _lost("hang", message, started)
        except (BrokenProcessPool, CancelledError):
            logger.warning("a worker died at %s on object %d", job.design.design_id, job.object_id)
    return _lost("worker_died", f"its worker died {ATTEMPTS} times", started)


def _lost(reason: str, message: str, started: float) -> Attempt:
    """An attempt of which nobody is left to say what CPU time it took; at most its wall time."""
    wall_s = time.monotonic() - started
    return Attempt(None, reason, message, cpu_s=wall_s, mesh_cpu_s=0.0, wall_s=wall_s)


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
    provenance = campaign.provenance(parents=[design_id, version_id])
    if attempt.result is None:
        logger.warning("simulation of %s on object %d failed: %s", design_id, job.object_id, attempt.message)
        details = canonical_json({"message": attempt.message, "wall_s": round(attempt.wall_s, 3)})
        row = SimulationRow(**key, status="failed", reason=attempt.reason, details_json=details)
        campaign.lake.append([row], provenance)
        return True
    trace = SimTraceRow.of(key["simulation_id"], attempt.result.trace)
    campaign.lake.append([trace, _result_row(key, attempt.result)], provenance)
    return False


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
    )
