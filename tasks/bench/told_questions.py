"""Questions about told grasps: what the lake expects of each, and what `models.traces` makes of it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

from fast.lake.tables.campaign import GraspRow, SimTraceRow, SimulationRow
from fast.models.errors import FastError
from fast.models.objects.catalogue import get_object
from fast.models.question import Question
from fast.models.records import Trace
from fast.models.traces.anomalies import TURNED
from fast.models.traces.questions import Told, find_questions
from fast.models.traces.trace_questions import ToldTrace, find_trace_questions
from fast.tasks.bench.told import ToldGrasp
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import ProposedTool

MOST_SIMULATED = 8  # cells that are simulated to compare with, half a second each
_DEADLINE_S = 20.0


class Expected(NamedTuple):
    """What the simulator gives for a tool and an object: peak force, N, and the trace, if it is kept."""

    peak_force_n: float
    trace: Trace | None = None


# The page asks about a file when it is dropped, and again when it is sent. About 30 KB a grasp.
_SIMULATED: dict[tuple[str, int, str, str, str], Expected] = {}
_MOST_KEPT = 512


def ask_about(campaign: Campaign, tools: Mapping[str, ProposedTool], told: Sequence[ToldGrasp]) -> list[Question]:
    """Ask about what is strange in told grasps, beside what cannot be used at all; `told`: with full tool ids."""
    measured = [one for one in told if one.force_n is not None and one.tool_id in tools]
    expected = _find_expected(campaign, tools, measured)
    of_traces = _ask_about_traces(measured, expected)
    odd = {number for question in of_traces for number in question.numbers}
    pulled = [number for number in range(len(measured)) if number not in odd]
    numbers = []
    for one in (measured[number] for number in pulled):
        known = expected.get(one.key[:2])
        wanted_n = known.peak_force_n if known is not None else None
        numbers.append(Told(one.place, one.tool_id, one.object_id, one.repeat, one.force_n or 0.0, wanted_n))
    found = find_questions([*numbers, *_read_before(campaign, measured)])
    asked = [q._replace(numbers=tuple(pulled[n] for n in q.numbers if n < len(numbers))) for q in found]
    return sorted([*of_traces, *(q for q in asked if q.numbers)], key=lambda question: question.numbers[0])


def _ask_about_traces(measured: Sequence[ToldGrasp], expected: Mapping[tuple[str, int], Expected]) -> list[Question]:
    traced = [number for number, one in enumerate(measured) if one.trace is not None]
    told = []
    for one in (measured[number] for number in traced):
        known, is_turned = expected.get(one.key[:2]), get_object(one.object_id).orientation == TURNED
        wanted = known.trace if known is not None else None
        told.append(ToldTrace(one.place, one.tool_id, one.object_id, is_turned, cast(Trace, one.trace), wanted))
    return [q._replace(numbers=tuple(traced[n] for n in q.numbers)) for q in find_trace_questions(told)]


def _read_before(campaign: Campaign, told: Sequence[ToldGrasp]) -> list[Told]:
    """Read what the lake has of the same tools, beside what is told now."""
    now = {one.key for one in told}
    rows = campaign.lake.records(GraspRow, tool_id=sorted({one.tool_id for one in told})) if told else []
    return [
        Told("the lake", row.tool_id, row.object_id, row.repeat, row.peak_force_n)
        for row in rows
        if row.peak_force_n is not None and row.status == "ok" and (row.tool_id, row.object_id, row.repeat) not in now
    ]


def _find_expected(
    campaign: Campaign, tools: Mapping[str, ProposedTool], told: Sequence[ToldGrasp]
) -> dict[tuple[str, int], Expected]:
    """Find what the simulator gives for tool and object: of the lake, else of some cells, simulated now."""
    cells = list(dict.fromkeys(one.key[:2] for one in told))
    design_of = {tool_id: tools[tool_id].design.design_id for tool_id, _ in cells}
    rows = campaign.lake.rows(SimulationRow, design_id=sorted(set(design_of.values()))) if cells else []
    known = {(row["design_id"], row["object_id"]): row for row in rows if row["status"] == "ok" and row["peak_force_n"]}
    ids = [row["simulation_id"] for row in known.values()]
    traces = (
        {row.simulation_id: row.trace for row in campaign.lake.records(SimTraceRow, simulation_id=ids)} if ids else {}
    )
    found = {
        cell: Expected(row["peak_force_n"], traces.get(row["simulation_id"]))
        for cell in cells
        if (row := known.get((design_of[cell[0]], cell[1]))) is not None
    }
    if len(found) < 3:
        simulated = {cell: _simulate(campaign, tools, cell) for cell in _spread(cells)}
        found |= {cell: one for cell, one in simulated.items() if one is not None and one.peak_force_n}
    return found


def _spread(cells: Sequence[tuple[str, int]]) -> list[tuple[str, int]]:
    """Choose some cells, of different tools and objects as far as there are."""
    step = max(len(cells) // MOST_SIMULATED, 1)
    step += step > 1 and len({object_id for _, object_id in cells}) % step == 0
    return list(cells[::step])[:MOST_SIMULATED]


def _simulate(campaign: Campaign, tools: Mapping[str, ProposedTool], cell: tuple[str, int]) -> Expected | None:
    """Simulate a cell; None where the simulator has no answer: then nothing is known of this cell."""
    from fast.models.simulation.grasp import simulate_grasp  # loads the kernels

    design, obj = tools[cell[0]].design, get_object(cell[1])
    version, setup = campaign.version, campaign.config.grasp
    key = (design.design_id, obj.object_id, obj.shape or "", version.version_id, setup.setup_id)
    if (known := _SIMULATED.get(key)) is not None:
        return known
    try:
        found = simulate_grasp(design, obj, version, setup, deadline_s=_DEADLINE_S)
    except FastError:
        return None
    if len(_SIMULATED) >= _MOST_KEPT:
        _SIMULATED.clear()
    return _SIMULATED.setdefault(key, Expected(found.peak_force_n, found.trace))
