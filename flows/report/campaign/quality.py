"""What was found: the headline, tool quality by batch, and the campaign beside other approaches (Fig. 2a)."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.facts import Tool, average_quality_n, count_objects_won, find_references, read_tools
from fast.flows.report.campaign.queries import Result, fetch
from fast.flows.report.folder import Folder
from fast.flows.report.style import BEST, FAINT, FIRST, INK, MUTED, new_axes
from fast.lake.store import Lake
from fast.lake.tables.campaign import CampaignRow
from fast.models.units import typeset
from fast.tasks.templates import count, number

if TYPE_CHECKING:
    from fast.flows.scientist.campaign_runs import StrategyRun

BOX_FROM_N = 5
MARKS = {"random": (FIRST, "o"), "guided": (BEST, "D"), "imported": (MUTED, "s")}  # colour and marker by kind of design


def prepare_headline(content: Content) -> dict[str, Any]:
    """Prepare the result in two sentences, and the key numbers."""
    told: dict[str, Any] = {
        "n_grasps": sum(t.n_grasps for t in content.tools),
        "n_failed": sum(t.n_failed for t in content.tools),
        "n_simulated": sum(row["n_ok"] for row in content.cost.rows),
    }
    best = content.best
    if best is None:
        return told
    value, _, spread = describe_quality(best, 1).partition(" ")
    first_n = average_quality_n(content.first)
    gain = _gain_over(best, first_n)
    return told | {
        "quality": value,
        "spread": spread,
        "reference_n": first_n,
        "gain": f"{typeset(100 * gain, '+.0f')} %" if gain is not None and round(100 * gain) else "",
        "times": _describe_times(content),
        "verdict": _verdict(content, best, first_n, gain),
        "caution": _caution(content),
    }


def _describe_times(content: Content) -> tuple[str, str, str] | None:
    """Describe the best tool over the reference finger, where both are measured: number, words, interval."""
    found = content.times_reference
    if found is None:
        return None
    value, _, rest = found.times.partition(" times the reference finger")
    what = f"times the reference finger {found.references[0].reference}: {number(found.reference_n, 1, 'N')}"
    return value, what, rest.strip()


def describe_quality(tool: Tool, digits: int = 2) -> str:
    """Describe tool quality with the half width of its interval, where repeats gave one."""
    if tool.half_width_n is None:
        return number(tool.quality_n, digits, "N")
    return f"{number(tool.quality_n, digits)} ± {number(tool.half_width_n, digits, 'N')}"


def _gain_over(best: Tool, other_n: float | None) -> float | None:
    """Return by which share the best tool holds more; None over a tool that holds nothing."""
    return (best.quality_n or 0.0) / other_n - 1 if other_n and other_n > 0 else None


def _verdict(content: Content, best: Tool, first_n: float, gain: float | None) -> str:
    opening = f"{best.label} holds best: it takes {describe_quality(best)} on average to pull an object out of its grip"
    if content.times_reference is not None:
        opening += f", {content.times_reference.times}"
    if best in content.first:
        if len(content.first) == 1:
            return f"{opening}. It is the only tool of the first batch; none beats it."
        return f"{opening}. It is one of the first batch, whose mean is {number(first_n, 1, 'N')}; none beats it."
    top = max(content.first, key=lambda t: t.quality_n or 0.0)
    won, of = count_objects_won(content.work.rows, best, content.first)
    over = _gain_over(best, top.quality_n)
    return (
        f"{opening}, {_compare(gain)} the mean of the first batch ({number(first_n, 1, 'N')}) and "
        f"{_compare(over)} its best tool ({top.label}, {number(top.quality_n, 1, 'N')}). "
        f"It beats that batch's mean on {won} of {count(of, 'object')}."
    )


def _compare(gain: float | None) -> str:
    """Describe a relative difference in words."""
    if gain is None:
        return "more than"
    percent = round(100 * gain)
    return f"{abs(percent)} % {'more' if percent > 0 else 'less'} than" if percent else "as much as"


def _caution(content: Content) -> str:
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
    return " ".join(notes)


def prepare_progress(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare the tool quality per batch; empty before the first measurement."""
    if content.best is None:
        return {}
    folder.save(content.quality)
    batches = []
    for batch in sorted({t.batch for t in content.tools if t.is_complete}):
        values = np.array([t.quality_n for t in content.tools if t.batch == batch and t.is_complete], dtype=float)
        sd_n = float(values.std(ddof=1)) if values.size > 1 else None
        batches.append({"batch": f"B{batch:02d}", "n": values.size, "mean_n": values.mean(), "sd_n": sd_n,
                        "best_n": values.max()})  # fmt: skip
    return {
        "drawn": folder.draw("quality_by_batch", draw_quality(content.tools, content.best)),
        "kinds": {tool.kind for tool in content.tools},
        "batches": batches,
    }


def draw_quality(tools: Sequence[Tool], best: Tool) -> Figure:
    """Draw tool quality against batch: every tool, the spread of a batch, the best so far."""
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
    """Draw the quartile box and the median of a batch; only the median where the batch is small."""
    if values.size >= BOX_FROM_N:
        low, high = np.percentile(values, [25, 75])
        axes.bar(batch, high - low, 0.8, bottom=low, color=FAINT, alpha=0.45, linewidth=0)
    if values.size:
        axes.hlines(np.median(values), batch - 0.4, batch + 0.4, color=MUTED, linewidth=1.4)


def _offset(slot: int) -> float:
    return (slot - 4.5) * 0.068


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


def prepare_baselines(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare the best tool so far and tools of the last batch of each approach; empty where there is no other."""
    if content.best is None:
        return {}
    own_name = _parse_name(content.lake.root.name)[0] if content.against else content.campaign.name
    own = Approach(own_name or content.campaign.campaign_id, 0, content.tools, content.cost)
    objects = _object_ids(content.lake, content.campaign.campaign_id)
    others = [a for lake in (content.lake, *content.against) for a in _find_approaches(lake, content, objects)]
    others = [a for a in others if a.n_batches == max(b.n_batches for b in others if b.name == a.name)]
    if not others:
        return {}
    from fast.flows.scientist.campaign_table import campaign_rows, campaigns_figure

    runs = [approach.as_run for approach in (own, *others)]
    folder.numbers("approaches", _tool_rows([own, *others]))
    return {
        "drawn": folder.draw("approaches", campaigns_figure(runs, own.name)),
        "n_objects": len(objects),
        "approaches": campaign_rows(runs),
    }


def _find_approaches(lake: Lake, content: Content, objects: set[int]) -> list[Approach]:
    """Find campaigns of a lake with measured tools on the same objects; in this lake, others than the report's."""
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
    """Parse the name that `fast compare` gives its lakes, approach and seed: `measured-only-3`."""
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
