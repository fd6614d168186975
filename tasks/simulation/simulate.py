"""Simulate a design on its objects: one worker process for all of them, rows of the lake every few seconds."""

import logging
import time
from collections.abc import Callable
from typing import Any

from fast.lake.tables.campaign import Row, SimTraceRow, SimulationRow
from fast.lake.tables.catalogue_rows import append_version
from fast.lake.tables.requests import setup_columns
from fast.models.ids import canonical_json
from fast.models.objects.catalogue import get_object
from fast.models.records import Design
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.simulation.attempt import Attempt, GraspJob, attempt_grasp, await_attempt
from fast.tasks.simulation.engine import Engine

logger = logging.getLogger(__name__)

WRITE_S = 5.0  # of finished simulations, at most, that a crash takes; a longer one is written as it ends


def simulate_design(
    campaign: Campaign, design: Design, *, pool: Engine, should_stop: Callable[[], bool] = lambda: False
) -> int:
    """Simulate a design on the objects it misses, all in one worker; each result, or failure, becomes a row.

    The worker is given the next grasp before the row of the last one is written, so it never waits for the lake.
    `should_stop` is asked before each object. Returns the number of failed grasps.
    """
    append_version(campaign.lake, campaign.version, campaign.provenance())
    n_failed = 0
    state = campaign.state()
    with pool.lend() as worker, _Writer(campaign, design) as writer:
        last: tuple[GraspJob, Attempt] | None = None
        for object_id in state.missing_objects(design.design_id, campaign.object_ids):
            if should_stop():
                break
            job = GraspJob(
                design,
                get_object(object_id),
                campaign.version,
                campaign.config.grasp,
                campaign.config.simulator.grasp_deadline_s,
                campaign.lake.root,
            )
            future = worker.submit(attempt_grasp, job)
            if last is not None:
                n_failed += writer.add(*last)
            last = job, await_attempt(worker, job, future)
        if last is not None:
            n_failed += writer.add(*last)
    return n_failed


class _Writer:
    """Writes the rows of a design when `WRITE_S` have passed since the last were, and when the `with` block ends.

    A file of rows costs the campaign's process 7 ms, a row in it one. What a crash takes is simulated again.
    """

    def __init__(self, campaign: Campaign, design: Design) -> None:
        self._campaign = campaign
        self._provenance = campaign.provenance(parents=[design.design_id, campaign.version.version_id])
        self._rows: list[Row] = []
        self._written_s = time.monotonic()

    def __enter__(self) -> "_Writer":
        return self

    def __exit__(self, *exception: object) -> None:
        self._write()

    def add(self, job: GraspJob, attempt: Attempt) -> bool:
        """Take the row of a grasp, and its trace; True when it failed."""
        self._rows += simulation_rows(job, attempt)
        if time.monotonic() - self._written_s >= WRITE_S:
            self._write()
        return attempt.result is None

    def _write(self) -> None:
        if self._rows:
            self._campaign.lake.append(self._rows, self._provenance)
        self._rows, self._written_s = [], time.monotonic()


def simulation_rows(job: GraspJob, attempt: Attempt) -> list[Row]:
    """Return the row of a grasp and, if it succeeded, its trace; a failed one says why, as does the log."""
    version_id, design_id, how = job.version.version_id, job.design.design_id, setup_columns(job.setup, job.placement)
    simulation_id = SimulationRow.make_id(design_id, job.object_id, version_id, how["setup_id"])
    key: dict[str, Any] = {
        "simulation_id": simulation_id,
        "design_id": design_id,
        "object_id": job.object_id,
        "version_id": version_id,
        "cpu_s": attempt.cpu_s,
        **how,
    }
    details: dict[str, Any] = {"wall_s": round(attempt.wall_s, 3)}
    result = attempt.result
    if result is None:
        logger.warning("simulation of %s on object %d failed: %s", design_id, job.object_id, attempt.message)
        details_json = canonical_json(details | {"message": attempt.message})
        return [SimulationRow(**key, status="failed", reason=attempt.reason, details_json=details_json)]
    details["mesh_id"] = result.mesh_id
    scalars = SimulationRow(
        **key,
        status="ok",
        peak_force_n=result.peak_force_n,
        contact_force_n=result.contact_force_n,
        work_j=result.work_j,
        n_dof=result.n_dof,
        n_newton=result.n_newton,
        flag=result.flag,
        pressure_kpa=result.pressure_kpa,
        details_json=canonical_json(details),
    )
    return [SimTraceRow.of(simulation_id, result.trace), scalars]
