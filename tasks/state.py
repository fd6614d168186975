"""Where a campaign stands, derived from the lake alone: any process can be killed and ask again."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lake.store import Lake
from lake.tables import DesignRow, ProposalRow, ToolRow
from models.design_space import LOWER, PARAMETERS, UPPER, to_unit
from models.ids import tool_label
from models.records import BENCH_FAULT, Design

Cell = tuple[int, int]  # (object id, repeat)
THICKNESSES = ("front_thickness_mm", "back_thickness_mm", "rib_thickness_mm")


@dataclass(frozen=True)
class ProposedTool:
    """A design that the scientist wants on a slot of a batch, and what a person said of the print.

    `hangs_in`: slot of the rack where it was mounted, if that is another. `measured_mm`: thicknesses as printed, by the
    name of the design parameter.
    """

    tool_id: str
    batch: int
    slot: int
    design: Design
    hangs_in: int | None = None
    measured_mm: Mapping[str, float] = field(default_factory=dict)

    @property
    def rack_slot(self) -> int:
        """Slot of the rack from which the gantry takes it."""
        return self.slot if self.hangs_in is None else self.hangs_in

    @property
    def mounted_point(self) -> np.ndarray:
        """The finger as printed, 9 unit-cube coordinates; a thickness out of range leaves the cube."""
        point = to_unit([self.design])[0]
        for name, value_mm in self.measured_mm.items():
            column = PARAMETERS.index(name)
            point[column] = (value_mm - LOWER[column]) / (UPPER[column] - LOWER[column])
        return point

    @property
    def label(self) -> str:
        """`B07T8`, as the paper prints it."""
        return tool_label(self.batch, self.slot)


@dataclass(frozen=True)
class ProposedSimulation:
    """A design to be simulated; `batch` is the last batch of the stage in which it was proposed."""

    proposal_id: str
    batch: int
    index: int
    design: Design


@dataclass(frozen=True)
class CampaignState:
    """All decisions and results of one campaign."""

    tools: tuple[ProposedTool, ...]
    simulations: tuple[ProposedSimulation, ...]
    confirmed: dict[str, str] = field(default_factory=dict)  # tool_id -> printed | rejected
    measured: dict[str, set[Cell]] = field(default_factory=dict)  # tool_id -> good grasps whose trace is there
    failures: dict[tuple[str, Cell], int] = field(default_factory=dict)  # (tool_id, cell) -> failures of its own
    next_attempts: dict[tuple[str, Cell], int] = field(default_factory=dict)  # (tool_id, cell) -> number, if not 0
    batch_on_rack: int = 0  # of a real bench: the one it measured last, 0 before its first grasp and on a virtual one
    simulated: dict[str, set[int]] = field(default_factory=dict)  # design_id -> objects with a result or a failure
    simulated_before: dict[str, set[int]] = field(default_factory=dict)  # the same, by an older simulator version
    fruitful: frozenset[str] = frozenset()  # design ids with a simulated result, by whichever version

    def tools_of(self, batch: int) -> list[ProposedTool]:
        """The proposed tools of a batch, by slot."""
        return sorted((t for t in self.tools if t.batch == batch), key=lambda t: t.slot)

    def simulations_of(self, batch: int) -> list[ProposedSimulation]:
        """The simulations proposed in the stage that ends with `batch`, in order."""
        return sorted((s for s in self.simulations if s.batch == batch), key=lambda s: s.index)

    def is_confirmed(self, batch: int) -> bool:
        """True when a person (or `--auto-print`) has said what became of every tool of the batch."""
        tools = self.tools_of(batch)
        return bool(tools) and all(t.tool_id in self.confirmed for t in tools)

    def next_attempt(self, tool_id: str, cell: Cell) -> int:
        """Number of the next attempt at a grasp: that of a good one without trace, which it replaces, or a new one."""
        return self.next_attempts.get((tool_id, cell), 0)

    def is_to_be_had(self, tool: ProposedTool) -> bool:
        """Whether a tool was printed, and no later batch has taken its slot on a real rack."""
        return tool.batch >= self.batch_on_rack and self.confirmed.get(tool.tool_id) == "printed"

    def missing_grasps(self, tool: ProposedTool, plan: Iterable[Cell], max_attempts: int) -> list[Cell]:
        """Grasps still to be made, in the order of the plan: not measured, or measured and the trace is lost.

        A grasp is given up after `max_attempts` failures of its own; one that was cut short by a fault of the bench is
        not held against it. None for a rejected tool, and for one of a batch that a real bench's rack held before: in
        its slot stands another tool now.
        """
        if not self.is_to_be_had(tool):
            return []
        done = self.measured.get(tool.tool_id, set())
        return [c for c in plan if c not in done and self.failures.get((tool.tool_id, c), 0) < max_attempts]

    def missing_objects(self, design_id: str, object_ids: Sequence[int]) -> list[int]:
        """Objects on which a design has not been simulated yet."""
        done = self.simulated.get(design_id, set())
        return [o for o in object_ids if o not in done]

    def ever_simulated(self, design_id: str) -> set[int]:
        """Objects on which a design has been simulated by any of the campaign's simulator versions."""
        return self.simulated.get(design_id, set()) | self.simulated_before.get(design_id, set())


