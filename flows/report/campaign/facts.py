"""What the report states, computed from the query results: best tool, its interval, agreement with simulation."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from fast.lake.tables.campaign import design_of_columns
from fast.models.design.reference import find_reference
from fast.models.errors import FastError
from fast.models.ids import tool_label

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Tool:
    """A tool of the campaign and what was measured with it."""

    label: str
    """`B01T0`."""
    batch: int
    """From 1."""
    slot: int
    """Of its batch, 0 to 9."""
    kind: str
    """Of its batch: random, guided or imported; empty where the lake does not say."""
    tool_id: str
    """`<campaign_id>/B01T0`."""
    design_id: str
    """Of what it was printed from."""
    status: str
    """printed or rejected."""
    reason: str
    """Why it was rejected."""
    quality_n: float | None
    """Mean over objects of the mean over repeats of the peak pull-off force; None where nothing was measured."""
    half_width_n: float | None
    """Half of the 95 % interval of that, from the scatter between repeats; None where nothing was repeated."""
    work_j: float | None
    """Work of the pull, averaged as the quality is; None where it is not known."""
    n_objects: int
    """On which it has valid grasps."""
    n_grasps: int
    """Valid ones."""
    n_failed: int
    """Attempts that failed."""
    is_complete: bool
    """Whether it was measured on as many objects as the best covered tool."""
    reference: str | None = None
    """Name of the reference finger that it is; None for any other tool."""


@dataclass(frozen=True)
class Agreement:
    """How well n simulated numbers predict n measured ones. Correlations are NaN below three pairs."""

    n: int
    pearson: float
    spearman: float
    rmse_n: float
    bias_n: float


def find_references(design_rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Find the names of the reference fingers among designs (columns of the table `designs`), by design id."""
    found = {}
    for row in design_rows:
        try:
            name = find_reference(design_of_columns(row))
        except FastError:  # of a family that is not known here: then it is none of ours
            continue
        if name is not None:
            found[row["design_id"]] = name
    return found


def read_tools(rows: Sequence[Mapping[str, Any]], references: Mapping[str, str] | None = None) -> list[Tool]:
    """Read tools in order of batch and slot; complete means measured on as many objects as the best covered tool.

    references: names of those designs that are reference fingers, by design id.
    """
    most = max((row["n_objects"] for row in rows), default=0)
    return [
        Tool(
            label=tool_label(row["batch"], row["slot"]),
            half_width_n=_half_width(row["quality_se_n"], row["n_freedom"]),
            is_complete=row["n_objects"] == most > 0,
            kind=row["kind"] or "",
            **{
                key: row[key]
                for key in "batch slot tool_id design_id status quality_n work_j n_objects n_grasps n_failed".split()
            },
            reason=row["reason"] or "",
            reference=(references or {}).get(row["design_id"]),
        )
        for row in rows
    ]


def _half_width(standard_error: float | None, n_freedom: int | None) -> float | None:
    if standard_error is None or not n_freedom:
        return None
    return float(scipy.special.stdtrit(n_freedom, 0.5 + CONFIDENCE / 2)) * standard_error


def find_best_tool(tools: Sequence[Tool]) -> Tool | None:
    """Find the tool of highest quality among completely measured ones (a few easy objects make no good tool).

    A reference finger is what others are compared with: it is the best only where nothing else was measured.
    """
    return max(_complete(tools), key=_quality, default=None)


def find_first_batch(tools: Sequence[Tool]) -> list[Tool]:
    """Find the completely measured tools of the first random batch (of the first batch, where none was random)."""
    measured = _complete(tools)
    random = [t for t in measured if t.kind == "random"] or measured
    first = min((t.batch for t in random), default=0)
    return [t for t in random if t.batch == first]


def find_last_batch(tools: Sequence[Tool]) -> list[Tool]:
    """Find the completely measured tools of the newest batch that has any."""
    measured = _complete(tools)
    last = max((t.batch for t in measured), default=0)
    return [t for t in measured if t.batch == last]


def _complete(tools: Sequence[Tool]) -> list[Tool]:
    """Return the completely measured tools but for reference fingers; these alone where there is nothing else."""
    measured = [t for t in tools if t.is_complete]
    return [t for t in measured if t.reference is None] or measured


def average_quality_n(tools: Sequence[Tool]) -> float:
    """Compute the mean tool quality of measured tools, in N."""
    return float(np.mean([_quality(t) for t in tools]))


def count_objects_won(work_rows: Sequence[Mapping[str, Any]], winner: Tool, others: Sequence[Tool]) -> tuple[int, int]:
    """Count the objects on which the winner's mean peak force is above the mean of the others; and of how many."""
    peaks: dict[tuple[int, int], dict[int, float]] = defaultdict(dict)
    for row in work_rows:
        peaks[row["batch"], row["slot"]][row["object_id"]] = row["peak_force_n"]
    theirs = [peaks[t.batch, t.slot] for t in others]
    mine = peaks[winner.batch, winner.slot]
    shared = [o for o in mine if all(o in other for other in theirs)]
    won = [o for o in shared if mine[o] > np.mean([other[o] for other in theirs])]
    return len(won), len(shared)


def average_objects(pairs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Average simulated and measured force of each tool, from those of tool and object, over objects with both."""
    grouped: dict[tuple[int, int], list[tuple[float, float]]] = defaultdict(list)
    for pair in pairs:
        grouped[pair["batch"], pair["slot"]].append((pair["simulated_n"], pair["measured_n"]))
    means = {tool: np.mean(values, axis=0) for tool, values in sorted(grouped.items())}
    return [{"batch": batch, "simulated_n": s, "measured_n": m} for (batch, _), (s, m) in means.items()]


def measure_agreement(pairs: Sequence[Mapping[str, Any]]) -> Agreement:
    """Compute Pearson and Spearman correlation, RMS error and mean error (simulated - measured), in N."""
    simulated = np.array([p["simulated_n"] for p in pairs])
    measured = np.array([p["measured_n"] for p in pairs])
    error = simulated - measured
    has_spread = len(pairs) >= 3 and np.ptp(simulated) > 0 and np.ptp(measured) > 0
    return Agreement(
        n=len(pairs),
        pearson=float(scipy.stats.pearsonr(simulated, measured)[0]) if has_spread else float("nan"),
        spearman=float(scipy.stats.spearmanr(simulated, measured)[0]) if has_spread else float("nan"),
        rmse_n=float(np.sqrt(np.mean(error**2))),
        bias_n=float(np.mean(error)),
    )


def choose_versions(rows: Sequence[Mapping[str, Any]], ordered: Sequence[str], in_use: str | None = None) -> list[str]:
    """Choose simulator versions to compare with measurements: the oldest that has pairs, and the one in use.

    Where none is in use, or it has no pairs, the newest stands beside the oldest. Where any is of the production tier,
    only that tier is compared. `ordered` lists versions by age.
    """
    production = [r for r in rows if r["tier"] == "production"]
    present = {r["version_id"] for r in (production or rows)}
    found = [v for v in ordered if v in present]
    if len(found) < 2 or in_use == found[0]:
        return found[:1]
    return [found[0], in_use if in_use in found else found[-1]]


def _quality(tool: Tool) -> float:
    return tool.quality_n if tool.quality_n is not None else -np.inf
