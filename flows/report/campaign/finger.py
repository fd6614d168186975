"""The best finger: its printed body in 3-D, its profile with dimensions, and its parameters (Table 1)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from shapely.geometry import box
from shapely.plotting import plot_polygon

from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.facts import Tool
from fast.flows.report.folder import Folder
from fast.flows.report.mesh_picture import Body, render
from fast.flows.report.style import BEST, COMPLIANT, INK, MUTED, RIGID, new_axes
from fast.models.design.fin_ray import APEX_EXTRA_MM, BASE_HEIGHT_MM, FinRay
from fast.models.design.finger import finger_bodies
from fast.models.design.space import BEST_PUBLISHED, DesignSpace
from fast.models.records import Design
from fast.models.units import spell_list, spell_name, typeset
from fast.tasks.templates import number

PICTURE_PX = 1100
PROFILE_SIZE_IN = (2.9, 5.0)
AT_END = 0.01  # of the range, from its end: what counts as at the bound
NEARLY, N_APART = 0.05, 1  # of the range; how many parameters of nearly the same finger may differ by more
N_NEXT_BEST = 4
SYMBOLS = {
    "length_mm": ("L", ""),
    "width_mm": ("W", ""),
    "height_mm": ("H", ""),
    "tip_length_mm": ("L", "tip"),
    "front_thickness_mm": ("T", "f"),
    "back_thickness_mm": ("T", "b"),
    "rib_thickness_mm": ("T", "r"),
    "rib_count": ("N", ""),
    "rib_angle_deg": ("α", ""),
}


def prepare_best(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare the best finger: picture, profile, parameters next to the paper's; empty before the first measurement."""
    best = content.best
    if best is None:
        return {}
    design, space = content.design_of(best), content.space
    folder.save(content.designs)
    return {
        "finger": folder.image("finger", draw_finger(design, best.label)),
        "profile": folder.draw("profile", draw_profile(design)),
        "width_mm": design.width_mm,
        "is_fin_ray": space.family is FinRay,
        "parameters": _list_parameters(space, design),
        "words": [describe_bounds(space, design), describe_twins(space, design, _next_best(content, best))],
    }


def _list_parameters(space: DesignSpace, design: Design) -> list[dict[str, Any]]:
    """List the parameters, each with its place in the allowed range; of fin rays beside the paper's best."""
    rows = []
    published = BEST_PUBLISHED.model_dump() if space.family is FinRay else {}
    places = zip(space.names, *space.to_unit([design]), space.lower, space.upper, space.n_levels, strict=True)
    for name, at, low, high, n_levels in places:
        value, digits = getattr(design, name), 0 if n_levels else 2
        symbol, index = SYMBOLS.get(name, ("", ""))
        row = {"name": spell_name(name, with_unit=True), "symbol": symbol, "index": index, "low": low, "high": high,
               "at": at, "value": value if isinstance(value, str) else number(value, digits)}  # fmt: skip
        if published:
            row["published"] = number(published[name], digits)
            row["published_at"] = (published[name] - low) / (high - low) if high > low else 0.0
        rows.append(row)
    return rows


def _next_best(content: Content, best: Tool) -> list[tuple[str, Design]]:
    """Return the tools that come after the best one, with their designs."""
    others = [tool for tool in content.tools if tool.is_complete and tool is not best]
    ranked = sorted(others, key=lambda tool: -(tool.quality_n or 0.0))
    return [(tool.label, content.design_of(tool)) for tool in ranked[:N_NEXT_BEST]]


def describe_bounds(space: DesignSpace, design: Design) -> str:
    """Describe in words the parameters that stand at an end of what is allowed; empty where none does."""
    (place,) = space.to_unit([design])
    ends = [
        f"{spell_name(name)} at the {'lower' if at < 0.5 else 'upper'} one"
        for name, at in zip(space.names, place, strict=True)
        if min(at, 1.0 - at) <= AT_END
    ]
    if not ends:
        return ""
    stand = "stands" if len(ends) == 1 else "stand"
    return (
        f"{len(ends)} of {space.n_dims} parameters {stand} at an end of the allowed range: {', '.join(ends)}. "
        "Fingers beyond it, if they can be printed, may hold better."
    )


def describe_twins(space: DesignSpace, design: Design, others: Sequence[tuple[str, Design]]) -> str:
    """Describe in words which next best tools are nearly this finger, and what still differs; empty where none is."""
    twins, differ = [], set()
    for label, other in others:
        apart = np.abs(space.to_unit([other])[0] - space.to_unit([design])[0])
        far = [name for name, gap in zip(space.names, apart, strict=True) if gap > NEARLY]
        if len(far) <= N_APART:
            twins.append(label)
            differ.update(far)
    if not twins:
        return ""
    names = [f"the {spell_name(name)}" for name in space.names if name in differ]
    but = f" but for {' and '.join(names)}" if names else ""
    are = "is" if len(twins) == 1 else "are"
    return (
        f"{spell_list(twins)} {are} nearly the same finger{but}: the best tools are fewer different answers than they "
        "seem."
    )


