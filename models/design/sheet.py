"""The batch sheet: an A4 leaf, front for the printer and the command line, back for the tool rack."""

from collections.abc import Sequence
from html import escape

from fast.models.design.fin_ray import BASE_HEIGHT_MM
from fast.models.design.finger import FingerBodies, finger_bodies
from fast.models.design.printability import PrintingRules, broken_rules
from fast.models.design.profile import profile_path
from fast.models.design.recipe import LINES_PER_WALL, Recipe
from fast.models.design.reference import find_reference
from fast.models.design.tray import (
    FINGERS_PER_TOOL,
    MATERIALS,
    PlacedFinger,
    PrintItem,
    bed_of,
    name_trays,
    tray_layout,
)
from fast.models.records import Design
from fast.models.units import spell_name

_STYLE = """
@page { size: A4; margin: 12mm }
* { box-sizing: border-box }
body { font: 13px/1.4 system-ui, "Helvetica Neue", Arial, sans-serif; color: #111; margin: 24px auto; max-width: 186mm }
h1 { font-size: 24px; margin: 0 0 2px } h2 { font-size: 15px; margin: 18px 0 6px }
p { margin: 4px 0 }
code { font: 12px/1.5 ui-monospace, Menlo, Consolas, monospace; background: #f2f2f2; padding: 2px 5px }
.tools { display: grid; grid-template-columns: 1fr 1fr; gap: 8px; padding: 0 1px }
.tool { border: 1px solid #999; border-radius: 4px; padding: 8px 10px; display: flex; gap: 10px; break-inside: avoid }
.tool h3 { font-size: 20px; margin: 0 } .tool svg { flex: none; height: 132px; width: 40px }
.tool h3 small { font-size: 12px; font-weight: normal; color: #555 }
.tool .text { flex: 1; min-width: 0 } .muted { color: #555 }
dl { display: grid; grid-template-columns: auto auto auto auto; gap: 0 6px; margin: 4px 0; font-size: 11px }
dl { white-space: nowrap } dd:nth-of-type(odd) { padding-right: 6px }
dt { color: #555 } dd { margin: 0; text-align: right; font-variant-numeric: tabular-nums }
.fill { display: flex; gap: 4px 7px; flex-wrap: wrap; margin: 9px 0 0; font-size: 11px }
.fill .blank { min-width: 8mm } .fill .rest { flex: 1; min-width: 0 }
.blank { display: inline-block; border-bottom: 1px solid #555; min-width: 10mm; height: 1.2em; vertical-align: bottom }
.wide { min-width: 55mm }
.box { display: inline-block; width: 11px; height: 11px; border: 1.2px solid #111; vertical-align: -1px }
.plan { width: 100%; height: auto; border: 1px solid #999; border-radius: 4px }
.plans { display: grid; grid-template-columns: 1fr 1fr; gap: 8px }
.plans p { margin: 2px 0 0 }
.recipe { display: grid; grid-template-columns: auto 1fr auto 1fr; gap: 2px 8px; margin: 4px 0; white-space: normal }
.recipe { font-size: 12px } .recipe dd { text-align: left } .recipe dd:nth-of-type(odd) { padding-right: 12px }
.colour { display: inline-block; width: 10px; height: 10px; border: 1px solid #555; vertical-align: -1px }
.steps { margin: 4px 0; padding: 0; list-style: none; font-size: 12px; columns: 2 } .steps li { break-inside: avoid }
.warn { color: #8C2D04; font-size: 10.5px; margin: 0; white-space: nowrap }
@media (max-width: 600px) { body { margin: 12px } .tools { grid-template-columns: 1fr } }
@media print {
  body { margin: 0; max-width: none; print-color-adjust: exact }
  .back { break-before: page; margin-top: 0 } .tool { padding: 5px 10px } .fill { margin-top: 6px }
}
"""

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
    """One self-contained HTML page: what to print and how, how it lies on the plate, what to type, what to measure.

    Ten tools on one plate print on two sides of A4. `notes` are printed as commands. A tool that breaks a rule of its
    recipe says so on its card.

    Raises:
        UsageError: a finger is larger than the build plate.
    """
    bed_mm = bed_of(recipe)
    layout = tray_layout(items, bed_mm)
    trays = name_trays(layout)
    bodies = {item.label: finger_bodies(item.design) for item in items}
    mass_g = FINGERS_PER_TOOL * sum(_mass_g(body, recipe) for body in bodies.values())
    cards = "".join(_card(item, bodies[item.label], recipe) for item in items)
    commands = "".join(f"<p><code>{escape(note)}</code></p>" for note in notes)
    plates = f" on {len(trays)} build plates" if len(trays) > 1 else ""
    what = trays[0] if len(trays) == 1 else f"{trays[0]} to {trays[-1]}"
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}: print sheet</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{_STYLE}</style></head><body>'
        f"<h1>Batch {escape(title)}</h1>"
        f'<p class="muted">{len(items)} tools, {FINGERS_PER_TOOL * len(items)} fingers{plates}, {mass_g:.0f} g of '
        "material without support. Each body of the 3MF names its material.</p>"
        '<p>Operator <span class="blank wide"></span> Date <span class="blank"></span><span class="blank"></span> '
        'Material lot <span class="blank wide"></span></p>'
        f"{_recipe(recipe)}"
        f"<h2>1. Print {what}</h2>{_plans(layout, trays, bed_mm)}"
        f"<h2>2. Clean, dry, measure, mount in the slot of the same number</h2>{_steps(recipe)}"
        "<p>Measure in the middle of a wall and write the values down on the back (on a screen: below).</p>"
        f"<h2>3. Tell FAST</h2>{commands}"
        "<p class=\"muted\">A pair that cannot be used: add <code>--reject 3='tip torn'</code>. "
        "Measured values: add <code>--measured 0:front=2.61,back=2.90,rib=2.80,hardness=85</code>.</p>"
        f'<h2 class="back">Tools of batch {escape(title)}</h2><div class="tools">{cards}</div>'
        "</body></html>"
    )


