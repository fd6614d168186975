"""Where a campaign stands. It is derived from the lake alone, by a few queries: any process can be killed."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, ToolRow, design_of_columns
from fast.models.design.space import PARAMETERS, DesignSpace
from fast.models.ids import tool_label
from fast.models.records import BENCH_FAULT, Design
from fast.tasks.campaign.left_out import LeftOuts, read_left_out

PlannedGrasp = tuple[int, int]  # (object id, repeat)
NIGHT = "night"  # what `proposals.acquisition` says of designs that a night adds to those of the schedule
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

    def mounted_point(self, space: DesignSpace) -> np.ndarray:
        """Return the finger as printed, d unit-cube coordinates; a thickness out of range leaves the cube."""
        point = space.to_unit([self.design])[0]
        for name, value_mm in self.measured_mm.items():
            if name in space.names:
                column = space.names.index(name)
                point[column] = (value_mm - space.lower[column]) / (space.upper[column] - space.lower[column])
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
    """Proposed for printing, in order."""
    simulations: tuple[ProposedSimulation, ...]
    """Proposed for the simulator, in order."""
    night: tuple[ProposedSimulation, ...] = ()
    """Added by nights, of which time may have left out any."""
    confirmed: dict[str, str] = field(default_factory=dict)
    """By tool id: printed or rejected."""
    measured: dict[str, set[PlannedGrasp]] = field(default_factory=dict)
    """By tool id, good grasps whose trace is there."""
    failures: dict[tuple[str, PlannedGrasp], int] = field(default_factory=dict)
    """By tool id and cell, failures of its own."""
    next_attempts: dict[tuple[str, PlannedGrasp], int] = field(default_factory=dict)
    """By tool id and cell, number of the next attempt if not 0."""
    imported: frozenset[int] = frozenset()
    """Batches that another lab made, whose tools are not here."""
    batch_on_rack: int = 0
    """Of a real bench: the one it measured last; 0 before its first grasp and on a virtual one."""
    simulated: dict[str, set[int]] = field(default_factory=dict)
    """By design id, objects with a result or a failure."""
    simulated_before: dict[str, set[int]] = field(default_factory=dict)
    """The same, by an older simulator version."""
    fruitful: frozenset[str] = frozenset()
    """Design ids with a simulated result, by whichever version."""
    left_out: LeftOuts = LeftOuts()
    """What people leave out of the plan."""

    def tools_of(self, batch: int) -> list[ProposedTool]:
        """Return the proposed tools of a batch, by slot."""
        return sorted((t for t in self.tools if t.batch == batch), key=lambda t: t.slot)

    def simulations_of(self, batch: int) -> list[ProposedSimulation]:
        """Return the simulations proposed in the stage that ends with `batch`, in order."""
        return sorted((s for s in self.simulations if s.batch == batch), key=lambda s: s.index)

    def is_confirmed(self, batch: int) -> bool:
        """Return True when a person (or `--auto-print`) has said what became of every tool of the batch."""
        tools = self.tools_of(batch)
        return bool(tools) and all(t.tool_id in self.confirmed for t in tools)

    def next_attempt(self, tool_id: str, grasp: PlannedGrasp) -> int:
        """Return a grasp's next attempt number: that of a good one without trace, which it replaces, or a new one."""
        return self.next_attempts.get((tool_id, grasp), 0)

    def is_to_be_had(self, tool: ProposedTool) -> bool:
        """Return whether a tool was printed here and not left out, and no later batch has its slot on a real rack."""
        is_here = tool.batch not in self.imported and tool.batch >= self.batch_on_rack
        is_in = is_here and not self.left_out.has_tool(tool.batch, tool.slot)
        return is_in and self.confirmed.get(tool.tool_id) == "printed"

    def missing_grasps(self, tool: ProposedTool, plan: Iterable[PlannedGrasp], max_attempts: int) -> list[PlannedGrasp]:
        """Return grasps still to be made, in the order of the plan: not measured, or measured and the trace is lost.

        A grasp is given up after `max_attempts` failures of its own; one that was cut short by a fault of the bench is
        not held against it. None for a rejected tool, for what a person left out, and for a tool of a batch that a real
        bench's rack held before: in its slot stands another tool now.
        """
        return self.owed_grasps(tool, plan, max_attempts) if self.is_to_be_had(tool) else []

    def owed_grasps(self, tool: ProposedTool, plan: Iterable[PlannedGrasp], max_attempts: int) -> list[PlannedGrasp]:
        """Return the same, whether or not the tool is printed yet."""
        done = self.measured.get(tool.tool_id, set())
        owed = [c for c in plan if c not in done and self.failures.get((tool.tool_id, c), 0) < max_attempts]
        return [c for c in owed if not self.left_out.covers(tool.batch, tool.slot, c)]

    def missing_objects(self, design_id: str, object_ids: Sequence[int]) -> list[int]:
        """Return the objects on which a design has not been simulated yet."""
        done = self.simulated.get(design_id, set())
        return [o for o in object_ids if o not in done]

    def ever_simulated(self, design_id: str) -> set[int]:
        """Return the objects on which a design has been simulated by any of the campaign's simulator versions."""
        return self.simulated.get(design_id, set()) | self.simulated_before.get(design_id, set())


