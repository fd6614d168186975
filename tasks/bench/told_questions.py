"""Questions about told numbers: what the lake expects of each, and what `models.traces.questions` makes of it."""

from collections.abc import Mapping, Sequence

from fast.lake.tables.campaign import GraspRow, SimulationRow
from fast.models.errors import FastError
from fast.models.objects.catalogue import get_object
from fast.models.traces.questions import Question, Told, find_questions
from fast.tasks.bench.told import ToldGrasp
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import ProposedTool

MOST_SIMULATED = 8  # cells that are simulated to compare with, half a second each
_DEADLINE_S = 20.0


def ask_about(campaign: Campaign, tools: Mapping[str, ProposedTool], told: Sequence[ToldGrasp]) -> list[Question]:
    """What is strange in told numbers, beside what cannot be used at all; `told`: with full tool ids."""
    measured = [one for one in told if one.force_n and one.tool_id in tools]
    expected = _find_expected(campaign, tools, measured)
    numbers = [
        Told(one.place, one.tool_id, one.object_id, one.repeat, one.force_n or 0.0, expected.get(one.key[:2]))
        for one in measured
    ]
    found = find_questions([*numbers, *_read_before(campaign, measured)])
    asked = [q._replace(numbers=tuple(number for number in q.numbers if number < len(numbers))) for q in found]
    return [question for question in asked if question.numbers]


def _read_before(campaign: Campaign, told: Sequence[ToldGrasp]) -> list[Told]:
    """What the lake has of the same tools, beside what is told now."""
    now = {one.key for one in told}
    rows = campaign.lake.records(GraspRow, tool_id=sorted({one.tool_id for one in told})) if told else []
    return [
        Told("the lake", row.tool_id, row.object_id, row.repeat, row.peak_force_n)
        for row in rows
        if row.peak_force_n and row.status == "ok" and (row.tool_id, row.object_id, row.repeat) not in now
    ]


def _find_expected(
    campaign: Campaign, tools: Mapping[str, ProposedTool], told: Sequence[ToldGrasp]
) -> dict[tuple[str, int], float]:
    """Peak force that the simulator gives for tool and object, N: of the lake, else of some cells, simulated now."""
    cells = list(dict.fromkeys(one.key[:2] for one in told))
    design_of = {tool_id: tools[tool_id].design.design_id for tool_id, _ in cells}
    rows = campaign.lake.rows(SimulationRow, design_id=sorted(set(design_of.values()))) if cells else []
    known = {(row["design_id"], row["object_id"]): row["peak_force_n"] for row in rows if row["status"] == "ok"}
    found = {cell: known.get((design_of[cell[0]], cell[1])) for cell in cells}
    if len([force_n for force_n in found.values() if force_n]) < 3:
        found |= {cell: _simulate(campaign, tools, cell) for cell in _spread(cells)}
    return {cell: force_n for cell, force_n in found.items() if force_n}


def _spread(cells: Sequence[tuple[str, int]]) -> list[tuple[str, int]]:
    """Some cells, of different tools and objects as far as there are."""
    step = max(len(cells) // MOST_SIMULATED, 1)
    step += step > 1 and len({object_id for _, object_id in cells}) % step == 0
    return list(cells[::step])[:MOST_SIMULATED]


def _simulate(campaign: Campaign, tools: Mapping[str, ProposedTool], cell: tuple[str, int]) -> float | None:
    """None where the simulator has no answer: then nothing is known of this cell."""
    from fast.models.simulation.grasp import simulate_grasp  # loads the kernels

    try:
        return simulate_grasp(
            tools[cell[0]].design,
            get_object(cell[1]),
            campaign.version,
            campaign.config.grasp,
            deadline_s=_DEADLINE_S,
        ).peak_force_n
    except FastError:
        return None