def draw_finger(design: Design, mark: str) -> np.ndarray:
    """Draw a shaded RGBA picture of the two bodies of a finger, seen past its ribs and half from above."""
    bodies = finger_bodies(design, mark)
    return render(
        [Body(bodies.compliant, COMPLIANT), Body(bodies.rigid, RIGID)],
        azimuth_deg=-24.0,
        elevation_deg=20.0,
        height_px=PICTURE_PX,
    )


def draw_profile(design: Design) -> Figure:
    """Draw the planar profile in mm, front wall on the left, with the dimensions that make the design."""
    figure, axes = new_axes(*PROFILE_SIZE_IN, grid="")
    base = box(0, 0, design.length_mm, BASE_HEIGHT_MM)
    for polygon, colour in ((base, RIGID), (design.draw_section(), COMPLIANT)):
        plot_polygon(polygon, axes, add_points=False, facecolor=colour, edgecolor=INK, linewidth=0.8)
    _dimension(axes, (-7, 0), (-7, design.height_mm), f"H {design.height_mm:.1f}", rotation=90)
    _dimension(axes, (0, -5), (design.length_mm, -5), f"L {design.length_mm:.1f}", below=True)
    if isinstance(design, FinRay):
        _tip_dimension(axes, design)
        _wall_labels(axes, design)
    axes.set_xlim(-17, design.length_mm + 26)
    axes.set_ylim(-12, design.height_mm + 3)
    axes.set_aspect("equal")
    axes.axis("off")
    return figure


def _tip_dimension(axes: Axes, design: FinRay) -> None:
    height = design.height_mm
    right = design.front_thickness_mm + 9
    _dimension(axes, (right, height - design.tip_length_mm), (right, height), f"L$_{{tip}}$ {design.tip_length_mm:.1f}")
    for z in (height - design.tip_length_mm, height):
        axes.plot([design.front_thickness_mm + 1, right + 2], [z, z], color=MUTED, linewidth=0.6)


def _dimension(
    axes: Axes,
    start: tuple[float, float],
    end: tuple[float, float],
    text: str,
    rotation: float = 0,
    below: bool = False,
) -> None:
    """Draw a double arrow with its text: left of an upright one when rotated, below a level one, else right of it."""
    arrow = {"arrowstyle": "<|-|>", "color": MUTED, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 6}
    axes.annotate("", start, end, arrowprops=arrow)
    x, z = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    shift = (-1.5, 0) if rotation else (0, -1.5) if below else (1.5, 0)
    alignment = ("right", "center") if rotation else ("center", "top") if below else ("left", "center")
    axes.text(x + shift[0], z + shift[1], text, rotation=rotation, ha=alignment[0], va=alignment[1], fontsize=10)


def _wall_labels(axes: Axes, design: FinRay) -> None:
    """Draw leaders to the back wall, front wall and middle rib, with thickness (mm), number and angle."""
    cavity_mm = design.height_mm - design.tip_length_mm - BASE_HEIGHT_MM
    rib = (design.rib_count + 1) // 2
    rib_z = BASE_HEIGHT_MM + cavity_mm * rib / (design.rib_count + 1)
    low_z, wall_z = BASE_HEIGHT_MM + 0.12 * cavity_mm, BASE_HEIGHT_MM + 0.26 * cavity_mm
    inner = (design.front_thickness_mm + _back_x(design, rib_z) - design.back_thickness_mm) / 2
    right = design.length_mm + 4
    _leader(axes, (_back_x(design, low_z) - design.back_thickness_mm / 2, low_z), (right, low_z),
            f"T$_b$ {design.back_thickness_mm:.2f}")  # fmt: skip
    _leader(axes, (design.front_thickness_mm / 2, wall_z), (right, wall_z), f"T$_f$ {design.front_thickness_mm:.2f}")
    _leader(axes, (inner, rib_z), (right, max(rib_z, wall_z + 10)),
            f"T$_r$ {design.rib_thickness_mm:.2f}\nN {design.rib_count}\n"
            f"α {typeset(design.rib_angle_deg, '.1f')}°")  # fmt: skip


def _back_x(design: FinRay, z_mm: float) -> float:
    """Return the outer surface of the back wall at height z, in mm."""
    apex_x = design.front_thickness_mm + APEX_EXTRA_MM
    return design.length_mm + (apex_x - design.length_mm) * z_mm / design.height_mm


def _leader(axes: Axes, point: tuple[float, float], text_at: tuple[float, float], text: str) -> None:
    axes.plot([point[0], text_at[0] - 1], [point[1], text_at[1]], color=BEST, linewidth=0.8)
    axes.plot(*point, "o", color=BEST, markersize=3)
    axes.text(*text_at, text, ha="left", va="center", fontsize=10, linespacing=1.3)