_DESIGN = ("design_id", *PARAMETERS, "family", "parameters_json")
_PROPOSALS = f"""
    SELECT proposal_id, batch, slot, "index", fidelity, acquisition, {", ".join(f"d.{name}" for name in _DESIGN)}
    FROM proposals AS p JOIN designs AS d USING (design_id)
    WHERE p.campaign_id = $campaign ORDER BY p.sequence, p.created_at, proposal_id
"""
_TOOLS = f"""
    SELECT batch, slot, tool_id, status, rack_slot, {", ".join(f"measured_{name}" for name in THICKNESSES)}
    FROM tools WHERE campaign_id = $campaign
"""
# A peak that a foreign bench told without samples has no work either; it never had a trace to lose.
_GRASPS = """
    (SELECT *, work_j IS NULL OR grasp_id IN (SELECT grasp_id FROM raw_traces) AS has_trace
    FROM grasps WHERE campaign_id = $campaign AND request_id IS NULL)
"""
_MEASURED = f"""
    SELECT tool_id, list(object_id ORDER BY grasp_id), list(repeat ORDER BY grasp_id)
    FROM {_GRASPS} WHERE status = 'ok' AND has_trace GROUP BY tool_id
"""
# (tool, object, repeat) where a grasp failed or lost its trace: failures of its own, and number of the next attempt.
_FAILURES = f"""
    SELECT tool_id, object_id, repeat,
        count(*) FILTER (status <> 'ok' AND coalesce(details_json ->> '$.end', '') <> '{BENCH_FAULT}'),
        coalesce(max(attempt) FILTER (status = 'ok'), max(attempt) + 1)
    FROM {_GRASPS} WHERE status <> 'ok' OR NOT has_trace GROUP BY ALL
"""
_IMPORTED = "SELECT batch FROM batches WHERE campaign_id = $campaign AND kind = 'imported'"
_BATCH_ON_RACK = "SELECT coalesce(max(batch), 0) FROM grasps WHERE campaign_id = $campaign AND bench = 'real'"
_SIMULATIONS = """
    SELECT design_id, list_contains($present, version_id) AS is_present, list(object_id), bool_or(status = 'ok')
    FROM simulations WHERE setup_id = $setup AND list_contains($wanted, version_id) GROUP BY ALL
"""
_RANKING = """
SELECT tool_id, batch, slot, tool_quality_n, n_objects, n_grasps
FROM tool_quality WHERE campaign_id = ?
ORDER BY n_objects = max(n_objects) OVER () DESC, tool_quality_n DESC
"""


def derive_state(
    lake: Lake, campaign_id: str, setup_id: str, version_ids: Collection[str], older_ids: Collection[str] = ()
) -> CampaignState:
    """Derive the state of a campaign from the rows of its lake as they are now.

    Simulations count with this setup and a version of `version_ids`; those of `older_ids` did.

    Raises:
        LakeError: the lake cannot be read.
    """
    return CampaignState(
        **_read_plans(lake, campaign_id),
        **_read_grasps(lake, campaign_id),
        **_read_simulations(lake, setup_id, version_ids, older_ids),
        left_out=read_left_out(lake, campaign_id),
    )


