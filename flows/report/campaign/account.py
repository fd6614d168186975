"""Sections of the report that say what it took, where every number came from, and where the paper's figures are."""

import json
from collections.abc import Mapping
from typing import Any

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.content import NOT_MEASURED, Content
from fast.flows.report.campaign.facts import Tool
from fast.flows.report.campaign.queries import Result
from fast.flows.report.folder import Folder
from fast.flows.report.html import Column, Markup, folded, paragraph, record_table, section, table, text
from fast.flows.report.lineage import lineage_text
from fast.lake.query.lineage import find_lineage
from fast.lake.tables.requests import PLACEMENT
from fast.tasks.templates import DASH, count, moment, number

PAPER = {"grasp_s": "15", "grasps_per_hour": "240, the most", "measured": "8,532", "simulated": "50,608"}  # Results

N_PARENTS = 5  # more rows of one table beside a row are only counted
_LOCKSTEP = Markup(
    "This virtual bench worked in lockstep: it does not wait, and the clock times below are the computer's. "
    "<code>fast gantry plan</code> says what the same batch takes on a bench."
)

_NO_MEASUREMENT = "needs a measured tool"
_NO_CALIBRATION = "needs a calibration: fast calibrate"
_NO_PAIRS = "needs a measured design that was simulated with the same grasp setup"
_NO_BASELINE = "needs a second approach: fast compare, then fast report CAMPAIGN --against LAKE"
_NO_FIT = "needs a fit of the surrogate or a calibration"

# Figure, what it shows, anchor in the page, what is drawn or asked for it (one of these), what is missing without.
_ROWS = (
    ("Fig. 2a", "Tools found, against other approaches", "baselines", ("approaches",), _NO_BASELINE),
    ("Fig. 2a", "Tool quality by batch", "progress", ("quality_by_batch",), _NO_MEASUREMENT),
    ("Fig. 2b", "Closure and pull-up of a grasp", "moments", ("moments/1",), _NO_MEASUREMENT),
    ("Fig. 2c", "Work to break the grasp, by object", "work", ("work_by_object",), _NO_MEASUREMENT),
    ("Table 1", "Parameters of the best finger", "best", ("profile",), _NO_MEASUREMENT),
    ("Fig. 3a", "Simulated against measured", "agreement", ("agreement_designs",), _NO_PAIRS),
    ("Fig. 3b", "The same after calibration", "calibration", ("calibration_agreement",), _NO_CALIBRATION),
    ("Fig. 4", "Posterior of theta, the simulator's constants", "calibration", ("calibration_pairs",), _NO_CALIBRATION),
    ("Table 2", "Statistics of the posterior", "calibration", ("calibration_pairs",), _NO_CALIBRATION),
    ("Fig. 5a, b", "Traces of the first and the last batch", "traces", ("traces/",), _NO_MEASUREMENT),
    ("Fig. 5c-f", "Traces by shape", "shapes", ("shapes/",), _NO_MEASUREMENT),
    ("Fig. 5g", "Grasps lost too early", "shapes", ("early_losses",), _NO_MEASUREMENT),
    ("Suppl. 1, 2", "Noise and amplitude of the discrepancy", "supplement", ("calibration_noise",), _NO_CALIBRATION),
    ("Suppl. 3, 4", "Sensitivities: discrepancy (k_eps), simulator (k_h)", "supplement",
     ("calibration_sensitivity",),
     _NO_CALIBRATION),
    ("Suppl. 3, 4", "The same, of the surrogate", "surrogate", ("relevance",), _NO_FIT),
    ("Resource usage", "Throughput", "cost", ("throughput",), _NO_MEASUREMENT),
)  # fmt: skip


