"""The section on objectives and limits: every measured tool, the front to choose from, and what each finger costs."""

import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder
from fast.flows.report.style import BEST, FAINT, FIRST, MUTED, WIDTH_IN, new_axes
from fast.models.ids import tool_label
from fast.models.scientist.objectives import KNOWN, LESS_IS_BETTER, OUTCOMES
from fast.models.units import spell_name
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.config import read_stored_config
from fast.tasks.campaign.settings import ScientistSettings
from fast.tasks.scientist.criteria import list_outcomes

_DIGITS = {"mean_work_j": 3, "mass_g": 1, "pressure_kpa": 0}
_NAME_SIZE = (0.09, 0.04)  # of a tool's name beside its point, as shares of the axes
_MOST_ROWS = 15  # of the table; the rest is in the CSV


def prepare_objectives(content: Content, folder: Folder) -> dict[str, Any] | None:
    """Prepare the objectives; None where tools were chosen for their mean peak force alone."""
    stored = tomllib.loads(content.campaign.config_toml)
    if not {"objectives", "at_least", "at_most"} & set(stored.get("scientist", {})):
        return None
    config = read_stored_config(content.campaign.config_toml, content.campaign.campaign_id)
    scientist = config.scientist
    if not scientist.has_criteria:
        return None
    campaign = Campaign(content.lake, config)
    state = campaign.state()
    rows = list_outcomes(campaign, state)
    if not rows:
        return {"sentence": ""}
    folder.numbers("objectives", rows)
    labels = {tool.tool_id: tool_label(tool.batch, tool.slot) for tool in state.tools}
    names = [name for name in rows[0] if name in OUTCOMES or name in KNOWN]
    front = [row for row in rows if row["on_front"]]
    is_drawn = len(scientist.objectives) == 2
    return {
        "sentence": _say(scientist, rows, front),
        "columns": {"tool": "tool"}
        | {spell_name(name, with_unit=True): [name, _DIGITS.get(name, 2)] for name in names}
        | {"keeps the limits": ["keeps"]},
        "front": [
            {**row, "tool": labels[row["tool_id"]], "keeps": "yes" if row["keeps_limits"] else "no"}
            for row in front[:_MOST_ROWS]
        ],
        "drawn": folder.draw("front", draw_front(rows, labels, scientist)) if is_drawn else None,
    }


def describe_outcome(name: str) -> str:
    """Describe what an objective or limit is, with its unit."""
    return OUTCOMES[name].about if name in OUTCOMES else KNOWN[name]


def _say(scientist: ScientistSettings, rows: Sequence[Mapping[str, Any]], front: Sequence[Mapping[str, Any]]) -> str:
    sides = {name: "low" if name in LESS_IS_BETTER else "high" for name in scientist.objectives}
    wanted = " and ".join(f"{side} {spell_name(name)}" for name, side in sides.items())
    limits = [f"{spell_name(name, with_unit=True)} at least {value:g}" for name, value in scientist.at_least.items()]
    limits += [f"{spell_name(name, with_unit=True)} at most {value:g}" for name, value in scientist.at_most.items()]
    n_good = sum(bool(row["keeps_limits"]) for row in rows)
    kept = f" {n_good} of {len(rows)} measured tools keep the limits ({', '.join(limits)})." if limits else ""
    return f"Tools are chosen for {wanted}.{kept} {len(front)} lie on the front."


def _name_points(axes: Axes, points: Sequence[tuple[str, float, float]]) -> None:
    """Name points, but leave out a name where it would lie on another one."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    taken: list[np.ndarray] = []
    for name, x, y in points:
        place = np.array([(x - left) / (right - left), (y - bottom) / (top - bottom)])
        if all((np.abs(place - other) > _NAME_SIZE).any() for other in taken):
            axes.annotate(name, (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7)
            taken.append(place)


def draw_front(rows: Sequence[Mapping[str, Any]], labels: Mapping[str, str], scientist: ScientistSettings) -> Figure:
    """Draw both objectives of every tool; those on the front are joined and named, those beyond a limit hollow."""
    first, second = scientist.objectives
    figure, axes = new_axes(WIDTH_IN, 4.0, grid="both")
    for keeps, face, label in ((False, "none", "breaks a limit"), (True, MUTED, "measured")):
        some = [row for row in rows if bool(row["keeps_limits"]) == keeps and not row["on_front"]]
        if some:
            x, y = zip(*((row[first], row[second]) for row in some), strict=True)
            axes.scatter(x, y, s=22, facecolors=face, edgecolors=FIRST if not keeps else FAINT, label=label)
    front = sorted((row for row in rows if row["on_front"]), key=lambda row: row[first])
    if front:
        x, y = zip(*((row[first], row[second]) for row in front), strict=True)
        axes.plot(x, y, "-D", color=BEST, markersize=5, linewidth=1.2, label="front")
    for name, draw in ((first, axes.axvline), (second, axes.axhline)):
        limit = scientist.at_least.get(name, scientist.at_most.get(name))
        if limit is not None:
            draw(limit, color=FIRST, linewidth=0.9, linestyle="--")
    axes.set_xlabel(describe_outcome(first))
    axes.set_ylabel(describe_outcome(second))
    axes.margins(0.1)
    _name_points(axes, [(labels[row["tool_id"]], row[first], row[second]) for row in front])
    figure.legend(loc="outside upper left", ncols=3)
    return figure
