"""Diagnostic runs between and after the grasps of a tool, and their rows in a table of their own."""

from collections.abc import Sequence

from hardware.cell import MeasuredGrasp
from hardware.diagnostics import NO_OBJECT, DiagnosticPlan, DiagnosticRun
from lake.provenance import Provenance
from lake.store import Lake
from lake.tables import DiagnosticRow, setup_columns
from models.errors import UsageError
from models.ids import canonical_json
from tasks.state import Cell, ProposedTool


def plan_items(
    plan: DiagnosticPlan, slot: int, missing: Sequence[Cell], n_made: int, seed: int
) -> list[Cell | DiagnosticRun]:
    """The missing grasps of a tool with reference grasps between them, and after them the protocol, where asked for.

    After, because a tool that was pulled at 20 mm/s or held closed for half a minute is no longer the one it was.
    Dead weights are left out: nobody stands by.
    """
    items = plan.with_references(missing, n_made)
    if plan.protocol_slot == slot and missing:
        items += [run for run in plan.runs(seed) if run.mass_kg is None]
    return items


def append_diagnostic(
    lake: Lake,
    provenance: Provenance,
    tool: ProposedTool,
    grasp: MeasuredGrasp,
    *,
    campaign_id: str,
    n_grasps_before: int,
    world_hash: str | None,
) -> None:
    """Write a diagnostic run; the lake's table of grasps does not see it. `world_hash` None is a real bench.

    Raises:
        UsageError: it is an ordinary grasp.
    """
    run = grasp.diagnostic
    if run is None:
        raise UsageError("An ordinary grasp is not a diagnostic run; write it to the grasps.")
    row = DiagnosticRow(
        diagnostic_id=DiagnosticRow.make_id(tool.tool_id, run.kind, grasp.started_at),
        campaign_id=campaign_id,
        tool_id=tool.tool_id,
        batch=tool.batch,
        slot=tool.slot,
        design_id=tool.design.design_id,
        kind=run.kind,
        parameters_json=canonical_json(run.parameters),
        object_id=None if run.object_id == NO_OBJECT else run.object_id,
        repeat=run.repeat,
        n_grasps_before=n_grasps_before,
        status=grasp.status,
        reason=grasp.reason,
        started_at=grasp.started_at,
        tare_force_n=grasp.tare_force_n,
        bench="real" if world_hash is None else "virtual",
        world_hash=world_hash,
        details_json=canonical_json(grasp.details),
        time_s=grasp.trace.time_s,
        lift_mm=grasp.trace.lift_mm,
        force_n=grasp.trace.force_n,
        **setup_columns(grasp.setup),
    )
    lake.append([row], provenance)
