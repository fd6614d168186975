"""Measure one tool on the bench: every grasp goes to the lake the moment it is made."""

import logging
from collections.abc import Callable
from typing import Literal

from hardware.bench import Bench
from hardware.cell import MeasuredGrasp
from lake.tables import GraspRow, TraceRow
from models.features import initial_force_n, peak_force_n, work_j
from models.ids import canonical_json
from tasks.campaign import Campaign
from tasks.diagnosing import append_diagnostic, plan_items
from tasks.state import Cell, ProposedTool

BenchKind = Literal["virtual", "real"]

logger = logging.getLogger(__name__)


def measure_tool(
    campaign: Campaign,
    bench: Bench,
    tool: ProposedTool,
    *,
    bench_kind: BenchKind,
    world_hash: str | None,
    should_stop: Callable[[], bool],
    on_grasp: Callable[[MeasuredGrasp], None],
) -> None:
    """Make the missing grasps of a tool; those in the lake already are not repeated.

    Raises:
        DeviceError: the bench stopped in its safe state; rows made so far are in the lake.
    """
    state = campaign.state()
    plan = campaign.config.objects.cells(_order_seed(campaign, tool))
    missing = state.missing_grasps(tool, plan, campaign.config.execution.max_grasp_attempts)
    if not missing:
        return
    first_order = len(campaign.lake.rows(GraspRow, campaign_id=campaign.campaign_id))
    recorded: list[Cell] = []
    n_made = len(plan) - len(missing)
    seed = _order_seed(campaign, tool)

    def record(grasp: MeasuredGrasp) -> None:
        if grasp.diagnostic is not None:
            append_diagnostic(
                campaign.lake,
                campaign.provenance(seed, [tool.tool_id, tool.design.design_id]),
                tool,
                grasp,
                campaign_id=campaign.campaign_id,
                n_grasps_before=n_made + len(recorded),
                world_hash=world_hash,
            )
            on_grasp(grasp)
            return
        cell = (grasp.object_id, grasp.repeat)
        attempt = state.attempts(tool.tool_id, cell)
        order = first_order + len(recorded)
        _append(campaign, tool, grasp, attempt=attempt, order=order, bench_kind=bench_kind, world_hash=world_hash)
        recorded.append(cell)
        on_grasp(grasp)

    items = plan_items(campaign.config.diagnostics, tool.slot, missing, n_made, seed)
    bench.cell.measure_tool(tool.slot, items, campaign.config.grasp, record, should_stop)


def _order_seed(campaign: Campaign, tool: ProposedTool) -> int:
    """Seed of the order in which the grasps of a tool are made."""
    return campaign.seed("order", tool.tool_id)


def _append(
    campaign: Campaign,
    tool: ProposedTool,
    grasp: MeasuredGrasp,
    *,
    attempt: int,
    order: int,
    bench_kind: BenchKind,
    world_hash: str | None,
) -> None:
    grasp_id = GraspRow.make_id(tool.tool_id, grasp.object_id, grasp.repeat, attempt)
    ok = grasp.status == "ok"
    setup = campaign.config.grasp
    row = GraspRow(
        grasp_id=grasp_id,
        campaign_id=campaign.campaign_id,
        tool_id=tool.tool_id,
        batch=tool.batch,
        slot=tool.slot,
        design_id=tool.design.design_id,
        object_id=grasp.object_id,
        repeat=grasp.repeat,
        attempt=attempt,
        order=order,
        fidelity="real",
        status=grasp.status,
        reason=grasp.reason,
        started_at=grasp.started_at,
        peak_force_n=peak_force_n(grasp.trace) if ok else None,
        work_j=work_j(grasp.trace) if ok else None,
        initial_force_n=initial_force_n(grasp.trace) if ok else None,
        tare_force_n=grasp.tare_force_n,
        setup_id=setup.setup_id,
        setup_json=canonical_json(setup.model_dump()),
        bench=bench_kind,
        world_hash=world_hash,
        details_json=canonical_json(grasp.details),
    )
    provenance = campaign.provenance(_order_seed(campaign, tool), [tool.tool_id, tool.design.design_id])
    campaign.lake.append([TraceRow.of(grasp_id, grasp.trace), row], provenance)
    if not ok:
        logger.warning("grasp %s on object %d failed: %s", tool.label, grasp.object_id, grasp.reason)
