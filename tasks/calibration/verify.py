"""Simulate the held-out designs with theta before and after a calibration, and score both against the bench."""

import numpy as np

from lake.provenance import current_provenance
from lake.store import Lake
from lake.tables.campaign import CalibrationRow, SimulatorVersionRow
from models.calibration.means.checks import Score, score
from models.ids import content_id
from models.scientist.surrogate.imputation import mean_over_objects
from tasks.calibration.means import CalibrationData, make_held_out_columns
from tasks.campaign.state import tuples
from tasks.simulation.plan import SimulationPlan


def plan_verification(lake: Lake, data: CalibrationData, row: CalibrationRow) -> SimulationPlan | None:
    """The held-out designs, as they were asked for, with both versions; None where there is nothing to verify."""
    if row.version_id is None or not data.held_out.any():
        return None
    designs = {d.design_id: d for d, is_out in zip(data.measured.designs, data.held_out, strict=True) if is_out}
    after = lake.records(SimulatorVersionRow, version_id=row.version_id)[0].version
    return SimulationPlan(
        points=tuple((design, version) for version in (data.base, after) for design in designs.values()),
        object_ids=data.measured.object_ids,
        setup=data.measured.setup,
        config_hash=content_id("H", {"verified": row.calibration_id}),
    )


def verify(lake: Lake, data: CalibrationData, row: CalibrationRow, plan: SimulationPlan) -> CalibrationRow:
    """Score the simulated held-out designs, once the plan is simulated; the row with the scores replaces the old one.

    Objects that failed are imputed by the paper's rule.
    """
    versions = list(dict.fromkeys(version.version_id for _, version in plan.points))
    before, after = (_score(lake, data, plan, version_id) for version_id in versions)
    if before is None or after is None:
        return row
    columns = make_held_out_columns(before, after, int(data.held_out.sum()), "simulator")
    verified = row.model_copy(update=columns)
    if verified != row:
        lake.append([verified], current_provenance(plan.config_hash, parents=data.row_ids))
    return verified


def _score(lake: Lake, data: CalibrationData, plan: SimulationPlan, version_id: str) -> Score | None:
    """None when every simulation failed."""
    place = {object_id: i for i, object_id in enumerate(plan.object_ids)}
    forces: dict[str, np.ndarray] = {}
    sql = """SELECT design_id, object_id, peak_force_n FROM simulations
        WHERE status = 'ok' AND version_id = ? AND setup_id = ?"""
    for design_id, object_id, force_n in tuples(lake, sql, version_id, plan.setup.setup_id):
        if object_id in place:
            forces.setdefault(design_id, np.full(len(place), np.nan))[place[object_id]] = force_n
    known = [i for i in np.flatnonzero(data.held_out) if data.measured.design_ids[i] in forces]
    if not known:
        return None
    predicted, _ = mean_over_objects(np.array([forces[data.measured.design_ids[i]] for i in known]))
    return score(predicted, data.problem.y_real[known])
