"""Everything the report needs, fetched once: query results and what follows from them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from flows.report.campaign import queries
from flows.report.campaign.facts import (
    Tool,
    find_best_tool,
    find_first_batch,
    find_last_batch,
    read_tools,
    versions_to_compare,
)
from flows.report.campaign.queries import Result, fetch
from lake.store import Lake
from lake.tables.campaign import CampaignRow
from models.design.space import PARAMETERS
from models.errors import UsageError
from models.records import Design
from models.validation import closest

NOT_MEASURED = (
    "No tool of this campaign has been measured on any object yet; this part fills itself with the first batch."
)


@dataclass(frozen=True)
class Content:
    """A campaign as the lake has it at this moment."""

    lake: Lake
    campaign: CampaignRow
    against: tuple[Lake, ...] = ()

    @classmethod
    def load(cls, lake: Lake, campaign_id: str, against: Sequence[Lake] = ()) -> "Content":
        """Find the campaign; `against` are lakes with campaigns to compare it with.

        Raises:
            UsageError: the lake has no such campaign.
        """
        found = lake.records(CampaignRow, campaign_id=campaign_id)
        if not found:
            known = sorted(lake.ids(CampaignRow))
            hint = (
                closest(campaign_id, known) if known else "the lake has none yet; start one with `fast campaign run`."
            )
            raise UsageError(f"There is no campaign `{campaign_id}` in {lake.address}; {hint}")
        return cls(lake, found[-1], tuple(against))

    def result(self, name: str, sql: str, **values: str | float) -> Result:
        """One query for this campaign."""
        return fetch(self.lake, name, sql, self.campaign.campaign_id, values)

    @cached_property
    def quality(self) -> Result:
        """One row per tool."""
        return self.result("tool_quality", queries.TOOL_QUALITY)

    @cached_property
    def work(self) -> Result:
        """One row per tool and object."""
        return self.result("object_work", queries.OBJECT_WORK)

    @cached_property
    def object_classes(self) -> Result:
        """Name and class of the objects."""
        return self.result("objects", queries.OBJECTS)

    @cached_property
    def pairs(self) -> Result:
        """Simulated against measured, one row per version, tool and object."""
        return self.result("simulated_measured", queries.SIM_REAL_PAIRS)

    @cached_property
    def versions(self) -> Result:
        """Simulator versions by age."""
        return self.result("simulator_versions", queries.VERSIONS)

    @cached_property
    def batches(self) -> Result:
        """One row per batch."""
        return self.result("batches", queries.BATCHES)

    @cached_property
    def cost(self) -> Result:
        """Simulations and their CPU time, per version."""
        return self.result("simulations", queries.SIMULATION_COST)

    @cached_property
    def provenance(self) -> Result:
        """Code versions, config hashes and benches of the rows."""
        return self.result("provenance", queries.PROVENANCE)

    @cached_property
    def designs(self) -> Result:
        """Designs of the mounted tools."""
        return self.result("designs", queries.DESIGNS)

    @cached_property
    def tools(self) -> list[Tool]:
        """All tools."""
        return read_tools(self.quality.rows)

    @cached_property
    def best(self) -> Tool | None:
        """The best tool, None before the first measurement."""
        return find_best_tool(self.tools)

    @cached_property
    def first(self) -> list[Tool]:
        """Tools of the first random batch."""
        return find_first_batch(self.tools)

    @cached_property
    def last(self) -> list[Tool]:
        """Tools of the newest measured batch."""
        return find_last_batch(self.tools)

    @cached_property
    def compared(self) -> list[str]:
        """Simulator versions that are compared with measurements, oldest first."""
        return versions_to_compare(self.pairs.rows, [row["version_id"] for row in self.versions.rows])

    def design_of(self, tool: Tool) -> Design:
        """Design of a mounted tool."""
        row = next(row for row in self.designs.rows if row["design_id"] == tool.design_id)
        return Design(**{name: row[name] for name in PARAMETERS})
