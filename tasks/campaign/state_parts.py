"""What follows from the rows of a campaign, brought up to date row by row: the parts of its state."""

import json
from collections import defaultdict
from collections.abc import Iterable
from typing import Any, Generic, NamedTuple, TypeVar

from lake.tables.campaign import ToolRow
from models.design.space import PARAMETERS
from models.records import BENCH_FAULT, Design
from tasks.campaign.state import THICKNESSES, Cell, ProposedSimulation, ProposedTool


class Question(NamedTuple):
    """Of which campaign the state is asked for, and which simulations count or did."""

    campaign_id: str
    setup_id: str
    version_ids: frozenset[str]
    older_ids: frozenset[str]


class ProposalPart(NamedTuple):
    """What the state needs of a proposal; names after `created_us` (since 1970) are columns, the id first."""

    created_us: int
    proposal_id: str
    campaign_id: str
    batch: int
    slot: int
    index: int  # type: ignore[assignment]  # a column of the lake, and here no method of tuples
    fidelity: str
    design_id: str


class ToolPart(NamedTuple):
    """The same of a printed tool; thicknesses are in the order of `THICKNESSES`."""

    created_us: int
    tool_id: str
    campaign_id: str
    status: str
    rack_slot: int | None
    measured_front_thickness_mm: float | None
    measured_back_thickness_mm: float | None
    measured_rib_thickness_mm: float | None


class GraspPart(NamedTuple):
    """The same of a grasp."""

    created_us: int
    grasp_id: str
    campaign_id: str
    tool_id: str
    object_id: int
    repeat: int
    attempt: int
    status: str
    batch: int
    bench: str
    details_json: str


class SimulationPart(NamedTuple):
    """The same of a simulation."""

    created_us: int
    simulation_id: str
    setup_id: str
    version_id: str
    design_id: str
    object_id: int
    status: str


R = TypeVar("R", bound=tuple[Any, ...])


class _Latest(Generic[R]):
    """Rows by id, the latest of each; a row starts with when it came and its id."""

    def __init__(self) -> None:
        self.by_id: dict[str, R] = {}

    def add(self, row: R) -> bool:
        """Take a row; False when a later one is held."""
        held = self.by_id.get(row[1])
        if held is not None and held[0] > row[0]:
            return False
        self.by_id[row[1]] = row
        return True


class Plans:
    """What the scientist proposed, and what was printed of it."""

    def __init__(self, question: Question) -> None:
        self._campaign_id = question.campaign_id
        self._proposals, self._tools = _Latest[ProposalPart](), _Latest[ToolPart]()
        self._designs, self._made = _Latest[tuple[Any, ...]](), dict[str, Design]()

    def add_proposals(self, rows: Iterable[tuple[Any, ...]]) -> None:
        """Take proposals of any campaign."""
        for row in map(ProposalPart._make, rows):
            if row.campaign_id == self._campaign_id:
                self._proposals.add(row)

    def add_tools(self, rows: Iterable[tuple[Any, ...]]) -> None:
        """Take printed tools of any campaign."""
        for row in map(ToolPart._make, rows):
            if row.campaign_id == self._campaign_id:
                self._tools.add(row)

    def add_designs(self, rows: Iterable[tuple[Any, ...]]) -> None:
        """Take designs: when they came, id, `PARAMETERS`."""
        for row in rows:
            self._designs.add(row)
            self._made.pop(row[1], None)

    def fields(self) -> dict[str, Any]:
        """Their fields of `tasks.campaign.state.CampaignState`."""
        proposals = sorted(self._proposals.by_id.values())  # by time and id
        return {
            "tools": tuple(self._tool(row) for row in proposals if row.fidelity == "real"),
            "simulations": tuple(
                ProposedSimulation(row.proposal_id, row.batch, row.index, self._design(row.design_id))
                for row in proposals
                if row.fidelity == "sim"
            ),
            "confirmed": {row.tool_id: row.status for row in self._tools.by_id.values()},
        }

    def _tool(self, row: ProposalPart) -> ProposedTool:
        tool_id = ToolRow.make_id(self._campaign_id, row.batch, row.slot)
        design, said = self._design(row.design_id), self._tools.by_id.get(tool_id)
        if said is None:
            return ProposedTool(tool_id, row.batch, row.slot, design)
        thicknesses = {name: getattr(said, f"measured_{name}") for name in THICKNESSES}
        measured_mm = {name: value for name, value in thicknesses.items() if value is not None}
        return ProposedTool(tool_id, row.batch, row.slot, design, said.rack_slot, measured_mm)

    def _design(self, design_id: str) -> Design:
        if design_id not in self._made:
            values = dict(zip(PARAMETERS, self._designs.by_id[design_id][2:], strict=True))
            self._made[design_id] = Design.model_validate(values)
        return self._made[design_id]


