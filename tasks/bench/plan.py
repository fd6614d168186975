"""What is still to be done with a tool on the bench: its missing grasps and the diagnostic runs it owes, in order."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from fast.hardware.cell.diagnostics import NO_OBJECT, DiagnosticPlan, DiagnosticRun, Item
from fast.lake.store import Lake
from fast.models.ids import canonical_json
from fast.models.records import BENCH_FAULT
from fast.tasks.bench.asked import read_open_requests
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState, Cell, ProposedTool, tuples


@dataclass(frozen=True)
class ToolWork:
    """What is to be done with a tool.

    Attributes:
        items: grasps, diagnostic runs and grasps that a search asks for, in order.
        n_made: grasps that were made with it before; with a reference tool, grasps of its batch.
        done: grasps that are in the lake.
        attempts: number of the next attempt at a grasp, where it is not 0; of an asked one by the id of its request.
    """

    tool: ProposedTool
    items: Sequence[Item]
    n_made: int = 0
    done: frozenset[Cell] = frozenset()
    attempts: Mapping[Cell | str, int] = field(default_factory=dict)


def plan_tool(campaign: Campaign, state: CampaignState, tool: ProposedTool) -> ToolWork:
    """What a tool owes after what the lake has of it."""
    plan, limit = campaign.config.diagnostics, campaign.config.max_grasp_attempts
    missing = state.missing_grasps(tool, order_cells(campaign, tool), limit)
    n_made = campaign.config.objects.n_grasps - len(missing)
    items = order_items(plan, missing, n_made, find_missing_runs(campaign, state, tool))
    done = frozenset(state.measured.get(tool.tool_id, ()))
    return ToolWork(tool, items, n_made, done, {cell: state.next_attempt(tool.tool_id, cell) for cell in missing})


def plan_asked(lake: Lake, tool: ProposedTool, search_id: str | None = None) -> ToolWork:
    """The grasps of a tool that a search, or any, asks for and that are not made yet, in their order."""
    found = read_open_requests(lake, search_id=search_id, tool_id=tool.tool_id)
    items = [request for request, _ in found]
    return ToolWork(tool, items, attempts={request.request_id: n for request, n in found})


def order_cells(campaign: Campaign, tool: ProposedTool) -> list[Cell]:
    """All (object, repeat) of a tool in the order in which they are made, the same after every restart."""
    return campaign.config.objects.cells(seed_of_order(campaign, tool))


def seed_of_order(campaign: Campaign, tool: ProposedTool) -> int:
    """Seed of the order in which the grasps of a tool are made."""
    return campaign.seed("order", tool.tool_id)


_Key = tuple[str, str, int | None, int]  # kind, knobs as JSON, object, repeat

_RUNS = f"""
    SELECT kind, parameters_json, object_id, repeat, status = 'ok' AS is_good FROM diagnostics
    WHERE tool_id = ? AND coalesce(details_json ->> '$.end', '') <> '{BENCH_FAULT}'
"""


def draw_protocol(campaign: Campaign, tool: ProposedTool) -> list[DiagnosticRun]:
    """The experiments that a batch makes with a tool after its grasps, in an order that every start draws again.

    Dead weights are left out: nobody stands by.
    """
    plan = campaign.config.diagnostics
    if plan.protocol_slot != tool.slot:
        return []
    return [run for run in plan.runs(campaign.seed("order", tool.tool_id)) if run.mass_kg is None]


def find_missing_runs(campaign: Campaign, state: CampaignState, tool: ProposedTool) -> list[DiagnosticRun]:
    """Runs of the protocol that a tool still owes, in order; as with grasps, two failures of its own end a run."""
    runs = draw_protocol(campaign, tool)
    if not runs or not state.is_to_be_had(tool):
        return []
    good, failed = _read_runs(campaign.lake, tool)
    limit = campaign.config.max_grasp_attempts
    return [run for run in runs if not good[_key(run)] and failed[_key(run)] < limit]


def order_items(
    plan: DiagnosticPlan, missing: Sequence[Cell], n_made: int, runs: Sequence[DiagnosticRun]
) -> list[Item]:
    """The missing grasps of a tool with reference grasps between them, and after them the runs that it owes.

    After, because a tool that was pulled at 20 mm/s or held closed for half a minute is no longer the one it was.
    """
    return [*plan.with_references(missing, n_made), *runs]


def _read_runs(lake: Lake, tool: ProposedTool) -> tuple[Counter[_Key], Counter[_Key]]:
    """Good runs of a tool, and those that failed by themselves; runs cut short by the bench are neither."""
    good, failed = Counter[_Key](), Counter[_Key]()
    for *key, is_good in tuples(lake, _RUNS, tool.tool_id):
        (good if is_good else failed)[tuple(key)] += 1
    return good, failed


def _key(run: DiagnosticRun) -> _Key:
    object_id = None if run.object_id == NO_OBJECT else run.object_id
    return run.kind, canonical_json(run.parameters), object_id, run.repeat
