"""Everything the report needs, fetched once: query results and what follows from them."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.facts import (
    Tool,
    choose_versions,
    find_best_tool,
    find_first_batch,
    find_last_batch,
    find_references,
    read_tools,
)
from fast.flows.report.campaign.queries import Result, fetch
from fast.flows.report.campaign.reference import TimesReference, compare_with_reference
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow, design_of_columns
from fast.lake.tables.imported import is_imported
from fast.models.design.space import DesignSpace, space_of
from fast.models.errors import UsageError
from fast.models.records import Design
from fast.models.simulation.tolerances import Tolerances
from fast.models.validation import closest, load_record
from fast.tasks.campaign.night_story import read_nights
from fast.tasks.campaign.settings import DesignSettings


def _asked(name: str, sql: str) -> "cached_property[Result]":
    """Return a query whose answer several sections share: asked when the first one needs it."""
    return cached_property(lambda content: content.result(name, sql))


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
        """Ask one query for this campaign."""
        return fetch(self.lake, name, sql, self.campaign.campaign_id, values)

    quality = _asked("tool_quality", queries.TOOL_QUALITY)  # one row per tool
    work = _asked("object_work", queries.OBJECT_WORK)  # one row per tool and object
    object_classes = _asked("objects", queries.OBJECTS)
    pairs = _asked("simulated_measured", queries.SIM_REAL_PAIRS)  # one row per version, tool and object
    versions = _asked("simulator_versions", queries.VERSIONS)  # by age
    batches = _asked("batches", queries.BATCHES)
    cost = _asked("simulations", queries.SIMULATION_COST)  # and their CPU time, per version
    provenance = _asked("provenance", queries.PROVENANCE)  # code versions, config hashes and benches of the rows
    designs = _asked("designs", queries.DESIGNS)  # of the mounted tools

    @property
    def prior_campaigns(self) -> list[str]:
        """Campaigns that the surrogate learns from, as the config names them."""
        return list(tomllib.loads(self.campaign.config_toml).get("scientist", {}).get("prior_campaigns", []))

    @cached_property
    def tools(self) -> list[Tool]:
        """All tools."""
        return read_tools(self.quality.rows, find_references(self.designs.rows))

    @cached_property
    def best(self) -> Tool | None:
        """The best tool, None before the first measurement."""
        return find_best_tool(self.tools)

    @cached_property
    def times_reference(self) -> TimesReference | None:
        """The best tool against the reference finger, None where one of them is not measured."""
        return compare_with_reference(self.tools, self.best)

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
        return choose_versions(self.pairs.rows, [row["version_id"] for row in self.versions.rows], self.in_use)

    @cached_property
    def in_use(self) -> str | None:
        """Simulator version that the last night of the campaign took; None where no night took one."""
        nights = read_nights(self.lake, self.campaign.campaign_id)
        return nights[-1].version_id if nights else None

    def design_of(self, tool: Tool) -> Design:
        """Return the design of a mounted tool."""
        row = next(row for row in self.designs.rows if row["design_id"] == tool.design_id)
        return design_of_columns(row)

    @cached_property
    def tolerances(self) -> Tolerances:
        """How prints and mountings scatter, as the config has it; the usual ones where it does not say."""
        return load_record(Tolerances, tomllib.loads(self.campaign.config_toml).get("tolerances", {}), "stored config")

    @cached_property
    def space(self) -> DesignSpace:
        """The designs that the campaign may make; of an imported one all of its family."""
        if is_imported(self.campaign.config_toml):
            return space_of([self.design_of(tool) for tool in self.tools])
        given = tomllib.loads(self.campaign.config_toml).get("design", {})
        return load_record(DesignSettings, given, "stored config").space