def derive_state(
    lake: Lake,
    campaign_id: str,
    setup_id: str,
    version_ids: Collection[str],
    older_ids: Collection[str] = (),
) -> CampaignState:
    """Read the state of a campaign; `version_ids` and `setup_id` say which simulations count, `older_ids` which did."""
    proposals = lake.rows(ProposalRow, campaign_id=campaign_id)
    designs = load_designs(lake)
    printed = {row["tool_id"]: row for row in lake.rows(ToolRow, campaign_id=campaign_id)}
    return CampaignState(
        tools=tuple(_tool(campaign_id, row, designs, printed) for row in proposals if row["fidelity"] == "real"),
        simulations=tuple(
            ProposedSimulation(row["proposal_id"], row["batch"], row["index"], designs[row["design_id"]])
            for row in proposals
            if row["fidelity"] == "sim"
        ),
        confirmed={tool_id: row["status"] for tool_id, row in printed.items()},
        **_grasp_progress(lake, campaign_id),
        batch_on_rack=_batch_on_rack(lake, campaign_id),
        **_simulation_progress(lake, setup_id, version_ids, older_ids),
    )


def load_designs(lake: Lake) -> dict[str, Design]:
    """All designs of the lake by id."""
    return {row.design_id: row.design for row in lake.records(DesignRow)}


def _tool(campaign_id: str, row: dict, designs: dict[str, Design], printed: dict[str, dict]) -> ProposedTool:
    tool_id = ToolRow.make_id(campaign_id, row["batch"], row["slot"])
    said = printed.get(tool_id, {})
    thicknesses = {name: said.get(f"measured_{name}") for name in THICKNESSES}
    measured_mm = {name: value for name, value in thicknesses.items() if value is not None}
    design = designs[row["design_id"]]
    return ProposedTool(tool_id, row["batch"], row["slot"], design, said.get("rack_slot"), measured_mm)


_PROGRESS = f"""
    SELECT tool_id, object_id, repeat, attempt, status = 'ok' AS is_good,
        grasp_id IN (SELECT grasp_id FROM raw_traces) AS has_trace,
        coalesce(CASE WHEN status <> 'ok' THEN details_json ->> '$.end' END = '{BENCH_FAULT}', false) AS is_cut_short
    FROM grasps WHERE campaign_id = ? ORDER BY attempt
"""  # of traces the index has the ids, and they need not be read


def _grasp_progress(lake: Lake, campaign_id: str) -> dict:
    measured: dict[str, set[Cell]] = defaultdict(set)
    failures: dict[tuple[str, Cell], int] = defaultdict(int)
    next_attempts: dict[tuple[str, Cell], int] = {}
    lost: dict[tuple[str, Cell], int] = {}
    for tool_id, object_id, repeat, attempt, is_good, has_trace, is_cut_short in tuples(lake, _PROGRESS, campaign_id):
        cell = (object_id, repeat)
        if is_good and has_trace:
            measured[tool_id].add(cell)
        elif is_good:
            lost[tool_id, cell] = attempt
        else:
            failures[tool_id, cell] += not is_cut_short
            next_attempts[tool_id, cell] = attempt + 1
    return {"measured": dict(measured), "failures": dict(failures), "next_attempts": next_attempts | lost}


def _batch_on_rack(lake: Lake, campaign_id: str) -> int:
    sql = "SELECT coalesce(max(batch), 0) AS batch FROM grasps WHERE campaign_id = ? AND bench = 'real'"
    ((batch,),) = tuples(lake, sql, campaign_id)
    return int(batch)


def _simulation_progress(
    lake: Lake, setup_id: str, version_ids: Collection[str], older_ids: Collection[str]
) -> dict[str, Any]:
    present: dict[str, set[int]] = {}
    before: dict[str, set[int]] = {}
    fruitful = set()
    counting, all_ids = _marks(version_ids), [*sorted(version_ids), *sorted(older_ids)]
    sql = f"""SELECT design_id, version_id IN ({counting}) AS counts, list(DISTINCT object_id), bool_or(status = 'ok')
        FROM simulations WHERE setup_id = ? AND version_id IN ({_marks(all_ids)}) GROUP BY ALL"""
    found = tuples(lake, sql, *sorted(version_ids), setup_id, *all_ids)
    for design_id, counts, object_ids, is_fruitful in found:
        (present if counts else before)[design_id] = set(object_ids)
        if is_fruitful:
            fruitful.add(design_id)
    return {"simulated": present, "simulated_before": before, "fruitful": frozenset(fruitful)}


def _marks(values: Collection[str]) -> str:
    return ", ".join("?" * len(values))


def tuples(lake: Lake, sql: str, *params: str) -> Iterable[tuple[Any, ...]]:
    """Rows as tuples: a campaign of the paper's size has 46,000 of them, and its state is derived often."""
    found = lake.query(sql, list(params))
    return zip(*(column.to_pylist() for column in found.columns), strict=True)
