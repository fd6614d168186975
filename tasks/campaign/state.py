"""Where a campaign stands. It is derived from the lake alone: any process can be killed."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lake.store import Lake
from lake.tables.campaign import DesignRow
from models.design.space import LOWER, PARAMETERS, UPPER, to_unit
from models.ids import tool_label
from models.records import Design

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


def load_designs(lake: Lake) -> dict[str, Design]:
    """All designs of the lake by id."""
    return {row.design_id: row.design for row in lake.records(DesignRow)}


def tuples(lake: Lake, sql: str, *params: str) -> Iterable[tuple[Any, ...]]:
    """Rows as tuples: a campaign of the paper's size has 46,000 of them, and its state is derived often."""
    found = lake.query(sql, list(params))
    return zip(*(column.to_pylist() for column in found.columns), strict=True)
