"""`fast features`: features of the measured traces, and what they say about tools, objects and batches."""

import math
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fast.flows.cli.campaign import open_lake, resolve_campaign
from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, say_progress, show, table_text
from fast.models.units import spell_share

if TYPE_CHECKING:
    from fast.lake.store import Lake
    from fast.models.traces.quality import Interval
    from fast.tasks.traces.features import ClassQuality, FeatureUpdate
    from fast.tasks.traces.identify import Likeliest

N_FLAGS = 20  # shown
LEAST_SHOWN = 0.005  # probability
_TITLES = {
    "tool_quality_n": "tool quality: mean peak pull-off force (N)",
    "work_j": "grasp quality: mean work to break the grasp (J)",
    "peak_cv": "stability: coefficient of variation of the peak over the repeats (smaller is steadier)",
}


def features(
    *,
    lake: LakePath = DEFAULT_LAKE,
    campaign: Annotated[str | None, Parameter(help="Campaign whose grasps count; default: all of the lake.")] = None,
    objects: Annotated[bool, Parameter(negative="", help="A row for each object in place of each class.")] = False,
    identify: Annotated[str | None, Parameter(help="Grasp: which object was it, by its trace?")] = None,
    json: AsJson = False,
) -> None:
    """Calculate the features of traces that lack them; quality, work and stability by objects and batch; anomalies."""
    from fast.tasks.traces.anomalies import update_anomalies
    from fast.tasks.traces.features import class_quality, update_features

    found = open_lake(lake)
    name = resolve_campaign(found, campaign) if campaign is not None else None
    update = update_features(found, name, say_progress)
    if identify is not None:
        _show_identification(found, identify, json)
        return
    rows = class_quality(found, name, "object_name" if objects else "object_class")
    flags = update_anomalies(found, name)
    data = {**update._asdict(), "quality": [_data(row) for row in rows], "anomalies": flags}
    show(data, f"{_text(update, rows)}\n\n{_anomalies_text(flags)}", json)


def _show_identification(lake: "Lake", grasp_id: str, as_json: bool) -> None:
    from fast.tasks.traces.identify import identify

    found = identify(lake, grasp_id)
    answers = [found.alone, found.together] if found.together.n_grasps > 1 else [found.alone]
    data = {**found._asdict(), **{name: getattr(found, name)._asdict() for name in ("alone", "together")}}
    accuracy = "" if found.accuracy is None else f" ({spell_share(found.accuracy)} right among themselves)"
    head = (
        f"{grasp_id}, recorded as {found.recorded}; learnt from {found.n_learnt} grasps of {found.n_tools} other tools"
        f"{accuracy}"
    )
    show(data, "\n\n".join([head, *(_likeliest_text(answer) for answer in answers)]), as_json)


def _likeliest_text(likeliest: "Likeliest") -> str:
    title = "from this grasp alone" if likeliest.n_grasps == 1 else f"from {likeliest.n_grasps} repeats together"
    rows = [
        {"": what, "probability": spell_share(probability), "it is": name}
        for what, found in likeliest._asdict().items()
        if what != "n_grasps"
        for name, probability in found
        if probability >= LEAST_SHOWN
    ]
    return f"{title}\n\n{table_text(rows)}"


def _anomalies_text(flags: list[dict[str, Any]]) -> str:
    if not flags:
        return "No grasp departs from its repeats and peers by more than chance."
    columns = ["tool_id", "object_name", "repeat", "kind", "p_value", "reason"]
    shown = table_text(flags[:N_FLAGS], columns)
    more = f"\n... and {len(flags) - N_FLAGS} more: `fast sql 'FROM anomalies'`" if len(flags) > N_FLAGS else ""
    return f"grasps that went wrong, surest first\n\n{shown}{more}"


def _data(row: "ClassQuality") -> dict[str, Any]:
    """Return a row with intervals as objects; bounds that a single tool does not have are null."""
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
                parts.append(f"{campaign}, {title}\n\n{table_text([_tabulate(row) for row in chosen])}")
    parts.append("Brackets: 95 % bootstrap intervals over tools.")
    return "\n\n".join(parts)


def _tabulate(row: "ClassQuality") -> dict[str, str]:
    line = {"objects": row.object_class, f"batch {row.first_batch}": _interval(row.first)}
    if row.last is not None and row.change is not None:
        line |= {f"batch {row.last_batch}": _interval(row.last), "change": _interval(row.change)}
    return line


def _interval(value: "Interval") -> str:
    if math.isnan(value.lower):
        return f"{value.mean:.3g}"
    return f"{value.mean:.3g} [{value.lower:.3g}, {value.upper:.3g}]"
