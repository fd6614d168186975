"""Reference grasps with a tool of their own: what changes there is the bench, not the tools that are compared.

Without a `diagnostics.reference_tool` every tool makes its reference grasps itself, which shows its wear. With one, the
gantry fetches it before the first tool of a batch, before the next tool whenever `reference_every` grasps have been
made since, and at the end; each time it makes `repeats` grasps on the reference object.
"""

from collections.abc import Sequence

from hardware.cell.diagnostics import DiagnosticRun
from lake.tables.campaign import DesignRow
from models.errors import ConfigError
from tasks.campaign.campaign import Campaign
from tasks.campaign.state import ProposedTool, tuples

_MADE = """
    SELECT count(*), count(*) FILTER (batch = CAST(? AS INTEGER)),
        max(n_grasps_before) FILTER (batch = CAST(? AS INTEGER))
    FROM diagnostics WHERE tool_id = ? AND kind = 'reference' AND status = 'ok'
"""


class References:
    """The reference tool in one batch of a campaign.

    Attributes:
        tool: as it hangs in the rack, under the id `CAMPAIGN/R9` (its slot) in every batch; None where none is named.
    """

    def __init__(self, campaign: Campaign, batch: int) -> None:
        self._campaign = campaign
        self._plan = campaign.config.diagnostics
        self._batch = batch
        named = self._plan.reference_tool
        self.tool: ProposedTool | None = None
        if named is not None:
            self.tool = ProposedTool(f"{campaign.campaign_id}/R{named.slot}", batch, named.slot, named.design)

    def added_to(self, mounted: Sequence[ProposedTool]) -> list[ProposedTool]:
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

    def due(self, is_last: bool = False) -> list[ProposedTool]:
        """The reference tool, if it is its turn; `is_last`: after the last tool of the batch."""
        if self.tool is None:
            return []
        _, n_here, n_before = self._made()
        n_since = self.n_grasps() - (n_before or 0)
        is_due = n_since > 0 if is_last else n_here == 0 or n_since >= self._plan.reference_every
        return [self.tool] if is_due else []

    def runs(self) -> list[DiagnosticRun]:
        """The reference grasps of one turn, numbered through the whole campaign."""
        n_made, *_ = self._made()
        return [self._plan.reference(n_made + k) for k in range(self._plan.repeats)]

    def n_grasps(self) -> int:
        """Ordinary grasps of the batch so far."""
        name = self._campaign.campaign_id
        sql = "SELECT count(*) AS n FROM raw_grasps WHERE campaign_id = ? AND batch = CAST(? AS INTEGER)"
        ((n,),) = tuples(self._campaign.lake, sql, name, str(self._batch))
        return int(n)

    def _made(self) -> tuple[int, int, int | None]:
        """Good reference grasps of the campaign, of this batch, and the batch's grasps before the last of them."""
        if self.tool is None:
            return 0, 0, None
        batch = str(self._batch)
        ((n_made, n_here, n_before),) = tuples(self._campaign.lake, _MADE, batch, batch, self.tool.tool_id)
        return n_made, n_here, n_before
