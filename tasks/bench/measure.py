"""Measure tools on the bench: every grasp goes to the lake as it is made. Check the gantry for lost steps."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from fast.hardware.grasp_bench import GraspBench
from fast.hardware.questions import BenchQuestion
from fast.hardware.station.lost_steps import SLIP_LIMIT_MM, LostStepsError
from fast.hardware.station.station import MeasuredGrasp
from fast.lake.handoff.fields import MOST_FORCE_N
from fast.lake.leases import exclusive
from fast.lake.maintenance import LOOSE_BYTES, compact
from fast.lake.tables.campaign import GraspRow, TraceRow
from fast.lake.tables.requests import setup_columns
from fast.models.ids import canonical_json
from fast.models.records import Placement, Trace
from fast.models.traces import initial_force_n, peak_force_n, work_j
from fast.models.units import spell_number
from fast.tasks.bench.again import decide_again, note_due, plan_again
from fast.tasks.bench.leave_out import OpenPlan
from fast.tasks.bench.plan import ToolWork, plan_tool, seed_of_order
from fast.tasks.bench.questions import make_ask, withdraw_questions
from fast.tasks.bench.reference_tools import add_references, ask_references, plan_reference
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.requests import GANTRY_LEASE, append_event, note_verbs, require_room
from fast.tasks.campaign.state import ProposedTool, tuples

OpenBench = Callable[[Sequence[ProposedTool]], AbstractContextManager[GraspBench]]

SPEED_FACTOR = 4.0  # between lift speed as asked and as made: catches ms and minutes for s, m and inches for mm
_SHORT_MM = (0.5, 5.0)  # lifts that may be all ramp; shorter ones are in m

CHECKED, LOST_STEPS = "position_checked", "lost_steps"  # kinds of events

# Grasps that came after the last check; after lost steps the gantry was homed.
_SINCE_LAST_CHECK = f"""
    WITH made AS (
        SELECT DISTINCT grasp_id AS id, (sequence, created_at) AS place FROM raw_grasps WHERE campaign_id = $campaign
    ), last AS (
        SELECT max((sequence, created_at)) AS checked FROM events
        WHERE campaign_id = $campaign AND kind IN ('{CHECKED}', '{LOST_STEPS}')
    )
    SELECT id FROM made, last WHERE checked IS NULL OR place > checked ORDER BY place, id