def _mass_g(finger: FingerBodies, recipe: Recipe | None) -> float:
    """Mass of a finger without support, at the densities of the recipe if there is one."""
    if recipe is None:
        return finger.mass_g
    bodies = (recipe.compliant, finger.compliant), (recipe.rigid, finger.rigid)
    return sum(told.density_g_per_cm3 * float(body.volume) / 1e3 for told, body in bodies)


def _recipe(recipe: Recipe | None) -> str:
    """The recipe as a table of names and values; without one, how to give one."""
    if recipe is None:
        return (
            '<p class="muted">No recipe: printer, materials and support are up to you. A <code>[print]</code> section '
            "in the config prints them here and keeps them with each tool.</p>"
        )
    rows = {
        "process": recipe.process.upper() if recipe.process != "polyjet" else "PolyJet",
        "printer": recipe.printer,
        **{f"{key} body": _body(key, recipe) for key in MATERIALS},
        "layers": f"{recipe.layer_mm:g} mm" + (f", infill {recipe.infill_percent:g} %" if recipe.nozzle_mm else ""),
        "nozzle": ""
        if recipe.nozzle_mm is None
        else f"{recipe.nozzle_mm:g} mm, at least {LINES_PER_WALL} lines a wall",
        "finish": recipe.finish,
        "support": recipe.support,
        "thinnest wall": f"{recipe.wall_mm:g} mm",
        "narrowest gap": f"{recipe.support_gap_mm:g} mm" if recipe.support_gap_mm else "",
    }
    cells = "".join(
        f"<dt>{name}</dt><dd>{value if name.endswith('body') else escape(value)}</dd>"
        for name, value in rows.items()
        if value
    )
    return f'<h2>Recipe {escape(recipe.name)}</h2><dl class="recipe">{cells}</dl>'


def _body(key: str, recipe: Recipe) -> str:
    body = recipe.compliant if key == "compliant" else recipe.rigid
    return f'<span class="colour" style="background:{body.colour}"></span> {escape(body.material)}'


def _steps(recipe: Recipe | None) -> str:
    """What is done after the print, to be ticked off."""
    if recipe is None:
        return ""
    items = "".join(f'<li><span class="box"></span> {escape(step)}</li>' for step in recipe.post_processing)
    return f'<ul class="steps">{items}</ul>'


