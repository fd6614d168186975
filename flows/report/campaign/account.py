"""Sections of the report that say what it took, where every number came from, and where the paper's figures are."""

import json

from flows.report.campaign import queries
from flows.report.campaign.content import NOT_MEASURED, Content
from flows.report.campaign.facts import Tool
from flows.report.campaign.queries import Result
from flows.report.folder import Folder
from flows.report.html import DASH, Markup, count, moment, number, paragraph, section, table, text

PAPER = {"grasp_s": "15", "grasps_per_hour": "240, the most", "measured": "8,532", "simulated": "50,608"}  # Results

_LOCKSTEP = Markup(
    "This virtual bench worked in lockstep: it does not wait, and the clock times below are the computer's. "
    "<code>fast gantry plan</code> says what the same batch takes on a bench."
)

_NO_MEASUREMENT = "needs a measured tool"
_NO_CALIBRATION = "needs a calibration: fast calibrate"
_NO_PAIRS = "needs a measured design that was simulated with the same grasp setup"
_NO_BASELINE = "needs a second approach: fast compare, then fast report CAMPAIGN --against LAKE"
_NO_FIT = "needs a fit of the surrogate or a calibration"

# Figure, what it shows, anchor in the page, marks of which one must be in the page, what is missing where none is.
_ROWS = (
    ("Fig. 2a", "Tools found, against other approaches", "baselines", ("figures/approaches.svg",), _NO_BASELINE),
    ("Fig. 2a", "Tool quality by batch", "progress", ("figures/quality_by_batch.svg",), _NO_MEASUREMENT),
    ("Fig. 2b", "Closure and pull-up of a grasp", "moments", ("figures/moments/",), _NO_MEASUREMENT),
    ("Fig. 2c", "Work to break the grasp, by object", "work", ("figures/work_by_object.svg",), _NO_MEASUREMENT),
    ("Table 1", "Parameters of the best finger", "best", ("figures/profile.svg",), _NO_MEASUREMENT),
    ("Fig. 3a", "Simulated against measured", "agreement", ("figures/agreement_designs.svg",), _NO_PAIRS),
    ("Fig. 3b", "The same after calibration", "calibration", ("figures/calibration_agreement",), _NO_CALIBRATION),
    ("Fig. 4", "Joint posterior of theta", "calibration", ("figures/calibration_pairs.svg",), _NO_CALIBRATION),
    ("Table 2", "Statistics of the posterior", "calibration", ("figures/calibration_pairs.svg",), _NO_CALIBRATION),
    ("Fig. 5a, b", "Traces of the first and the last batch", "traces", ("figures/traces/",), _NO_MEASUREMENT),
    ("Fig. 5c-f", "Traces by shape", "shapes", ("figures/shapes/",), _NO_MEASUREMENT),
    ("Fig. 5g", "Grasps lost too early", "shapes", ("early_losses.sql",), _NO_MEASUREMENT),
    ("Suppl. 1, 2", "Noise and amplitude of the discrepancy", "supplement", ("calibration_noise.svg", "tool_sd.svg"),
     _NO_CALIBRATION),
    ("Suppl. 3, 4", "Sensitivities: lengthscales of k_eps and k_h", "supplement", ("calibration_sensitivity",), ""),
    ("Suppl. 3, 4", "The same, of the surrogate", "surrogate", ("figures/relevance.svg",), _NO_FIT),
    ("Resource usage", "Throughput", "cost", ("throughput.sql",), _NO_MEASUREMENT),
)  # fmt: skip


def tools_section(content: Content, folder: Folder) -> Markup:
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
    best_row = 0 if content.best else None
    return section(
        "tools", "All tools", table(headings, rows, numeric=(0, 3, 4, 6, 7, 8, 9), best_row=best_row),
        folder.sources(content.quality),
    )  # fmt: skip


def _note(tool: Tool) -> Markup:
    if tool.reason or tool.status == "rejected":
        return Markup(text(tool.reason or tool.status))
    return Markup("" if tool.is_complete else "not all objects" if tool.n_objects else "not measured yet")


def _mark(tool: Tool) -> Markup:
    return Markup(f'<span class="mark {text(tool.kind)}"></span>{text(tool.label)}')


def _bar(tool: Tool, top: float) -> Markup:
    share = 100 * max(tool.quality_n or 0.0, 0.0) / top if top > 0 else 0.0
    return Markup(f'<span class="bar"><i class="{text(tool.kind)}" style="width:{share:.1f}%"></i></span>')