def _read_plans(lake: Lake, campaign_id: str) -> dict[str, Any]:
    """Read what the scientist proposed, and what became of the printed tools."""
    printed = {(batch, slot): said for batch, slot, *said in tuples(lake, _TOOLS, campaign=campaign_id)}
    tools: list[ProposedTool] = []
    simulations: list[ProposedSimulation] = []
    night: list[ProposedSimulation] = []
    for proposal_id, batch, slot, index, fidelity, acquisition, *values in tuples(
        lake, _PROPOSALS, campaign=campaign_id
    ):
        design = design_of_columns(dict(zip(_DESIGN, values, strict=True)))
        if fidelity == "sim":
            found = night if acquisition == NIGHT else simulations
            found.append(ProposedSimulation(proposal_id, batch, index, design))
            continue
        # A tool that another lab made keeps the id that it has there.
        nothing = (ToolRow.make_id(campaign_id, batch, slot), None, None)
        tool_id, _, rack_slot, *thicknesses = printed.get((batch, slot), nothing)
        measured_mm = {n: mm for n, mm in zip(THICKNESSES, thicknesses, strict=False) if mm is not None}
        tools.append(ProposedTool(tool_id, batch, slot, design, rack_slot, measured_mm))
    confirmed = {tool_id: status for tool_id, status, *_ in printed.values()}
    imported = frozenset(batch for (batch,) in tuples(lake, _IMPORTED, campaign=campaign_id))
    return {
        "imported": imported,
        "tools": tuple(tools),
        "simulations": tuple(simulations),
        "night": tuple(night),
        "confirmed": confirmed,
    }


def _read_grasps(lake: Lake, campaign_id: str) -> dict[str, Any]:
    """Read what was measured, and where it went wrong."""
    failures: dict[tuple[str, PlannedGrasp], int] = {}
    next_attempts: dict[tuple[str, PlannedGrasp], int] = {}
    for tool_id, object_id, repeat, n_failures, next_attempt in tuples(lake, _FAILURES, campaign=campaign_id):
        next_attempts[tool_id, (object_id, repeat)] = next_attempt
        if n_failures:
            failures[tool_id, (object_id, repeat)] = n_failures
    measured = {
        tool_id: set(zip(object_ids, repeats, strict=True))
        for tool_id, object_ids, repeats in tuples(lake, _MEASURED, campaign=campaign_id)
    }
    ((batch_on_rack,),) = tuples(lake, _BATCH_ON_RACK, campaign=campaign_id)
    return {
        "measured": measured,
        "failures": failures,
        "next_attempts": next_attempts,
        "batch_on_rack": batch_on_rack,
    }


def _read_simulations(
    lake: Lake, setup_id: str, present_ids: Collection[str], older_ids: Collection[str]
) -> dict[str, Any]:
    """Read which designs were simulated on which objects."""
    present: dict[str, set[int]] = {}
    before: dict[str, set[int]] = {}
    fruitful: set[str] = set()
    wanted_ids = [*present_ids, *older_ids]
    found = tuples(lake, _SIMULATIONS, setup=setup_id, present=list(present_ids), wanted=wanted_ids)
    for design_id, is_present, object_ids, has_result in found:
        (present if is_present else before).setdefault(design_id, set()).update(object_ids)
        if has_result:
            fruitful.add(design_id)
    return {"simulated": present, "simulated_before": before, "fruitful": frozenset(fruitful)}


def rank_tools(lake: Lake, campaign_id: str) -> list[dict[str, Any]]:
    """Rank the measured tools, best first, with tool quality (mean peak pull-off force over the objects) in N.

    Tools that miss objects come after all others: their means are over easier or harder objects.
    """
    return lake.query(_RANKING, [campaign_id]).to_pylist()


def load_designs(lake: Lake) -> dict[str, Design]:
    """Load all designs of the lake by id."""
    return {row.design_id: row.design for row in lake.records(DesignRow)}


def tuples(lake: Lake, sql: str, *params: Any, **named: Any) -> Iterable[tuple[Any, ...]]:
    """Return the rows of a query as tuples; its parameters (`?` or `$name`) are given by place or by name."""
    found = lake.query_kept(sql, named or list(params))
    return zip(*(column.to_pylist() for column in found.columns), strict=True)
