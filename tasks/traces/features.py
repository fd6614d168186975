"""Features of the lake's grasps: calculate what is missing, and sum up tools by object class and batch."""

from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from typing import Any, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import TraceFeaturesRow
from fast.models.errors import UsageError
from fast.models.traces.batch import features_of_samples
from fast.models.traces.names import FEATURE_VERSION, MIN_LIFT_MM
from fast.models.traces.quality import Interval, difference_of_tools, mean_of_tools
from fast.models.validation import check_type

AT_ONCE = 4096  # grasps whose samples are in memory: 80 MB of 1,200 each
ALL_OBJECTS = "all objects"
MEASURES = ("tool_quality_n", "work_j", "peak_cv")

_GRASPS = """
    SELECT g.grasp_id, w.created_at,
        f.feature_id IS NULL OR (f.sequence, f.created_at) < (w.sequence, w.created_at) AS is_missing
    FROM grasps AS g JOIN trace_times AS w USING (grasp_id)
    LEFT JOIN trace_features AS f ON f.grasp_id = g.grasp_id AND f.feature_version = $version
    WHERE g.status = 'ok' AND ($campaign IS NULL OR g.campaign_id = $campaign)
    ORDER BY w.created_at, g.grasp_id
"""
_SAMPLES = """
    SELECT grasp_id, lift_mm, force_n FROM traces
    WHERE created_at BETWEEN $first AND $last AND grasp_id IN (SELECT unnest($ids))
"""
_TOOLS = f"""
    SELECT
        campaign_id, coalesce(batch, 1) AS batch, tool_id,
        CASE WHEN grouping({{by}}) = 1 THEN '{ALL_OBJECTS}' ELSE coalesce({{by}}, 'unknown') END AS class,
        avg(peak_force_n) AS tool_quality_n, avg(work_j) AS work_j, avg(peak_cv) AS peak_cv
    FROM repeatability WHERE $campaign IS NULL OR campaign_id = $campaign
    GROUP BY GROUPING SETS ((campaign_id, batch, tool_id, {{by}}), (campaign_id, batch, tool_id))
    ORDER BY ALL
"""


class FeatureUpdate(NamedTuple):
    """What an update did: grasps with features now, those calculated, and those whose traces lift too little."""

    n_grasps: int
    n_new: int
    n_without_lift: int


def update_features(
    lake: Lake, campaign_id: str | None = None, tell: Callable[[str], None] | None = None
) -> FeatureUpdate:
    """Calculate the features of the grasps that have none, or whose trace is newer, of a campaign or the whole lake.

    Rows are appended every `AT_ONCE` grasps: a killed update continues where it stopped.

    Raises:
        UsageError: there is no grasp with a trace, or none lifts; or this is no open lake.
    """
    check_type(lake, Lake, "the lake")
    grasps = lake.query(_GRASPS, {"version": FEATURE_VERSION, "campaign": campaign_id})
    if not grasps.num_rows:
        place = f"campaign {campaign_id}" if campaign_id else f"the lake {lake.address}"
        raise UsageError(
            f"{place} has no measured grasp with a trace, and features need one at least; measure tools with `fast "
            "campaign run CONFIG.toml`, or import data with `fast lake import DIR`."
        )
    missing = grasps.filter(grasps["is_missing"])
    n_new = 0
    for start in range(0, missing.num_rows, AT_ONCE):
        part = missing.slice(start, AT_ONCE)
        rows = _calculated(lake, part["grasp_id"].to_pylist(), part["created_at"].to_pylist())
        if rows:
            lake.append(rows, current_provenance())
        n_new += len(rows)
        if tell is not None:
            tell(f"{start + part.num_rows} of {missing.num_rows} grasps")
    n_without = missing.num_rows - n_new
    if n_without == grasps.num_rows:
        raise UsageError(
            f"none of {grasps.num_rows} traces lifts by {MIN_LIFT_MM:g} mm, so none shows a pull-off; check `lift_mm` "
            "of the traces that were imported."
        )
    return FeatureUpdate(grasps.num_rows - n_without, n_new, n_without)


def _calculated(lake: Lake, grasp_ids: list[str], written: list[datetime]) -> list[TraceFeaturesRow]:
    """Calculate rows of the grasps that lift; `written` are the times of their traces, in order."""
    samples = lake.query(_SAMPLES, {"first": written[0], "last": written[-1], "ids": grasp_ids})
    found = features_of_samples(*_flat(samples))
    usable = np.flatnonzero(found.is_usable).tolist()
    ids = samples["grasp_id"].to_pylist()
    return [TraceFeaturesRow.of(ids[i], found.row(i), found.profile_n[i].tolist()) for i in usable]


def _flat(samples: pa.Table) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lifts, forces and offsets of lists laid end to end."""
    lift, force = (samples[name].combine_chunks() for name in ("lift_mm", "force_n"))
    lengths = pc.list_value_length(lift).to_numpy(zero_copy_only=False)
    return lift.flatten().to_numpy(), force.flatten().to_numpy(), np.concatenate([[0], np.cumsum(lengths)])


class ClassQuality(NamedTuple):
    """One measure of the tools on a class of objects or an object: first batch, last batch, and the change."""

    campaign_id: str
    """Of the tools."""
    measure: str
    """What is compared."""
    object_class: str
    """Class of objects, or an object."""
    first_batch: int
    """Number, from 1."""
    first: Interval
    """Of its tools."""
    last_batch: int | None
    """Number; None where there is one batch alone."""
    last: Interval | None
    """Of its tools."""
    change: Interval | None
    """From the first to the last."""


def class_quality(
    lake: Lake, campaign_id: str | None = None, by: Literal["object_class", "object_name"] = "object_class"
) -> list[ClassQuality]:
    """Compare quality, work and scatter of repeats by object class or object, of each campaign's first and last batch.

    A tool counts with its mean over the objects of the class that it met, of which each counts with the mean over
    its repeats. Intervals are of the bootstrap over tools.
    """
    tools = lake.query(_TOOLS.format(by=by), {"campaign": campaign_id}).to_pylist()
    batches: dict[str, set[int]] = {}
    for tool in tools:
        batches.setdefault(tool["campaign_id"], set()).add(tool["batch"])
    found = [
        _compared(tools, campaign, measure, object_class, min(numbers), max(numbers))
        for campaign, numbers in batches.items()
        for measure in MEASURES
        for object_class in _classes(tools, campaign)
    ]
    return [row for row in found if row is not None]


def _classes(tools: Sequence[dict[str, Any]], campaign_id: str) -> Iterator[str]:
    """Yield object classes that a campaign met by name, all objects first."""
    met = {tool["class"] for tool in tools if tool["campaign_id"] == campaign_id}
    yield from sorted(met, key=lambda name: (name != ALL_OBJECTS, name))


def _compared(
    tools: Sequence[dict[str, Any]], campaign_id: str, measure: str, object_class: str, first: int, last: int
) -> ClassQuality | None:
    def values(batch: int) -> np.ndarray:
        key = (campaign_id, object_class, batch)
        of_batch = [t[measure] for t in tools if (t["campaign_id"], t["class"], t["batch"]) == key]
        return np.array([value for value in of_batch if value is not None], dtype=float)

    before, after = values(first), values(last)
    if not before.size:
        return None
    start = mean_of_tools(before)
    if first == last or not after.size:
        return ClassQuality(campaign_id, measure, object_class, first, start, None, None, None)
    change = difference_of_tools(before, after)
    return ClassQuality(campaign_id, measure, object_class, first, start, last, mean_of_tools(after), change)
