"""Fig. 2a: the campaign beside other approaches with the same objects, from this lake or from others."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from flows.report.campaign import queries
from flows.report.campaign.content import Content
from flows.report.campaign.facts import Tool, tools_of
from flows.report.campaign.queries import Result, fetch
from flows.report.folder import Folder
from flows.report.html import Markup, number, paragraph, section, table
from lake.store import Lake
from lake.tables.campaign import CampaignRow

if TYPE_CHECKING:
    from flows.scientist.campaign_runs import CampaignRun

TITLE = "Against other approaches"
_NO_OTHERS = Markup(
    "Fig. 2a needs a second approach with the same objects, and this lake has none; <code>fast compare</code> measures "
    "random, measured-only and simulation-only campaigns, and <code>fast report CAMPAIGN --against LAKE</code> draws "
    "them here."
)


@dataclass(frozen=True)
class Approach:
    """A campaign as an approach: its name (of several seeds, the same), what it measured and simulated."""

    name: str
    seed: int
    tools: Sequence[Tool]
    cost: Result

    @property
    def complete(self) -> list[Tool]:
        """The tools that were measured on every object."""
        return [t for t in self.tools if t.is_complete]

    @property
    def n_batches(self) -> int:
        """Batches with completely measured tools; of an approach, only its longest campaigns are drawn."""
        return len({tool.batch for tool in self.complete})

    @property
    def course(self) -> "CampaignRun":
        """What `fast compare` draws and sums up."""
        from flows.scientist.campaign_runs import CampaignRun

        batches: dict[int, list[float]] = {}
        for tool in self.complete:
            batches.setdefault(tool.batch, []).append(tool.quality_n or 0.0)
        cost = self.cost.rows
        return CampaignRun(
            self.name,
            self.seed,
            tuple(tuple(batches[b]) for b in sorted(batches)),
            sum(r["n_designs"] for r in cost),
            3600 * sum(r["total_cpu_h"] or 0.0 for r in cost),
        )


def rivals_section(content: Content, folder: Folder) -> Markup:
    """Best tool so far and tools of the last batch of each approach."""
    if content.best is None:
        return section("rivals", TITLE, paragraph(_NO_OTHERS))
    own_name = _named(content.lake.root.name)[0] if content.against else content.campaign.name
    own = Approach(own_name or content.campaign.campaign_id, 0, content.tools, content.cost)
    objects = _objects(content.lake, content.campaign.campaign_id)
    others = [a for lake in (content.lake, *content.against) for a in _approaches(lake, content, objects)]
    others = [a for a in others if a.n_batches == max(b.n_batches for b in others if b.name == a.name)]
    if not others:
        return section("rivals", TITLE, paragraph(_NO_OTHERS))
    from flows.scientist.campaign_table import campaign_rows, campaigns_figure

    courses = [approach.course for approach in (own, *others)]
    figure = folder.figure("approaches", campaigns_figure(courses, own.name), "Best tool and last batch by approach")
    rows = campaign_rows(courses)
    listed = table(
        ("approach", "campaigns", "last batch (N)", "SD (N)", "best tool (N)", "tools measured", "designs simulated"),
        [(r["strategy"], r["n_campaigns"], number(r["last_batch_n"], 2), number(r["last_batch_sd_n"], 2),
          number(r["best_of_all_n"], 2), number(r["n_measured"], 0), number(r["n_simulated"], 0)) for r in rows],
        numeric=(1, 2, 3, 4, 5, 6), best_row=0,
    )  # fmt: skip
    words = paragraph(
        f"Fig. 2a of the paper, on the same {len(objects)} objects. Left: the best tool so far, against the tools "
        "measured. Right: the tools of the last batch, which the paper compares by mean and spread.", "note",
    )  # fmt: skip
    return section("rivals", TITLE, words, figure, listed, folder.numbers("approaches", _tool_rows([own, *others])))


def _approaches(lake: Lake, content: Content, objects: set[int]) -> list[Approach]:
    """Campaigns of a lake with measured tools on the same objects; in this lake, other ones than the report's."""
    is_own = lake is content.lake
    found = []
    for campaign_id in sorted(lake.ids(CampaignRow)):
        if (is_own and campaign_id == content.campaign.campaign_id) or _objects(lake, campaign_id) != objects:
            continue
        name, seed = _named(campaign_id if is_own else lake.root.name)
        tools = tools_of(fetch(lake, "tool_quality", queries.TOOL_QUALITY, campaign_id).rows)
        cost = fetch(lake, "simulations", queries.SIMULATION_COST, campaign_id)
        approach = Approach(name, seed, tools, cost)
        if approach.complete:
            found.append(approach)
    return found


def _named(folder: str) -> tuple[str, int]:
    """`fast compare` names its lakes by approach and seed: `measured-only-3`."""
    match = re.fullmatch(r"(.+)-(\d+)", folder)
    return (match[1].replace("-", " "), int(match[2])) if match else (folder, 0)


def _objects(lake: Lake, campaign_id: str) -> set[int]:
    return {row["object_id"] for row in fetch(lake, "objects", queries.OBJECTS, campaign_id).rows}


def _tool_rows(approaches: Sequence[Approach]) -> list[dict[str, object]]:
    return [
        {"approach": a.name, "seed": a.seed, "batch": t.batch, "slot": t.slot, "quality_n": t.quality_n}
        for a in approaches
        for t in a.complete
    ]