def _silhouette(design: Design) -> str:
    """Drawing of one finger, standing on its base, at the same scale for every design."""
    base_y = design.height_mm - BASE_HEIGHT_MM
    return (
        f'<svg viewBox="-1 {design.height_mm - 121:.2f} 37 122" role="img" aria-label="profile">'
        f'<path d="{profile_path(design)}" fill="#0072B2" fill-rule="evenodd"/>'
        f'<rect x="0" y="{base_y:.2f}" width="{design.length_mm:.2f}" height="{BASE_HEIGHT_MM}" fill="#222"/></svg>'
    )


def _card(item: PrintItem, bodies: FingerBodies, recipe: Recipe | None) -> str:
    values = item.design.model_dump()
    mass_g = _mass_g(bodies, recipe)
    slot, kind = escape(item.label.rpartition("T")[2]), f"{FINGERS_PER_TOOL} fingers of {mass_g:.0f} g"
    reference = find_reference(item.design)
    title = escape(item.label) if reference is None else f"{escape(item.label)} <small>reference finger</small>"
    broken = [] if recipe is None else broken_rules(item.design, recipe.limit(PrintingRules()))
    warning = f'<p class="warn">Check: {escape("; ".join(broken))}.</p>' if broken else ""
    labels = {name: _LABELS.get(name, spell_name(name)) for name in values}
    rows = "".join(f"<dt>{escape(labels[name])}</dt><dd>{_value(name, values[name])}</dd>" for name in values)
    blanks = "".join(f'<span>{name} <span class="blank"></span></span>' for name in ("front", "back", "rib", "Shore A"))
    return (
        f'<div class="tool">{_silhouette(item.design)}<div class="text"><h3>{title}</h3>'
        f'<span class="muted">slot {slot}, {kind}, {bodies.volume_mm3 / 1e3:.1f} cm&sup3;</span>'
        f'{warning}<dl>{rows}</dl><div class="fill">{blanks}</div>'
        '<div class="fill"><span><span class="box"></span> printed and mounted</span>'
        '<span><span class="box"></span> rejected:</span><span class="blank rest"></span></div></div></div>'
    )


def _value(name: str, value: float | str) -> str:
    if isinstance(value, str):
        return escape(value)
    if isinstance(value, int):
        return str(value)
    return (
        f"{value:.1f}&deg;" if name.endswith("_deg") else f"{value:.2f} mm" if name.endswith("_mm") else f"{value:.2f}"
    )


def _plans(layout: Sequence[PlacedFinger], trays: Sequence[str], bed_mm: tuple[float, float]) -> str:
    """The build plates from above."""
    size = f"{bed_mm[0]:g} x {bed_mm[1]:g} mm from above, its front edge at the bottom"
    words = f'<p class="muted">Build plate {size}; fingers lie on their side, each base carries its label.</p>'
    depth_mm = min(bed_mm[1], max(place.y_mm + place.height_mm for place in layout) + 12)
    if len(trays) == 1:
        return _plan(layout, bed_mm[0], depth_mm) + words
    plans = "".join(
        f"<div>{_plan([place for place in layout if place.plate == plate], bed_mm[0], depth_mm)}"
        f'<p class="muted">{name}</p></div>'
        for plate, name in enumerate(trays)
    )
    return f'<div class="plans">{plans}</div>{words}'


def _plan(layout: Sequence[PlacedFinger], width_mm: float, depth_mm: float) -> str:
    """A build plate from above, cut off behind the last row of all plates."""
    fingers = "".join(_on_plate(place, depth_mm) for place in layout)
    box = f"0 0 {width_mm:g} {depth_mm:.1f}"
    return f'<svg class="plan" viewBox="{box}" role="img" aria-label="build plate">{fingers}</svg>'


def _on_plate(place: PlacedFinger, depth: float) -> str:
    design = place.design
    top = depth - place.y_mm - place.height_mm
    base_y = design.height_mm - BASE_HEIGHT_MM
    return (
        f'<g transform="translate({place.x_mm:.2f} {top:.2f})">'
        f'<path d="{profile_path(design)}" fill="#9CC7E4" fill-rule="evenodd"/>'
        f'<rect y="{base_y:.2f}" width="{design.length_mm:.2f}" height="{BASE_HEIGHT_MM}" fill="#222"/>'
        # The label runs upwards in the free corner beside the slanted wall.
        f'<text transform="translate({place.length_mm - 1:.2f} 46) rotate(-90)" font-size="9.5" font-weight="bold">'
        f"{escape(place.label)}</text></g>"
    )
