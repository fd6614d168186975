"""An attempt at a simulated grasp as rows of the lake."""

from typing import Any

from lake.tables.campaign import SimTraceRow, SimulationRow, setup_columns
from lake.tables.row import Row
from models.ids import canonical_json
from tasks.simulation.attempt import Attempt, GraspJob


def simulation_rows(job: GraspJob, attempt: Attempt) -> list[Row]:
    """The row of a grasp and, if it succeeded, its trace; a failed one says why."""
    version_id, design_id, setup_id = job.version.version_id, job.design.design_id, job.setup.setup_id
    simulation_id = SimulationRow.make_id(design_id, job.object_id, version_id, setup_id)
    key: dict[str, Any] = {
        "simulation_id": simulation_id,
        "design_id": design_id,
        "object_id": job.object_id,
        "version_id": version_id,
        "cpu_s": attempt.cpu_s,
        **setup_columns(job.setup),
    }
    details: dict[str, Any] = {"wall_s": round(attempt.wall_s, 3)}
    result = attempt.result
    if result is None:
        details_json = canonical_json(details | {"message": attempt.message})
        return [SimulationRow(**key, status="failed", reason=attempt.reason, details_json=details_json)]
    scalars = SimulationRow(
        **key,
        status="ok",
        peak_force_n=result.peak_force_n,
        contact_force_n=result.contact_force_n,
        work_j=result.work_j,
        n_dof=result.n_dof,
        n_newton=result.n_newton,
        details_json=canonical_json(details | {"mesh_id": result.mesh_id}),
    )
    return [SimTraceRow.of(simulation_id, result.trace), scalars]
