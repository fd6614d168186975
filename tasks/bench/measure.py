"""Measure tools on the bench: every grasp goes to the lake the moment it is made."""

import logging
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from itertools import count

from hardware.bench import Bench
from hardware.cell.cell import MeasuredGrasp
from lake.tables.campaign import GraspRow, TraceRow
from models.ids import canonical_json
from models.traces import initial_force_n, peak_force_n, work_j
from tasks.bench.diagnose import append_diagnostic, missing_runs, plan_items
from tasks.bench.position_check import check_position
from tasks.bench.reference_grasps import References
from tasks.campaign.campaign import Campaign
from tasks.campaign.requests import append_event, exclusive, require_room, verbs_noted
from tasks.campaign.state import Cell, ProposedTool, tuples

OpenBench = Callable[[Sequence[ProposedTool]], AbstractContextManager[Bench]]
MeasureTool = Callable[[Bench, ProposedTool, Callable[[MeasuredGrasp], None]], None]

logger = logging.getLogger(__name__)


def measure_batch(
    campaign: Campaign,
    tools: Sequence[ProposedTool],
    open_bench: OpenBench,
    measure: MeasureTool,
    *,
    should_stop: Callable[[], bool],
    on_grasp: Callable[[ProposedTool, MeasuredGrasp], None],
) -> None:
    """Have tools of one batch measured one after the other; only one process may hold the bench of a lake.

    `open_bench` is given all tools that stand on the rack. A person's stop or abort ends it with the bench in its safe
    state. The gantry is checked for lost steps at the end, also of a batch that is paused, and every
    `execution.position_check_tools` tools.

    Raises:
        FastError: another process holds the bench of this lake.
        LostStepsError: the gantry was off; an event names the grasps since the last check.
        DeviceError: the bench stopped in its safe state; rows made so far are in the lake.
    """
    batch, state = tools[0].batch, campaign.state()
    # All that stands on the rack, since a finished tool may still be on the head.
    mounted = [tool for tool in state.tools_of(batch) if state.confirmed.get(tool.tool_id) == "printed"]
    references = References(campaign, batch)
    mounted = references.added_to(mounted)
    noted = verbs_noted(campaign.lake, campaign.campaign_id)
    with exclusive(campaign.lake, "gantry", "the gantry of this lake is in use"), noted, open_bench(mounted) as bench:
        every = campaign.config.execution.position_check_tools
        for number, tool in enumerate(tools):
            if should_stop():
                break
            if every and number and number % every == 0:
                check_position(campaign, bench, batch)
            for item in (*references.due(), tool):
                measure(bench, item, partial(on_grasp, item))
        for item in references.due(is_last=True):
            measure(bench, item, partial(on_grasp, item))
        check_position(campaign, bench, batch)
    if not should_stop():
        append_event(campaign.lake, campaign.campaign_id, "batch_measured", f"B{batch:02d} measured", batch=batch)


def measure_tool(
    campaign: Campaign,
    bench: Bench,
    tool: ProposedTool,
    *,
    world_hash: str | None,
    should_stop: Callable[[], bool],
    on_grasp: Callable[[MeasuredGrasp], None],
) -> None:
    """Make the missing grasps of a tool and the diagnostic runs it owes; those in the lake are not repeated.

    `world_hash` names the world of a virtual bench; None is a real one.

    Raises:
        DeviceError: the bench stopped in its safe state; rows made so far are in the lake.
        LakeError: the disk is nearly full; no grasp was begun that could not be kept.
    """
    state, limit = campaign.state(), campaign.config.execution.max_grasp_attempts
    missing = state.missing_grasps(tool, planned_cells(campaign, tool), limit)
    references = References(campaign, tool.batch)
    runs = references.runs() if tool == references.tool else missing_runs(campaign, state, tool)
    if not (missing or runs):
        return
    orders = count(_first_order(campaign))
    made_before = campaign.config.objects.n_grasps - len(missing)
    if tool == references.tool:
        made_before = references.n_grasps()
    n_made = made_before

    def record(grasp: MeasuredGrasp) -> None:
        nonlocal n_made
        if grasp.diagnostic is not None:
            _append_run(campaign, tool, grasp, n_made, world_hash)
            on_grasp(grasp)
            return
        n_made += 1
        attempt = state.next_attempt(tool.tool_id, (grasp.object_id, grasp.repeat))
        order = next(orders)
        _append(campaign, tool, grasp, attempt=attempt, order=order, world_hash=world_hash)
        on_grasp(grasp)

    def may_not_go_on() -> bool:
        require_room(campaign.lake)
        return should_stop()

    items = plan_items(campaign.config.diagnostics, missing, made_before, runs)
    bench.cell.measure_tool(tool.rack_slot, items, campaign.config.grasp, record, may_not_go_on)


def _append_run(
    campaign: Campaign, tool: ProposedTool, grasp: MeasuredGrasp, n_made: int, world_hash: str | None
) -> None:
    provenance = campaign.provenance(_order_seed(campaign, tool), [tool.tool_id, tool.design.design_id])
    name = campaign.campaign_id
    append_diagnostic(
        campaign.lake, provenance, tool, grasp, campaign_id=name, n_grasps_before=n_made, world_hash=world_hash
    )


def planned_cells(campaign: Campaign, tool: ProposedTool) -> list[Cell]:
    """All (object, repeat) of a tool in the order in which they are made, the same after every restart."""
    return campaign.config.objects.cells(_order_seed(campaign, tool))


def _first_order(campaign: Campaign) -> int:
    """Place of the next grasp in its campaign: after the last, also of those that were replaced since."""
    sql = 'SELECT coalesce(max("order") + 1, 0) AS next FROM raw_grasps WHERE campaign_id = ?'
    ((order,),) = tuples(campaign.lake, sql, campaign.campaign_id)
    return int(order)


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
        bench="real" if world_hash is None else "virtual",
        world_hash=world_hash,
        details_json=canonical_json(grasp.details),
    )
    provenance = campaign.provenance(_order_seed(campaign, tool), [tool.tool_id, tool.design.design_id])
    campaign.lake.append([TraceRow.of(grasp_id, grasp.trace), row], provenance)
    if not ok:
        logger.warning("grasp %s on object %d failed: %s", tool.label, grasp.object_id, grasp.reason)
