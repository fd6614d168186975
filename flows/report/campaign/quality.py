"""What was found: the headline, tool quality by batch, and the campaign beside other approaches (Fig. 2a)."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.content import NOT_MEASURED, Content
from fast.flows.report.campaign.facts import Tool, average_quality_n, count_objects_won, find_references, read_tools
from fast.flows.report.campaign.queries import Result, fetch
from fast.flows.report.folder import Folder
from fast.flows.report.html import Markup, columns, paragraph, section, table, tiles
from fast.flows.report.style import BEST, FAINT, FIRST, INK, MUTED, new_axes
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow
from fast.tasks.templates import count, number

if TYPE_CHECKING:
    from fast.flows.scientist.campaign_runs import StrategyRun

BOX_FROM_N = 5
MARKS = {"random": (FIRST, "o"), "guided": (BEST, "D"), "imported": (MUTED, "s")}  # colour and marker by kind of design
_TITLE = "Against other approaches"
_NO_OTHERS = Markup(
    "What measuring and simulating together is worth shows beside campaigns that choose their tools otherwise, with "
    "the same objects; this lake has none. <code>fast compare</code> makes random, measured-only and simulation-only "
    "ones, and <code>fast report CAMPAIGN --against LAKE</code> draws them here (Fig. 2a of the paper)."
)


def headline(content: Content) -> Markup:
    """The result in two sentences, and the key numbers."""
    grasps = sum(t.n_grasps for t in content.tools)
    n_failed = sum(t.n_failed for t in content.tools)
    n_simulated = sum(row["n_ok"] for row in content.cost.rows)
    numbers = [
        (number(grasps, 0), f"measured grasps that count, {n_failed} more failed"),
    ]
    if n_simulated:  # without any, the page may still draw a grasp that it simulated itself
        versions = count(len(content.cost.rows), "simulator version")
        numbers.append((number(n_simulated, 0), f"simulated grasps with {versions}"))
    best = content.best
    if best is None:
        return Markup(
            paragraph("No tool of this campaign has been measured on any object yet.", "lead") + tiles(numbers)
        )
    value, _, spread = describe_quality(best, 1).partition(" ")
    reference = average_quality_n(content.first)
    gain = (best.quality_n or 0.0) / reference - 1
    numbers = [
        (
            Markup(f"{value} <small>{spread}</small>"),
            f"tool quality of {best.label}, mean over {count(best.n_objects, 'object')}",
        ),
        (number(reference, 1, "N"), f"mean of the first batch, {count(len(content.first), 'tool')}"),
        *([(f"{100 * gain:+.0f} %", "best tool against that mean")] if round(100 * gain) else []),
        *_reference_tile(content),
        *numbers,
    ]
    return Markup(paragraph(_verdict(content, best, reference, gain), "lead") + _caution(content) + tiles(numbers))


def _reference_tile(content: Content) -> list[tuple[Markup | str, str]]:
    """Best tool over reference finger, where both are measured."""
    found = content.times_reference
    if found is None:
        return []
    value, _, rest = found.times.partition(" times the reference finger")
    what = f"times the reference finger {found.references[0].reference}: {number(found.reference_n, 1, 'N')}"
    return [(Markup(f"{value} <small>{rest}</small>"), what)]


def describe_quality(tool: Tool, digits: int = 2) -> str:
    """Tool quality with the half width of its interval, where repeats gave one."""
    if tool.half_width_n is None:
        return number(tool.quality_n, digits, "N")
    return f"{number(tool.quality_n, digits)} ± {number(tool.half_width_n, digits, 'N')}"


def _verdict(content: Content, best: Tool, reference: float, gain: float) -> str:
    opening = f"{best.label} holds best: it takes {describe_quality(best)} on average to pull an object out of its grip"
    if content.times_reference is not None:
        opening += f", {content.times_reference.times}"
    if best in content.first:
        if len(content.first) == 1:
            return f"{opening}. It is the only tool of the first batch; none beats it."
        return f"{opening}. It is one of the first batch, whose mean is {number(reference, 1, 'N')}; none beats it."
    top = max(content.first, key=lambda t: t.quality_n or 0.0)
    won, of = count_objects_won(content.work.rows, best, content.first)
    over = (best.quality_n or 0.0) / (top.quality_n or 1.0) - 1
    return (
        f"{opening}, {_compare(gain)} the mean of the first batch ({number(reference, 1, 'N')}) and "
        f"{_compare(over)} its best tool ({top.label}, {number(top.quality_n, 1, 'N')}). "
        f"It beats that batch's mean on {won} of {count(of, 'object')}."
    )


def _compare(gain: float) -> str:
    """A relative difference in words."""
    percent = round(100 * gain)
    return f"{abs(percent)} % {'more' if percent > 0 else 'less'} than" if percent else "as much as"


def _caution(content: Content) -> Markup:
    benches = sorted({row["bench"] for row in content.provenance.rows if row["bench"]})
    partial = [t.label for t in content.tools if t.quality_n is not None and not t.is_complete]
    notes = [
        "± is a 95 % interval from the scatter between repeats; it does not cover another print of the same design."
    ]
    if content.times_reference is not None:
        notes.append(content.times_reference.sentence)
    elif content.best is not None and any(t.reference for t in content.tools):
        notes.append("The reference finger is not measured on every object yet, or is all that was measured.")
    if "virtual" in benches:
        notes.insert(0, "Measured on the virtual bench: these forces come from a simulated world, not from a machine.")
    if partial:
        notes.append(f"Not ranked, because not measured on every object: {', '.join(partial)}.")
    return paragraph(" ".join(notes), "note")


def write_progress(content: Content, folder: Folder) -> Markup:
    """Tool quality per batch."""
    if content.best is None:
        return section("progress", "Tool quality by batch", paragraph(NOT_MEASURED))
    shown = folder.figure("quality_by_batch", draw_quality(content.tools, content.best), "Tool quality by batch")
    words = paragraph(
        "Every mark is a printed tool: the mean over objects of its peak pull-off force, with the interval from "
        f"repeats (often smaller than the mark). {_describe_marks(content.tools)} Hollow marks are tools not measured "
        "on every object. Grey: median of the batch and, from five tools on, its middle half."
    )  # fmt: skip
    rows = []
    for batch in sorted({t.batch for t in content.tools if t.is_complete}):
        values = np.array([t.quality_n for t in content.tools if t.batch == batch and t.is_complete], dtype=float)
        spread = float(values.std(ddof=1)) if values.size > 1 else None
        rows.append(
            (f"B{batch:02d}", values.size, number(values.mean(), 2), number(spread, 2), number(values.max(), 2))
        )
    summary = table(("batch", "tools", "mean (N)", "SD (N)", "best (N)"), rows, numeric=(1, 2, 3, 4))
    return section(
        "progress", "Tool quality by batch", columns(shown, words + summary), folder.sources(content.quality)
    )


def draw_quality(tools: Sequence[Tool], best: Tool) -> Figure:
    """Tool quality against batch: every tool, the spread of a batch, the best so far."""
    measured = [t for t in tools if t.quality_n is not None]
    batches = sorted({t.batch for t in measured})
    figure, axes = new_axes()
    for batch in batches:
        values = np.array([t.quality_n for t in measured if t.batch == batch and t.is_complete], dtype=float)
        _batch_box(axes, batch, values)
        kind = next(t.kind for t in measured if t.batch == batch)
        axes.text(batch, 0.005, kind, transform=axes.get_xaxis_transform(),
                  ha="center", va="bottom", fontsize=7.5, color=MUTED)  # fmt: skip
    for tool in measured:
        colour, marker = MARKS.get(tool.kind, MARKS["imported"])
        axes.errorbar(
            tool.batch + _offset(tool.slot), tool.quality_n or 0.0, yerr=tool.half_width_n,
            fmt=marker, color=colour, ecolor=colour, elinewidth=0.8,
            markersize=4.2, markerfacecolor=colour if tool.is_complete else "white", markeredgewidth=0.9,
        )  # fmt: skip
    so_far = np.maximum.accumulate(
        [max((t.quality_n or 0.0 for t in measured if t.batch == b and t.is_complete), default=0.0) for b in batches]
    )
    edges = [b + s for b in batches for s in (-0.5, 0.5)]
    axes.plot(edges, np.repeat(so_far, 2), color=INK, linewidth=1.1, linestyle=(0, (4, 2)), label="best so far")
    axes.annotate(
        best.label, (best.batch + _offset(best.slot), best.quality_n or 0.0), xytext=(0, 9),
        textcoords="offset points", ha="center", fontweight="bold", color=MARKS.get(best.kind, MARKS["imported"])[0],
    )  # fmt: skip
    axes.set_xticks(batches, [f"B{b:02d}" for b in batches])
    axes.set_xlim(batches[0] - 0.6, batches[-1] + 0.6)
    axes.margins(y=0.14)
    axes.set_xlabel("batch")
    axes.set_ylabel("tool quality (N)")
    # Above the axes: the best tool, whose label lies highest, may be of any batch.
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, handlelength=2.2)
    return figure


def _batch_box(axes: Axes, batch: int, values: np.ndarray) -> None:
    """Quartile box and median of a batch; only the median where the batch is small."""
    if values.size >= BOX_FROM_N:
        low, high = np.percentile(values, [25, 75])
        axes.bar(batch, high - low, 0.8, bottom=low, color=FAINT, alpha=0.45, linewidth=0)
    if values.size:
        axes.hlines(np.median(values), batch - 0.4, batch + 0.4, color=MUTED, linewidth=1.4)


def _offset(slot: int) -> float:
    return (slot - 4.5) * 0.068


def _describe_marks(tools: Sequence[Tool]) -> str:
    """The marks of the kinds of designs that there are, in words."""
    words = {
        "random": "Circles are random designs.",
        "guided": "Diamonds were chosen by the scientist.",
        "imported": "Squares were imported.",
    }
    return " ".join(said for kind, said in words.items() if any(tool.kind == kind for tool in tools))


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
        return [t for t in self.tools if t.is_complete and t.reference is None]

    @property
    def n_batches(self) -> int:
        """Batches with completely measured tools; of an approach, only its longest campaigns are drawn."""
        return len({tool.batch for tool in self.complete})

    @property
    def as_run(self) -> "StrategyRun":
        """What `fast compare` draws and sums up."""
        from fast.flows.scientist.campaign_runs import StrategyRun

        batches: dict[int, list[float]] = {}
        for tool in self.complete:
            batches.setdefault(tool.batch, []).append(tool.quality_n or 0.0)
        cost = self.cost.rows
        return StrategyRun(
            self.name,
            self.seed,
            tuple(tuple(batches[b]) for b in sorted(batches)),
            sum(r["n_designs"] for r in cost),
            3600 * sum(r["total_cpu_h"] or 0.0 for r in cost),
        )


def write_baselines(content: Content, folder: Folder) -> Markup:
    """Best tool so far and tools of the last batch of each approach."""
    if content.best is None:
        return section("baselines", _TITLE, paragraph(_NO_OTHERS))
    own_name = _parse_name(content.lake.root.name)[0] if content.against else content.campaign.name
    own = Approach(own_name or content.campaign.campaign_id, 0, content.tools, content.cost)
    objects = _object_ids(content.lake, content.campaign.campaign_id)
    others = [a for lake in (content.lake, *content.against) for a in _find_approaches(lake, content, objects)]
    others = [a for a in others if a.n_batches == max(b.n_batches for b in others if b.name == a.name)]
    if not others:
        return section("baselines", _TITLE, paragraph(_NO_OTHERS))
    from fast.flows.scientist.campaign_table import campaign_rows, campaigns_figure

    runs = [approach.as_run for approach in (own, *others)]
    figure = folder.figure("approaches", campaigns_figure(runs, own.name), "Best tool and last batch by approach")
    rows = campaign_rows(runs)
    listed = table(
        ("approach", "campaigns", "last batch (N)", "SD (N)", "best tool (N)", "tools measured", "designs simulated"),
        [(r["strategy"], r["n_campaigns"], number(r["last_batch_n"], 2), number(r["last_batch_sd_n"], 2),
          number(r["best_of_all_n"], 2), number(r["n_measured"], 0), number(r["n_simulated"], 0)) for r in rows],
        numeric=(1, 2, 3, 4, 5, 6), best_row=0,
    )  # fmt: skip
    words = paragraph(
        f"Ways of choosing tools, on the same {count(len(objects), 'object')}. Left: the best tool so far, against the "
        "tools measured. Right: the tools of the last batch, which the paper compares by mean and spread (Fig. 2a "
        "there).", "note",
    )  # fmt: skip
    return section("baselines", _TITLE, words, figure, listed, folder.numbers("approaches", _tool_rows([own, *others])))


def _find_approaches(lake: Lake, content: Content, objects: set[int]) -> list[Approach]:
    """Campaigns of a lake with measured tools on the same objects; in this lake, other ones than the report's."""
    is_own = lake is content.lake
    found = []
    for campaign_id in sorted(lake.ids(CampaignRow)):
        if (is_own and campaign_id == content.campaign.campaign_id) or _object_ids(lake, campaign_id) != objects:
            continue
        name, seed = _parse_name(campaign_id if is_own else lake.root.name)
        references = find_references(fetch(lake, "designs", queries.DESIGNS, campaign_id).rows)
        tools = read_tools(fetch(lake, "tool_quality", queries.TOOL_QUALITY, campaign_id).rows, references)
        cost = fetch(lake, "simulations", queries.SIMULATION_COST, campaign_id)
        approach = Approach(name, seed, tools, cost)
        if approach.complete:
            found.append(approach)
    return found


def _parse_name(folder: str) -> tuple[str, int]:
    """`fast compare` names its lakes by approach and seed: `measured-only-3`."""
    match = re.fullmatch(r"(.+)-(\d+)", folder)
    return (match[1].replace("-", " "), int(match[2])) if match else (folder, 0)


def _object_ids(lake: Lake, campaign_id: str) -> set[int]:
    return {row["object_id"] for row in fetch(lake, "objects", queries.OBJECTS, campaign_id).rows}


def _tool_rows(approaches: Sequence[Approach]) -> list[dict[str, object]]:
    return [
        {"approach": a.name, "seed": a.seed, "batch": t.batch, "slot": t.slot, "quality_n": t.quality_n}
        for a in approaches
        for t in a.complete
    ]
