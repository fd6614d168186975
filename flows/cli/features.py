"""`fast features`: features of the measured traces, and what they say about tools, objects and batches."""

import math
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, show, table_text, tell

if TYPE_CHECKING:
    from models.features.quality import Interval
    from tasks.features import ClassQuality, FeatureUpdate

_TITLES = {
    "tool_quality_n": "tool quality: mean peak pull-off force (N)",
    "work_j": "grasp quality: mean work to break the grasp (J)",
    "peak_cv": "stability: coefficient of variation of the peak over the repeats (smaller is steadier)",
}


def features(
    *,
    lake: LakePath = DEFAULT_LAKE,
    campaign: Annotated[str | None, Parameter(help="Campaign whose grasps count; default: all of the lake.")] = None,
    json: AsJson = False,
) -> None:
    """Calculate the features of traces that lack them, then quality, work and stability per object class and batch."""
    from flows.cli.campaign import open_lake, resolve_campaign
    from tasks.features import class_quality, update_features

    found = open_lake(lake)
    name = resolve_campaign(found, campaign) if campaign is not None else None
    update = update_features(found, name, tell)
    rows = class_quality(found, name)
    show({**update._asdict(), "quality": [_data(row) for row in rows]}, _text(update, rows), json)


def _data(row: "ClassQuality") -> dict[str, Any]:
    """Row with intervals as objects; bounds that a single tool does not have are null."""
    data = row._asdict()
    for name in ("first", "last", "change"):
        if data[name] is not None:
            data[name] = {k: None if v != v else v for k, v in data[name]._asdict().items()}
    return data


def _text(update: "FeatureUpdate", rows: "list[ClassQuality]") -> str:
    parts = [f"{update.n_grasps} grasps with features, {update.n_new} of them calculated now"]
    if update.n_without_lift:
        parts[0] += f"; {update.n_without_lift} left out, whose traces lift less than 3 mm"
    for campaign in dict.fromkeys(row.campaign_id for row in rows):
        for measure, title in _TITLES.items():
            chosen = [row for row in rows if (row.campaign_id, row.measure) == (campaign, measure)]
            if chosen:
                parts.append(f"{campaign}, {title}\n\n{table_text([_line(row) for row in chosen])}")
    parts.append("Brackets: 95 % bootstrap intervals over tools.")
    return "\n\n".join(parts)


def _line(row: "ClassQuality") -> dict[str, str]:
    line = {"objects": row.object_class, f"batch {row.first_batch}": _interval(row.first)}
    if row.last is not None and row.change is not None:
        line |= {f"batch {row.last_batch}": _interval(row.last), "change": _interval(row.change)}
    return line


def _interval(value: "Interval") -> str:
    if math.isnan(value.lower):
        return f"{value.mean:.3g}"
    return f"{value.mean:.3g} [{value.lower:.3g}, {value.upper:.3g}]"