class _ToolProgress(NamedTuple):
    """What came of the grasps of a tool; `real_batch` is 0 on a virtual bench."""

    measured: set[Cell]
    failures: dict[tuple[str, Cell], int]
    next_attempts: dict[tuple[str, Cell], int]
    real_batch: int


class Grasps:
    """Grasps of the campaign by tool; what follows from them is found again for tools that had news."""

    def __init__(self, question: Question) -> None:
        self._campaign_id = question.campaign_id
        self._rows, self._traces = _Latest[GraspPart](), set[str]()
        self._of_tool: dict[str, set[str]] = defaultdict(set)
        self._known: dict[str, _ToolProgress] = {}

    def add(self, rows: Iterable[tuple[Any, ...]]) -> None:
        """Take grasps of any campaign."""
        for row in map(GraspPart._make, rows):
            if row.campaign_id == self._campaign_id and self._rows.add(row):
                self._of_tool[row.tool_id].add(row.grasp_id)
                self._known.pop(row.tool_id, None)

    def add_traces(self, rows: Iterable[tuple[Any, ...]]) -> None:
        """Take the ids of grasps that have a trace, each after when it came."""
        for _, grasp_id in rows:
            self._traces.add(grasp_id)
            if (row := self._rows.by_id.get(grasp_id)) is not None:
                self._known.pop(row.tool_id, None)

    def fields(self) -> dict[str, Any]:
        """Their fields of `tasks.campaign.state.CampaignState`."""
        for tool_id, grasp_ids in self._of_tool.items():
            if tool_id not in self._known:
                self._known[tool_id] = self._look_at(tool_id, grasp_ids)
        tools = self._known
        return {
            "measured": {tool_id: tool.measured for tool_id, tool in tools.items() if tool.measured},
            "failures": {key: n for tool in tools.values() for key, n in tool.failures.items()},
            "next_attempts": {key: n for tool in tools.values() for key, n in tool.next_attempts.items()},
            "batch_on_rack": max((tool.real_batch for tool in tools.values()), default=0),
        }

    def _look_at(self, tool_id: str, grasp_ids: Iterable[str]) -> _ToolProgress:
        measured: set[Cell] = set()
        failures: dict[tuple[str, Cell], int] = defaultdict(int)
        next_attempts: dict[tuple[str, Cell], int] = {}
        lost: dict[tuple[str, Cell], int] = {}
        rows = sorted((self._rows.by_id[grasp_id] for grasp_id in grasp_ids), key=lambda row: row.attempt)
        for row in rows:
            cell = (row.object_id, row.repeat)
            if row.status != "ok":
                failures[tool_id, cell] += not _is_cut_short(row)
                next_attempts[tool_id, cell] = row.attempt + 1
            elif row.grasp_id in self._traces:
                measured.add(cell)
            else:
                lost[tool_id, cell] = row.attempt
        real_batch = max((row.batch for row in rows if row.bench == "real"), default=0)
        return _ToolProgress(measured, dict(failures), next_attempts | lost, real_batch)


class Simulations:
    """Simulations that count for the campaign, or did, by design."""

    def __init__(self, question: Question) -> None:
        self._question, self._rows = question, _Latest[SimulationPart]()
        self._of_design: dict[str, set[str]] = defaultdict(set)
        self._stale: set[str] = set()
        self._present: dict[str, set[int]] = {}
        self._before: dict[str, set[int]] = {}
        self._fruitful: set[str] = set()

    def add(self, rows: Iterable[tuple[Any, ...]]) -> None:
        """Take simulations of any setup and version."""
        setup_id, wanted = self._question.setup_id, self._question.version_ids | self._question.older_ids
        for row in map(SimulationPart._make, rows):
            if row.setup_id == setup_id and row.version_id in wanted and self._rows.add(row):
                self._of_design[row.design_id].add(row.simulation_id)
                self._stale.add(row.design_id)

    def fields(self) -> dict[str, Any]:
        """Their fields of `tasks.campaign.state.CampaignState`."""
        for design_id in self._stale:
            self._look_at(design_id)
        self._stale.clear()
        return {
            "simulated": dict(self._present),
            "simulated_before": dict(self._before),
            "fruitful": frozenset(self._fruitful),
        }

    def _look_at(self, design_id: str) -> None:
        rows = [self._rows.by_id[simulation_id] for simulation_id in self._of_design[design_id]]
        counting = self._question.version_ids
        for held, is_counting in ((self._present, True), (self._before, False)):
            if object_ids := {row.object_id for row in rows if (row.version_id in counting) is is_counting}:
                held[design_id] = object_ids
        if any(row.status == "ok" for row in rows):
            self._fruitful.add(design_id)
        else:
            self._fruitful.discard(design_id)  # a later row may have taken the result back


def _is_cut_short(row: GraspPart) -> bool:
    """Whether a fault of the bench ended a failed grasp."""
    return bool(json.loads(row.details_json or "{}").get("end") == BENCH_FAULT)