def write_tools(content: Content, folder: Folder) -> Markup:
    """Every tool, best first."""
    if not content.tools:
        return section("tools", "All tools", paragraph("No tool has been printed and mounted yet."))
    ranked = sorted(content.tools, key=lambda t: (not t.is_complete, -(t.quality_n or 0.0), t.batch, t.slot))
    top = max((t.quality_n or 0.0 for t in ranked), default=0.0)
    rows = [
        (
            number(place, 0) if tool.is_complete else DASH, _mark(tool), tool.kind, number(tool.quality_n, 2),
            number(tool.half_width_n, 2), _bar(tool, top), number(tool.work_j, 3), tool.n_objects, tool.n_grasps,
            tool.n_failed, _note(tool),
        )
        for place, tool in enumerate(ranked, start=1)
    ]  # fmt: skip
    headings = (
        "rank",
        "tool",
        "design",
        "quality (N)",
        "± 95 % (N)",
        Markup(""),
        "work (J)",
        "objects",
        "grasps",
        "failed",
        "note",
    )
    best_row = ranked.index(content.best) if content.best else None
    return section(
        "tools", "All tools", table(headings, rows, numeric=(0, 3, 4, 6, 7, 8, 9), best_row=best_row),
        folder.sources(content.quality),
    )  # fmt: skip


def _note(tool: Tool) -> Markup:
    if tool.reason or tool.status == "rejected":
        return Markup(text(tool.reason or tool.status))
    if tool.reference is not None and tool.is_complete:
        return Markup(text(f"reference finger {tool.reference}"))
    return Markup("" if tool.is_complete else "not all objects" if tool.n_objects else "not measured yet")


def _mark(tool: Tool) -> Markup:
    return Markup(f'<span class="mark {text(tool.kind)}"></span>{text(tool.label)}')


def _bar(tool: Tool, top: float) -> Markup:
    share = 100 * max(tool.quality_n or 0.0, 0.0) / top if top > 0 else 0.0
    return Markup(f'<span class="bar"><i class="{text(tool.kind)}" style="width:{share:.1f}%"></i></span>')


def write_cost(content: Content, folder: Folder) -> Markup:
    """Batches, throughput, simulations and failures."""
    failures = content.result("failures", queries.FAILURES)
    pace, throughput_source = describe_throughput(content)
    reasons: dict[str, Column] = {"what failed": "what", "reason": "reason", "times": ("n", 0)}
    return section(
        "cost",
        "What it took",
        pace,
        "<h3>Bench</h3>",
        record_table(content.batches.rows, _BATCHES, "No batch has been chosen yet."),
        "<h3>Simulator</h3>",
        record_table(content.cost.rows, _SIMULATIONS, "Nothing has been simulated yet."),
        "<h3>Failures</h3>",
        record_table(failures.rows, reasons, "Nothing failed."),
        folder.sources(content.batches, content.cost, failures, throughput_source),
    )


def describe_throughput(content: Content) -> tuple[Markup, Result]:
    """Counts, seconds per grasp, grasps per hour, and what was simulated while the bench worked."""
    result = content.result("throughput", queries.THROUGHPUT)
    row = result.rows[0]
    pause, trace_s = row["median_interval_s"], row["median_trace_s"]
    is_lockstep = bool(row["is_virtual"] and pause and trace_s and pause < trace_s)
    if is_lockstep:
        pause = None
    rows = [
        ("grasps measured, failed ones too", number(row["n_grasps"], 0), PAPER["measured"]),
        ("grasps simulated", number(row["n_simulated"], 0), PAPER["simulated"]),
        (
            f"of these, within {queries.MEANWHILE_S:g} s of a measured grasp",
            number(row["n_simulated_meanwhile"], 0),
            DASH,
        ),
        ("closing and lift of a grasp (s), by its trace", number(trace_s, 1), DASH),
        ("start of a grasp to start of the next (s), within a tool", number(pause, 1), PAPER["grasp_s"]),
        ("grasps per hour at that pace", number(3600 / pause if pause else None, 0), PAPER["grasps_per_hour"]),
    ]
    shown = table(("throughput", "this campaign", "paper"), rows, numeric=(1, 2))
    shown = Markup(f'<div class="words">{shown}</div>')
    return Markup(shown + (paragraph(_LOCKSTEP, "note") if is_lockstep else "")), result


