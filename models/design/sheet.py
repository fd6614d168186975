"""The batch sheet: one A4 leaf, front for the printer and the command line, back for the tool rack."""

from collections.abc import Sequence
from html import escape

import numpy as np

from fast.models.design.finger import FingerBodies, finger_bodies
from fast.models.design.profile import BASE_HEIGHT_MM
from fast.models.design.tray import BED_MM, FINGERS_PER_TOOL, PlacedFinger, PrintItem, tray_layout
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
@media (max-width: 600px) { body { margin: 12px } .tools { grid-template-columns: 1fr } }
@media print {
  body { margin: 0; max-width: none; print-color-adjust: exact }
  .back { break-before: page; margin-top: 0 }
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


def batch_sheet_html(
    title: str, items: Sequence[PrintItem], notes: Sequence[str], bed_mm: tuple[float, float] = BED_MM
) -> str:
    """One self-contained HTML page: what to print, how it lies on the plate, what to type, what to measure.

    Ten tools print on two sides of A4. `notes` are printed as commands.

    Raises:
        UsageError: the batch does not fit on the plate.
    """
    layout = tray_layout(items, bed_mm)
    bodies = {item.label: finger_bodies(item.design) for item in items}
    mass_g = FINGERS_PER_TOOL * sum(body.mass_g for body in bodies.values())
    cards = "".join(_card(item, bodies[item.label]) for item in items)
    commands = "".join(f"<p><code>{escape(note)}</code></p>" for note in notes)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}: print sheet</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{_STYLE}</style></head><body>'
        f"<h1>Batch {escape(title)}</h1>"
        f'<p class="muted">{len(items)} tools, {FINGERS_PER_TOOL * len(items)} fingers, {mass_g:.0f} g of material. '
        "Body: flexible (Shore A 85). Base: rigid. Print both in one go.</p>"
        '<p>Operator <span class="blank wide"></span> Date <span class="blank"></span><span class="blank"></span> '
        'Material lot <span class="blank wide"></span></p>'
        f"<h2>1. Print tray.3mf</h2>{_plan(layout, bed_mm)}"
        "<h2>2. Clean, dry, measure, mount in the slot of the same number</h2>"
        "<p>Measure in the middle of a wall and write the values down on the back (on a screen: below).</p>"
        f"<h2>3. Tell FAST</h2>{commands}"
        "<p class=\"muted\">A pair that cannot be used: add <code>--reject 3='tip torn'</code>. "
        "Measured values: add <code>--measured 0:front=2.61,back=2.90,rib=2.80,hardness=85</code>.</p>"
        f'<h2 class="back">Tools of batch {escape(title)}</h2><div class="tools">{cards}</div>'
        "</body></html>"
    )


def profile_path(design: Design) -> str:
    """SVG path of the finger's profile, base included, z upwards, in mm."""
    profile = design.draw_section()
    rings = [np.array(ring.coords) for ring in (profile.exterior, *profile.interiors)]
    return "".join(_ring(ring, design.height_mm) for ring in rings)


def _ring(points: np.ndarray, height_mm: float) -> str:
    return "M" + "L".join(f"{x:.2f} {height_mm - z:.2f}" for x, z in points) + "Z"


def _silhouette(design: Design) -> str:
    """Drawing of one finger, standing on its base, at the same scale for every design."""
    base_y = design.height_mm - BASE_HEIGHT_MM
    return (
        f'<svg viewBox="-1 {design.height_mm - 121:.2f} 37 122" role="img" aria-label="profile">'
        f'<path d="{profile_path(design)}" fill="#0072B2" fill-rule="evenodd"/>'
        f'<rect x="0" y="{base_y:.2f}" width="{design.length_mm:.2f}" height="{BASE_HEIGHT_MM}" fill="#222"/></svg>'
    )


def _card(item: PrintItem, bodies: FingerBodies) -> str:
    values = item.design.model_dump()
    slot, kind = escape(item.label.rpartition("T")[2]), f"{FINGERS_PER_TOOL} fingers of {bodies.mass_g:.0f} g"
    labels = {name: _LABELS.get(name, spell_name(name)) for name in values}
    rows = "".join(f"<dt>{escape(labels[name])}</dt><dd>{_value(name, values[name])}</dd>" for name in values)
    blanks = "".join(f'<span>{name} <span class="blank"></span></span>' for name in ("front", "back", "rib", "Shore A"))
    return (
        f'<div class="tool">{_silhouette(item.design)}<div class="text"><h3>{escape(item.label)}</h3>'
        f'<span class="muted">slot {slot}, {kind}, {bodies.volume_mm3 / 1e3:.1f} cm&sup3;</span>'
        f'<dl>{rows}</dl><div class="fill">{blanks}</div>'
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


def _plan(layout: Sequence[PlacedFinger], bed_mm: tuple[float, float]) -> str:
    """The build plate from above, cut off behind the last row."""
    depth = min(bed_mm[1], max(place.y_mm + place.height_mm for place in layout) + 12)
    fingers = "".join(_on_plate(place, depth) for place in layout)
    return (
        f'<svg class="plan" viewBox="0 0 {bed_mm[0]:g} {depth:.1f}" role="img" aria-label="build plate">{fingers}</svg>'
        f'<p class="muted">Build plate {bed_mm[0]:g} x {bed_mm[1]:g} mm from above, its front edge at the bottom; '
        "fingers lie on their side, each base carries its label.</p>"
    )


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