"""

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class BenchUse:
    """How a process measures."""

    open_bench: OpenBench
    """Opens the bench with all tools that stand in its rack."""
    world_hash: str | None
    """The world behind a virtual bench; None: a real one."""
    should_stop: Callable[[], bool] = lambda: False
    """Asked before each grasp."""
    on_grasp: Callable[[ProposedTool, MeasuredGrasp], object] = lambda tool, grasp: None
    """Hears of each grasp."""
    call_person: Callable[[BenchQuestion], object] | None = None
    """Has people hear what the bench asks; None: the log does."""


@contextmanager
def hold_bench(campaign: Campaign, tools: Sequence[ProposedTool], use: BenchUse) -> Iterator[GraspBench]:
    """Hold the bench with these tools in its rack; no other process of the lake has it, and people are heard.

    Raises:
        FastError: another process holds the bench of this lake.
    """
    owned = exclusive(campaign.lake.storage, GANTRY_LEASE, "the gantry of this lake is in use")
    with owned as gantry, note_verbs(campaign.lake, campaign.campaign_id), use.open_bench(tools) as bench:
        bench.set_leave(gantry.require)
        bench.set_ask(make_ask(campaign.lake, campaign.campaign_id, use.should_stop, use.call_person))
        yield bench


def measure_tool(campaign: Campaign, bench: GraspBench, work: ToolWork, use: BenchUse) -> None:
    """Make the missing grasps of a tool, and write each to the lake; those that people leave out meanwhile are not.

    Raises:
        DeviceError: the bench stopped in its safe state; rows made so far are in the lake.
        LakeError: the disk is nearly full; no grasp was begun that could not be kept.
    """
    plan = OpenPlan(campaign, work.tool, work.items)
    if next(iter(plan), None) is None:
        return
    orders = count(find_first_order(campaign))

    def record(measured: MeasuredGrasp) -> None:
        grasp = refuse_nonsense(measured)
        _append_grasp(campaign, work, grasp, order=next(orders), world_hash=use.world_hash)
        use.on_grasp(work.tool, grasp)

    def may_not_go_on() -> bool:
        require_room(campaign.lake)
        return use.should_stop()

    bench.measure_tool(work.tool.rack_slot, plan, campaign.config.grasp, record, may_not_go_on)


MeasureTool = Callable[[Campaign, GraspBench, ToolWork, BenchUse], None]


def measure_batch(
    campaign: Campaign, tools: Sequence[ProposedTool], use: BenchUse, measure: MeasureTool = measure_tool
) -> None:
    """Have tools of a batch measured one after the other, its reference tools first; one process holds the bench.

    A person's stop or abort ends it with the bench in its safe
    state. Cells whose repeats all look wrong are measured once more at the end. The gantry is checked for lost steps at
    the end, also of a batch that is paused, and every `execution.position_check_tools` tools.

    Raises:
        FastError: another process holds the bench of this lake.
        LostLeaseError: another host took the gantry over; the bench stopped before its next motion.
        LostStepsError: the gantry was off; an event names the grasps since the last check.
        DeviceError: the bench stopped in its safe state; rows made so far are in the lake.
    """
    batch, state = tools[0].batch, campaign.state()
    # All that stands on the rack, since a finished tool may still be on the head.
    mounted = [tool for tool in state.tools_of(batch) if state.confirmed.get(tool.tool_id) == "printed"]
    ask_references(campaign, state, batch)
    note_due(campaign, batch)
    again = add_references(campaign, state, batch, mounted)
    mounted = [*mounted, *again]

    def work_on(bench: GraspBench, work: ToolWork) -> None:
        measure(campaign, bench, work, use)
        # A file for each grasp makes every look at the lake dearer: a batch would leave two thousand.
        for row_type in (GraspRow, TraceRow):
            compact(campaign.lake, row_type, LOOSE_BYTES)

    with hold_bench(campaign, mounted, use) as bench:
        every = campaign.config.execution.position_check_tools
        for tool in again:
            if use.should_stop():
                break
            work_on(bench, plan_reference(campaign, batch, tool))
        for number, tool in enumerate(tools):
            if use.should_stop():
                break
            if every and number and number % every == 0:
                check_position(campaign, bench, batch)
            work_on(bench, plan_tool(campaign, state, tool))
        for work in [] if use.should_stop() else plan_again(campaign, state, batch):
            work_on(bench, work)
        check_position(campaign, bench, batch)
    if not use.should_stop():
        withdraw_questions(campaign.lake, campaign.campaign_id)
        decide_again(campaign, batch)
        append_event(campaign.lake, campaign.campaign_id, "batch_measured", f"B{batch:02d} measured", batch=batch)


def refuse_nonsense(grasp: MeasuredGrasp) -> MeasuredGrasp:
    """Make a grasp whose trace no bench can have measured a failed one, whatever its driver says of it.

    The trace is kept up to the first sample that is no finite number.
    """
    trace = grasp.trace
    is_sound = np.isfinite(trace.time_s) & np.isfinite(trace.lift_mm) & np.isfinite(trace.force_n)
    fault = ""
    if not is_sound.all():
        n = int(np.argmin(is_sound))
        fault = f"Sample {n + 1} of {len(is_sound)} is no finite number"
        trace = Trace(trace.time_s[:n], trace.lift_mm[:n], trace.force_n[:n])
    elif (np.diff(trace.time_s) < 0).any():
        fault = f"Time goes back at sample {int(np.argmax(np.diff(trace.time_s) < 0)) + 2}"
    elif not trace.is_lift.any():
        fault = "The trace has no lift"
    elif grasp.status == "ok":
        fault = _find_other_unit(trace, grasp.setup.lift_speed_mm_per_s)
    if not fault or (grasp.status == "failed" and trace is grasp.trace):
        return grasp
    reason = grasp.reason or f"{fault}; the grasp is not counted. Look at the sensor's line and at the bench's driver."
    return replace(grasp, trace=trace, status="failed", reason=reason)


def _find_other_unit(trace: Trace, wanted: float) -> str:
    """Find words for forces or lift in another unit than N, mm and s, or an empty text; `wanted`: lift speed, mm/s."""
    largest_n = float(np.abs(trace.force_n).max())
    if largest_n > MOST_FORCE_N:
        return f"The force is {largest_n:.4g} N, a pull has at most {MOST_FORCE_N:g} N: look at its unit"
    top_mm = float(trace.lift_mm.max())
    start, end = (int(np.argmax(trace.lift_mm >= share * top_mm)) for share in (0.05, 0.95))
    took_s = float(trace.time_s[end] - trace.time_s[start])
    speed = float(trace.lift_mm[end] - trace.lift_mm[start]) / max(took_s, 1e-9)
    is_short = _SHORT_MM[0] < top_mm < _SHORT_MM[1]
    if end == start or is_short or wanted / SPEED_FACTOR <= speed <= wanted * SPEED_FACTOR:
        return ""
    found = f"The lift has {spell_number(speed, 3)} mm/s, {wanted:g} mm/s were asked for"
    return f"{found}: look at the units of time and lift"


def check_position(campaign: Campaign, bench: GraspBench, batch: int) -> None:
    """Check that the gantry is where it is counted, and keep the outcome as an event.

    Raises:
        LostStepsError: it is not; the event `lost_steps` names every grasp since the last check.
        DeviceError: a device failed on the way.
    """
    lake, name = campaign.lake, campaign.campaign_id
    since = lake.query(_SINCE_LAST_CHECK, {"campaign": name})["id"].to_pylist()
    try:
        slip_mm = bench.check_position()
    except LostStepsError as error:
        what = {"batch": batch, "slip_mm": error.slip_mm, "limit_mm": SLIP_LIMIT_MM, "grasp_ids": since}
        append_event(lake, name, LOST_STEPS, f"{error} Suspect grasps: {len(since)}.", **what)
        raise
    what = {"batch": batch, "slip_mm": slip_mm, "limit_mm": SLIP_LIMIT_MM, "n_grasps": len(since)}
    append_event(lake, name, CHECKED, f"no lost steps over {len(since)} grasps", **what)


def find_first_order(campaign: Campaign) -> int:
    """Find the place of the next grasp in its campaign: after the last, also of those that were replaced since."""
    sql = 'SELECT coalesce(max("order") + 1, 0) AS next FROM raw_grasps WHERE campaign_id = ?'
    ((order,),) = tuples(campaign.lake, sql, campaign.campaign_id)
    return int(order)


def _append_grasp(
    campaign: Campaign, work: ToolWork, grasp: MeasuredGrasp, *, order: int, world_hash: str | None
) -> None:
    tool, asked = work.tool, grasp.request
    key = (grasp.object_id, grasp.repeat) if asked is None else asked.request_id
    attempt, request_id = work.attempts.get(key, 0), asked.request_id if asked is not None else ""
    grasp_id = GraspRow.make_id(tool.tool_id, grasp.object_id, grasp.repeat, attempt, request_id, campaign.config.lab)
    ok = grasp.status == "ok"
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
        bench="real" if world_hash is None else "virtual",
        world_hash=world_hash,
        details_json=canonical_json(grasp.details),
        request_id=request_id or None,
        lab=campaign.config.lab,
        **setup_columns(grasp.setup, asked.placement if asked is not None else Placement()),
    )
    provenance = campaign.provenance(seed_of_order(campaign, tool), [tool.tool_id, tool.design.design_id])
    campaign.lake.append([TraceRow.of(grasp_id, grasp.trace), row], provenance)
    if not ok:
        logger.warning("grasp %s on object %d failed: %s", tool.label, grasp.object_id, grasp.reason)