def cost_section(content: Content, folder: Folder) -> Markup:
    """Batches, throughput, simulations and failures."""
    failures = content.result("failures", queries.FAILURES)
    pace, throughput_source = describe_throughput(content)
    reasons = [(row["what"], row["reason"], row["n"]) for row in failures.rows]
    return section(
        "cost",
        "What it took",
        pace,
        "<h3>Bench</h3>",
        _batches_table(content),
        "<h3>Simulator</h3>",
        _simulations_table(content),
        "<h3>Failures</h3>",
        table(("what failed", "reason", "times"), reasons, numeric=(2,), empty="Nothing failed."),
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


def _batches_table(content: Content) -> Markup:
    headings = ("batch", "kind", "tools", "grasps", "failed", "first grasp (UTC)", "hours", "grasps per hour")
    rows = [
        (
            f"B{row['batch']:02d}",
            row["kind"],
            row["n_tools"],
            row["n_grasps"],
            row["n_failed"],
            moment(row["first_grasp_at"]),
            number(row["duration_h"], 2),
            number(_rate(row["n_grasps"] + row["n_failed"], row["duration_h"]), 0),
        )
        for row in content.batches.rows
    ]
    return table(headings, rows, numeric=(2, 3, 4, 6, 7), empty="No batch has been chosen yet.")


def _simulations_table(content: Content) -> Markup:
    headings = ("simulator version", "designs", "simulated", "failed", "median CPU s", "total CPU h")
    rows = [
        (
            row["version_id"],
            row["n_designs"],
            row["n_ok"],
            row["n_failed"],
            number(row["median_cpu_s"], 2),
            number(row["total_cpu_h"], 2),
        )
        for row in content.cost.rows
    ]
    return table(headings, rows, numeric=(1, 2, 3, 4, 5), empty="Nothing has been simulated yet.")


def _rate(count: int, duration_h: float | None) -> float | None:
    return count / duration_h if duration_h else None


def provenance_section(content: Content, folder: Folder) -> Markup:
    """Where the rows came from, and how to make the page again."""
    setups = content.result("setups", queries.SETUPS)
    rows = table(
        ("rows", "code version", "config hash", "bench", "world hash", "count"),
        [
            (r["rows_of"], f"{r['code_version']}{' with local changes' if r['code_dirty'] else ''}", r["config_hash"],
             r["bench"], r["world_hash"], number(r["n"], 0))
            for r in content.provenance.rows
        ], numeric=(5,),
    )  # fmt: skip
    setup = table(
        ("grasp setup", "values (mm, mm/s)", "grasps"),
        [(r["setup_id"], Markup(f"<code>{text(_pairs(r['setup_json']))}</code>"), r["n_grasps"]) for r in setups.rows],
        numeric=(2,),
        empty="No grasp has been measured yet.",
    ).replace("<td><code>", '<td class="wrap"><code>')
    campaign = content.campaign
    config = f"<details><summary>Config of the campaign</summary><pre>{text(campaign.config_toml)}</pre></details>"
    commands = (
        f"fast report {campaign.campaign_id}          # this page, from the lake as it is now\n"
        f"fast view {campaign.campaign_id}            # its grasps in the Rerun viewer\n"
        'fast sql "$(cat data/tool_quality.sql)"       # any table or figure of this page'
    )
    again = "<h3>The same again</h3>" + paragraph(
        "Every figure and table is the answer of one query, kept beside its data in the folder data."
    ) + f"<pre>{text(commands)}</pre>"  # fmt: skip
    return section(
        "provenance", "Where it came from", rows, setup, config, _lineage(content, folder), again,
        folder.sources(content.provenance, setups),
    )  # fmt: skip


def _pairs(setup_json: str) -> str:
    return ", ".join(f"{key} {value:g}" for key, value in json.loads(setup_json).items())


def _lineage(content: Content, folder: Folder) -> str:
    """The best tool, from proposal to quality."""
    best = content.best
    if best is None:
        return paragraph(NOT_MEASURED)
    result = content.result("lineage", queries.LINEAGE, best=best.tool_id)
    row = result.rows[0]
    measured = [
        f"{wall} {row[f'measured_{wall}_thickness_mm']:.2f} mm"
        for wall in ("front", "back", "rib")
        if row[f"measured_{wall}_thickness_mm"] is not None
    ]
    if row["hardness_shore_a"] is not None:
        measured.append(f"hardness {row['hardness_shore_a']:g} Shore A")
    steps = [
        f"Proposal {row['proposal_id'] or DASH} asked for design {row['design_id']}.",
        f"Printed and mounted as {row['tool_id']}, confirmed by {_who(row)} on {moment(row['confirmed_at'])} UTC"
        + (f", lot {row['material_lot']}" if row["material_lot"] else "") + ".",
        f"Measured after printing: {', '.join(measured)}." if measured else "Walls and hardness were not measured.",
        f"{row['n_grasps']} grasps from {moment(row['first_grasp_at'])} to {moment(row['last_grasp_at'])} UTC, each "
        "with its raw trace.",
        f"Peak of each trace, mean over repeats, mean over {count(best.n_objects, 'object')}: "
        f"{number(best.quality_n, 2, 'N')}.",
    ]  # fmt: skip
    items = "".join(f"<li>{text(step)}</li>" for step in steps)
    commands = (
        f"fast lake lineage {best.tool_id}               # every row it came from, with code, config and seed\n"
        f"fast lake lineage {best.tool_id} --children    # every grasp behind its quality"
    )
    return (
        f"<h3>From idea to number: {best.label}</h3><ol class='lineage'>{items}</ol><pre>{text(commands)}</pre>"
        f"{folder.sources(result)}"
    )


def _who(row: dict) -> str:
    return row["operator"] or {"person": "a person", "auto": "the campaign itself"}[row["confirmed_by"]]


def paper_section(body: str) -> Markup:
    """A table of the paper's figures with links into the page made so far."""
    rows = []
    for figure, what, anchor, marks, missing in _ROWS:
        is_there = any(mark in body for mark in marks)
        where = Markup(f'<a href="#{anchor}">here</a>') if is_there else missing or _NO_CALIBRATION
        rows.append((figure, what, where))
    note = paragraph(
        "Fig. 1 shows the authors' platform. Fig. 2b: photographs there, drawn from the simulator here.", "note"
    )
    shown = table(("paper", "what it shows", "in this report"), rows)
    return section("paper", "The paper's figures and tables", f'<div class="words">{shown}</div>', note)
