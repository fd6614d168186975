"""Reference grasps with a tool of their own: what changes there is the bench, not the tools that are compared.

Without a `diagnostics.reference_tool` every tool makes its reference grasps itself, which shows its wear. With one, the
gantry fetches it before the first tool of a batch, before the next tool whenever `reference_every` grasps have been
made since, and at the end; each time it makes `repeats` grasps on the reference object.
"""

from collections.abc import Sequence

from fast.hardware.cell.cell import MeasuredGrasp
from fast.lake.tables.campaign import DesignRow
from fast.models.errors import ConfigError
from fast.tasks.bench.plan import ToolWork
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import ProposedTool, tuples

_MADE = """
    SELECT count(*), count(*) FILTER (batch = $batch), max(n_grasps_before) FILTER (batch = $batch)
    FROM diagnostics WHERE tool_id = $tool AND kind = 'reference' AND status = 'ok'
"""
_GRASPS = "SELECT count(*) FROM raw_grasps WHERE campaign_id = $campaign AND batch = $batch"


class ReferenceGrasps:
    """The reference tool in one batch of a campaign; what is made with it is read once, then counted.

    Attributes:
        tool: as it hangs in the rack, under the id `CAMPAIGN/R9` (its slot) in every batch; None where none is named.
    """

    def __init__(self, campaign: Campaign, batch: int) -> None:
        self._campaign = campaign
        self._plan = campaign.config.diagnostics
        self.tool: ProposedTool | None = None
        self._n_grasps = self._n_made = self._n_here = self._n_before = 0
        named, name, lake = self._plan.reference_tool, campaign.campaign_id, campaign.lake
        if named is None:
            return
        self.tool = ProposedTool(f"{name}/R{named.slot}", batch, named.slot, named.design)
        # Grasps of the batch; reference grasps of the campaign, of the batch; grasps of the batch before the last one.
        ((self._n_grasps,),) = tuples(lake, _GRASPS, campaign=name, batch=batch)
        ((self._n_made, self._n_here, n_before),) = tuples(lake, _MADE, tool=self.tool.tool_id, batch=batch)
        self._n_before = n_before or 0

    def add_to(self, mounted: Sequence[ProposedTool]) -> list[ProposedTool]:
        """The rack with the reference tool, whose design is then in the lake.

        Raises:
            ConfigError: another tool hangs in its slot.
        """
        if self.tool is None:
            return list(mounted)
        taken = [tool.label for tool in mounted if tool.rack_slot == self.tool.rack_slot]
        if taken:
            raise ConfigError(
                f"Tool {taken[0]} hangs in slot {self.tool.rack_slot}, which is the reference tool's; nothing was "
                "moved. Confirm the batch with another --slot, or change diagnostics.reference_tool.slot."
            )
        self._campaign.lake.append([DesignRow.of(self.tool.design)], self._campaign.provenance())
        return [*mounted, self.tool]

    def plan_due(self, is_last: bool = False) -> list[ToolWork]:
        """The reference grasps of one turn, if it is its turn; `is_last`: after the last tool of the batch.

        They are numbered through the whole campaign.
        """
        if self.tool is None:
            return []
        n_since = self._n_grasps - self._n_before
        is_due = n_since > 0 if is_last else self._n_here == 0 or n_since >= self._plan.reference_every
        runs = [self._plan.reference(self._n_made + k) for k in range(self._plan.repeats)]
        return [ToolWork(self.tool, runs, self._n_grasps)] if is_due else []

    def count(self, tool: ProposedTool, grasp: MeasuredGrasp) -> None:
        """Note a grasp of the batch, or a reference grasp."""
        if grasp.diagnostic is None:
            self._n_grasps += 1
        elif tool == self.tool and grasp.status == "ok":
            self._n_made, self._n_here, self._n_before = self._n_made + 1, self._n_here + 1, self._n_grasps
