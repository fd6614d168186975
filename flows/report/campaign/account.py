"""Sections of the report that say what it took, where every number came from, and where the paper's figures are."""

import json
from collections.abc import Mapping
from typing import Any

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder
from fast.flows.report.lineage import lineage_text
from fast.lake.query.lineage import find_lineage
from fast.lake.tables.requests import PLACEMENT
from fast.models.errors import spell_reason
from fast.tasks.templates import moment, number

PAPER = {"grasp_s": "15", "grasps_per_hour": "240, the most", "measured": "8,532", "simulated": "50,608"}  # Results

_COST_QUERIES = {"failures": queries.FAILURES, "throughput": queries.THROUGHPUT}
N_PARENTS = 5  # more rows of one table beside a row are only counted
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


def prepare_tools(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare every tool, best first."""
    folder.save(content.quality)
    ranked = sorted(content.tools, key=lambda t: (not t.is_complete, -(t.quality_n or 0.0), t.batch, t.slot))
    top_n = max((t.quality_n or 0.0 for t in ranked), default=0.0)
    return {"ranked": ranked, "top_n": top_n if top_n > 0 else 1.0}


def prepare_cost(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare batches, throughput, simulations and failures."""
    failures, pace = (content.result(name, sql) for name, sql in _COST_QUERIES.items())
    folder.save(content.batches, content.cost, failures, pace)
    (row,) = pace.rows
    pause, trace_s = row["median_interval_s"], row["median_trace_s"]
    is_lockstep = bool(row["is_virtual"] and pause and trace_s and pause < trace_s)
    return {
        "batches": [
            {**row, "label": f"B{row['batch']:02d}", "first_grasp": moment(row["first_grasp_at"])}
            for row in content.batches.rows
        ],
        "failures": [{**row, "reason": spell_reason(row["reason"])} for row in failures.rows],
        "failures_asked": failures,
        "pace": pace,
        "is_lockstep": is_lockstep,
        "throughput": _list_throughput(row, None if is_lockstep else pause, trace_s),
    }


def _list_throughput(row: Mapping[str, Any], pause_s: float | None, trace_s: float | None) -> list[dict[str, Any]]:
    """List counts, seconds per grasp, grasps per hour, and what was simulated while the bench worked."""
    n_meanwhile = number(row["n_simulated_meanwhile"], 0)
    rows = [
        ("grasps measured, failed ones too", number(row["n_grasps"], 0), PAPER["measured"]),
        ("grasps simulated", number(row["n_simulated"], 0), PAPER["simulated"]),
        (f"of these, within {queries.MEANWHILE_S:g} s of a measured grasp", n_meanwhile, ""),
        ("closing and lift of a grasp (s), by its trace", number(trace_s, 1), ""),
        ("start of a grasp to start of the next (s), within a tool", number(pause_s, 1), PAPER["grasp_s"]),
        ("grasps per hour at that pace", number(3600 / pause_s if pause_s else None, 0), PAPER["grasps_per_hour"]),
    ]  # fmt: skip
    return [{"what": what, "here": here, "paper": paper} for what, here, paper in rows]


def prepare_provenance(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare where the rows came from, and what the best tool was made from, as `fast lake lineage` tells it."""
    setups = content.result("setups", queries.SETUPS)
    folder.save(content.provenance, setups)
    told: dict[str, Any] = {
        "rows": [
            {**row, "code": f"{row['code_version']}{' with local changes' if row['code_dirty'] else ''}"}
            for row in content.provenance.rows
        ],
        "setups": setups,
        "describe_setup": _describe_setup,
    }
    if content.best is not None:
        found = find_lineage(content.lake, content.best.tool_id, forward=False, depth=None, limit=N_PARENTS)
        told["lineage"] = lineage_text(found)
    return told


def _describe_setup(row: Mapping[str, Any]) -> str:
    """Describe setup and placement of grasps, without what is as on any bench."""
    values = json.loads(row["setup_json"]) | {name: row[name] or None for name in PLACEMENT}
    return ", ".join(f"{key} {value:g}" for key, value in values.items() if value is not None)


def prepare_paper(_content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare the paper's figures, and what is missing for those that the sections before have not drawn."""
    return {
        "rows": [
            (figure, what, anchor, "" if any(name.startswith(marks) for name in folder.written) else missing)
            for figure, what, anchor, marks, missing in _ROWS
        ]
    }
