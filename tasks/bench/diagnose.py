"""Diagnostic runs between and after the grasps of a tool, and their rows in a table of their own."""

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hardware.cell.diagnostics import NO_OBJECT, DiagnosticPlan, DiagnosticRun
from lake.provenance import Provenance
from lake.store import Lake
from lake.tables.campaign import DiagnosticRow, setup_columns
from models.errors import UsageError
from models.ids import canonical_json
from models.records import BENCH_FAULT
from tasks.campaign.campaign import Campaign
from tasks.campaign.state import CampaignState, Cell, ProposedTool, tuples

if TYPE_CHECKING:
    from hardware.cell.cell import MeasuredGrasp  # with its drivers, which a look at the lake does without

_Key = tuple[str, str, int | None, int]  # kind, knobs as JSON, object, repeat

_DONE = f"""
    SELECT kind, parameters_json, object_id, repeat, status = 'ok' AS is_good FROM diagnostics
    WHERE tool_id = ? AND coalesce(details_json ->> '$.end', '') <> '{BENCH_FAULT}'
"""


def protocol_runs(campaign: Campaign, tool: ProposedTool) -> list[DiagnosticRun]:
    """The experiments that a batch makes with a tool after its grasps, in an order that every start draws again.

    Dead weights are left out: nobody stands by.
    """
    plan = campaign.config.diagnostics
    if plan.protocol_slot != tool.slot:
        return []
    return [run for run in plan.runs(campaign.seed("order", tool.tool_id)) if run.mass_kg is None]


def missing_runs(campaign: Campaign, state: CampaignState, tool: ProposedTool) -> list[DiagnosticRun]:
    """Runs of the protocol that a tool still owes, in order; as with grasps, two failures of its own end a run."""
    runs = protocol_runs(campaign, tool)
    if not runs or not state.is_to_be_had(tool):
        return []
    good, failed = _done(campaign.lake, tool)
    limit = campaign.config.execution.max_grasp_attempts
    return [run for run in runs if not good[_key(run)] and failed[_key(run)] < limit]


def plan_items(
    plan: DiagnosticPlan, missing: Sequence[Cell], n_made: int, runs: Sequence[DiagnosticRun]
) -> list[Cell | DiagnosticRun]:
    """The missing grasps of a tool with reference grasps between them, and after them the runs that it owes.

    After, because a tool that was pulled at 20 mm/s or held closed for half a minute is no longer the one it was.
    """
    return [*plan.with_references(missing, n_made), *runs]


def _done(lake: Lake, tool: ProposedTool) -> tuple[Counter[_Key], Counter[_Key]]:
    """Good runs of a tool, and those that failed by themselves; runs cut short by the bench are neither."""
    good, failed = Counter[_Key](), Counter[_Key]()
    for *key, is_good in tuples(lake, _DONE, tool.tool_id):
        (good if is_good else failed)[tuple(key)] += 1
    return good, failed


def _key(run: DiagnosticRun) -> _Key:
    object_id = None if run.object_id == NO_OBJECT else run.object_id
    return run.kind, canonical_json(run.parameters), object_id, run.repeat


def append_diagnostic(
    lake: Lake,
    provenance: Provenance,
    tool: ProposedTool,
    grasp: "MeasuredGrasp",
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
