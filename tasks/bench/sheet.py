"""The batch sheet: an A4 leaf, front for the printer and the command line, back for the tool rack."""

from collections.abc import Sequence
from typing import Any

from fast.models.design.fin_ray import BASE_HEIGHT_MM
from fast.models.design.finger import FingerBodies, finger_bodies
from fast.models.design.printability import PrintingRules, broken_rules
from fast.models.design.profile import profile_path
from fast.models.design.recipe import STRANDS_PER_WALL, Recipe
from fast.models.design.reference import find_reference
from fast.models.design.tray import (
    FINGERS_PER_TOOL,
    MATERIALS,
    PrintItem,
    bed_of,
    name_trays,
    tray_layout,
)
from fast.models.units import spell_name
from fast.tasks.templates import render

_LABELS = {
    "length_mm": "length L",
    "width_mm": "width W",
    "height_mm": "height H",
    "tip_length_mm": "tip length",
    "front_thickness_mm": "front wall",
    "back_thickness_mm": "back wall",
    "rib_thickness_mm": "ribs",
    "rib_count": "rib count",
    "rib_angle_deg": "rib angle",
}


def batch_sheet_html(title: str, items: Sequence[PrintItem], notes: Sequence[str], recipe: Recipe | None = None) -> str:
    """Write one self-contained HTML page: what to print and how, how it lies on the plate, what to type and measure.

    Ten tools on one plate print on two sides of A4. `notes` are printed as commands. A tool that breaks a rule of its
    recipe says so on its card.

    Raises:
        UsageError: a finger is larger than the build plate.
    """
    bed_mm = bed_of(recipe)
    layout = tray_layout(items, bed_mm)
    cards = [_describe_tool(item, recipe) for item in items]
    return render(
        "tasks/bench/sheet.html.j2",
        name=title,
        notes=notes,
        recipe=recipe,
        cards=cards,
        mass_g=FINGERS_PER_TOOL * sum(card["mass_g"] for card in cards),
        plates=[
            {"name": name, "fingers": [place for place in layout if place.plate == plate]}
            for plate, name in enumerate(name_trays(layout))
        ],
        bed_mm=bed_mm,
        depth_mm=min(bed_mm[1], max(place.y_mm + place.height_mm for place in layout) + 12),
        profile_path=profile_path,
        base_mm=BASE_HEIGHT_MM,
        fingers_per_tool=FINGERS_PER_TOOL,
        lines_per_wall=STRANDS_PER_WALL,
        materials=list(MATERIALS),
    )


def _describe_tool(item: PrintItem, recipe: Recipe | None) -> dict[str, Any]:
    """Describe what the card of a tool shows."""
    values, bodies = item.design.model_dump(), finger_bodies(item.design)
    return {
        "label": item.label,
        "design": item.design,
        "reference": find_reference(item.design),
        "mass_g": _mass_g(bodies, recipe),
        "volume_cm3": bodies.volume_mm3 / 1e3,
        "broken": [] if recipe is None else broken_rules(item.design, recipe.limit(PrintingRules())),
        "parameters": {_LABELS.get(name, spell_name(name)): _value(name, value) for name, value in values.items()},
    }


def _mass_g(finger: FingerBodies, recipe: Recipe | None) -> float:
    """Compute the mass of a finger without support, at the densities of the recipe if there is one."""
    if recipe is None:
        return finger.mass_g
    bodies = (recipe.compliant, finger.compliant), (recipe.rigid, finger.rigid)
    return sum(told.density_g_per_cm3 * float(body.volume) / 1e3 for told, body in bodies)


def _value(name: str, value: float | str) -> str:
    if isinstance(value, str | int):
        return str(value)
    return f"{value:.1f}°" if name.endswith("_deg") else f"{value:.2f} mm" if name.endswith("_mm") else f"{value:.2f}"