_BATCHES: dict[str, Column] = {
    "batch": lambda row: f"B{row['batch']:02d}",
    "kind": "kind",
    "tools": ("n_tools", 0),
    "grasps": ("n_grasps", 0),
    "failed": ("n_failed", 0),
    "first grasp (UTC)": lambda row: moment(row["first_grasp_at"]),
    "hours": ("duration_h", 2),
    "grasps per hour": ("grasps_per_h", 0),
}
_SIMULATIONS: dict[str, Column] = {
    "simulator version": "version_id",
    "designs": ("n_designs", 0),
    "simulated": ("n_ok", 0),
    "failed": ("n_failed", 0),
    "median CPU s": ("median_cpu_s", 2),
    "total CPU h": ("total_cpu_h", 2),
}
_ROWS_OF: dict[str, Column] = {
    "rows": "rows_of",
    "code version": lambda row: f"{row['code_version']}{' with local changes' if row['code_dirty'] else ''}",
    "config hash": "config_hash",
    "bench": "bench",
    "world hash": "world_hash",
    "count": ("n", 0),
}
_SETUPS: dict[str, Column] = {
    "grasp setup": "setup_id",
    "values (mm, mm/s)": lambda row: Markup(f'<code class="wrap">{text(_pairs(row))}</code>'),
    "grasps": ("n_grasps", 0),
    "asked for by a search": ("n_asked", 0),
}


def write_provenance(content: Content, folder: Folder) -> Markup:
    """Where the rows came from, and how to make the page again."""
    setups = content.result("setups", queries.SETUPS)
    campaign = content.campaign
    config = folded("Config of the campaign", f"<pre>{text(campaign.config_toml)}</pre>")
    commands = (
        f"fast report {campaign.campaign_id}          # this page, from the lake as it is now\n"
        f"fast view {campaign.campaign_id}            # its grasps in the Rerun viewer\n"
        'fast sql "$(cat data/tool_quality.sql)"       # any table or figure of this page'
    )
    again = "<h3>The same again</h3>" + paragraph(
        "Every figure and table is the answer of one query, kept beside its data in the folder data."
    ) + f"<pre>{text(commands)}</pre>"  # fmt: skip
    return section(
        "provenance",
        "Where it came from",
        record_table(content.provenance.rows, _ROWS_OF),
        record_table(setups.rows, _SETUPS, "No grasp has been measured yet."),
        config,
        _lineage(content),
        again,
        folder.sources(content.provenance, setups),
    )


def _pairs(row: Mapping[str, Any]) -> str:
    """Setup and placement of grasps, without what is as on any bench."""
    values = json.loads(row["setup_json"]) | {name: row[name] or None for name in PLACEMENT}
    return ", ".join(f"{key} {value:g}" for key, value in values.items() if value is not None)


def _lineage(content: Content) -> str:
    """What the best tool was made from, as `fast lake lineage` tells it."""
    best = content.best
    if best is None:
        return paragraph(NOT_MEASURED)
    tree = lineage_text(find_lineage(content.lake, best.tool_id, forward=False, depth=None, limit=N_PARENTS))
    words = paragraph(
        f"Its quality, {number(best.quality_n, 2, 'N')}, is the peak of each of its {count(best.n_grasps, 'trace')}, "
        f"mean over repeats, mean over {count(best.n_objects, 'object')}. Each row was made from those below it:"
    )
    commands = (
        f"fast lake lineage {best.tool_id}               # the same, for any row of the lake\n"
        f"fast lake lineage {best.tool_id} --children    # every grasp behind its quality"
    )
    return f"<h3>From idea to number: {best.label}</h3>{words}<pre>{text(tree)}</pre><pre>{text(commands)}</pre>"


def write_paper(content: Content, folder: Folder) -> Markup:
    """A table of the paper's figures with links to what the sections before this one have drawn."""
    rows = []
    for figure, what, anchor, marks, missing in _ROWS:
        is_there = any(name.startswith(mark) for name in folder.written for mark in marks)
        rows.append((figure, what, Markup(f'<a href="#{anchor}">here</a>') if is_there else missing))
    note = paragraph(
        "Fig. 1 shows the authors' platform. Fig. 2b: photographs there, drawn from the simulator here.", "note"
    )
    shown = table(("paper", "what it shows", "in this report"), rows)
    return section("paper", "The paper's figures and tables", f'<div class="words">{shown}</div>', note)
