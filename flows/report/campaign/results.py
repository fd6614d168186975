"""Sections of the report that show what was found."""

import numpy as np

from flows.report.campaign.content import Content
from flows.report.campaign.facts import Tool, mean_quality_n, n_objects_won
from flows.report.campaign.figures import quality_figure
from flows.report.campaign.finger import finger_picture, profile_figure
from flows.report.folder import Folder
from flows.report.html import Markup, columns, number, paragraph, picture, section, table, text, tiles
from models.design.space import BEST_PUBLISHED, LOWER, PARAMETERS, UPPER
from models.units import unit_of

SYMBOLS = {
    "length_mm": "L",
    "width_mm": "W",
    "height_mm": "H",
    "tip_length_mm": "L<sub>tip</sub>",
    "front_thickness_mm": "T<sub>f</sub>",
    "back_thickness_mm": "T<sub>b</sub>",
    "rib_thickness_mm": "T<sub>r</sub>",
    "rib_count": "N",
    "rib_angle_deg": "α",
}
NOT_MEASURED = (
    "No tool of this campaign has been measured on any object yet; this part fills itself with the first batch."
)


def headline(content: Content) -> Markup:
    """The result in two sentences, and the key numbers."""
    grasps = sum(t.n_grasps for t in content.tools)
    n_failed = sum(t.n_failed for t in content.tools)
    n_simulated = sum(row["n_ok"] for row in content.cost.rows)
    numbers = [
        (number(grasps, 0), f"measured grasps that count, {n_failed} more failed"),
        (number(n_simulated, 0), f"simulated grasps with {len(content.cost.rows)} simulator version(s)"),
    ]
    best = content.best
    if best is None:
        return Markup(
            paragraph("No tool of this campaign has been measured on any object yet.", "lead") + tiles(numbers)
        )
    reference = mean_quality_n(content.first)
    gain = (best.quality_n or 0.0) / reference - 1
    numbers = [
        (
            Markup(f"{number(best.quality_n, 1)} <small>{_plus_minus(best)}</small>"),
            f"tool quality of {best.label}, mean over {best.n_objects} objects",
        ),
        (number(reference, 1, "N"), f"mean of the first batch, {len(content.first)} tools"),
        (f"{100 * gain:+.0f} %".replace("-", "\u2212"), "best tool against that mean"),
        *numbers,
    ]
    return Markup(paragraph(_verdict(content, best, reference, gain), "lead") + _caution(content) + tiles(numbers))


def quality_text(tool: Tool) -> str:
    """Tool quality with the half width of its interval, where repeats gave one."""
    if tool.half_width_n is None:
        return number(tool.quality_n, 2, "N")
    return f"{number(tool.quality_n, 2)} ± {number(tool.half_width_n, 2, 'N')}"


def _plus_minus(tool: Tool) -> str:
    return "N" if tool.half_width_n is None else f"± {number(tool.half_width_n, 1, 'N')}"


def _verdict(content: Content, best: Tool, reference: float, gain: float) -> str:
    opening = f"{best.label} holds best: it takes {quality_text(best)} on average to pull an object out of its grip"
    if best in content.first:
        return f"{opening}. It is one of the first batch, whose mean is {number(reference, 1, 'N')}; none beats it."
    top = max(content.first, key=lambda t: t.quality_n or 0.0)
    won, of = n_objects_won(content.work.rows, best, content.first)
    over = 100 * ((best.quality_n or 0.0) / (top.quality_n or np.nan) - 1)
    return (
        f"{opening}, {100 * gain:.0f} % more than the mean of the first batch ({number(reference, 1, 'N')}) and "
        f"{over:.0f} % more than its best tool ({top.label}, {number(top.quality_n, 1, 'N')}). "
        f"It beats that batch's mean on {won} of {of} objects."
    )


def _caution(content: Content) -> Markup:
    benches = sorted({row["bench"] for row in content.provenance.rows if row["bench"]})
    partial = [t.label for t in content.tools if t.quality_n is not None and not t.is_complete]
    notes = [
        "± is a 95 % interval from the scatter between repeats; it does not cover another print of the same design."
    ]
    if "virtual" in benches:
        notes.insert(0, "Measured on the virtual bench: these forces come from a simulated world, not from a machine.")
    if partial:
        notes.append(f"Not ranked, because not measured on every object: {', '.join(partial)}.")
    return paragraph(" ".join(notes), "note")


def best_section(content: Content, folder: Folder) -> Markup:
    """The best finger: picture, profile, parameters next to the paper's."""
    best = content.best
    if best is None:
        return section("best", "The best finger", paragraph(NOT_MEASURED))
    design = content.design_of(best)
    address = folder.image("finger", finger_picture(design, best.label))
    seen = picture(address, f"Finger {best.label} in three dimensions",
                   "As printed: compliant body (blue) on its rigid base (grey), front wall on the left.")  # fmt: skip
    profile = folder.figure("profile", profile_figure(design), f"Profile of finger {best.label} with dimensions",
                            f"Profile in mm; extruded to W {design.width_mm:.1f} mm.")  # fmt: skip
    rows = []
    for name, low, high in zip(PARAMETERS, LOWER, UPPER, strict=True):
        mine, published = design.model_dump()[name], BEST_PUBLISHED.model_dump()[name]
        digits = 0 if name == "rib_count" else 2
        rows.append(
            (Markup(f"{text(_words(name))} <i>{SYMBOLS[name]}</i>"), number(mine, digits), number(published, digits),
             _range_mark(mine, published, low, high))
        )  # fmt: skip
    parameters = table(("parameter", best.label, "paper", "allowed range"), rows, numeric=(1, 2))
    note = paragraph(
        "Blue dot: this design; ring: the paper's best tool (Table 1, B07T8, 29.68 N on the authors' bench, whose "
        "stroke and objects are not all published, so forces compare only within this campaign).", "note",
    )  # fmt: skip
    right = f'<div class="params">{parameters}</div>{note}'
    return section(
        "best", f"The best finger, {best.label}", columns(seen, profile, right, css="finger"),
        folder.sources(content.designs),
    )  # fmt: skip


def _words(name: str) -> str:
    unit = unit_of(name)
    words = name.rsplit("_", 1)[0] if unit else name
    return words.replace("_", " ") + (f" ({unit})" if unit else "")


def _range_mark(mine: float, published: float, low: float, high: float) -> Markup:
    places = [100 * (value - low) / (high - low) for value in (published, mine)]
    dots = f'<i class="paper" style="left:{places[0]:.1f}%"></i><i style="left:{places[1]:.1f}%"></i>'
    return Markup(f'{low:g} <span class="range">{dots}</span> {high:g}')


def progress_section(content: Content, folder: Folder) -> Markup:
    """Tool quality per batch."""
    if content.best is None:
        return section("progress", "Tool quality by batch", paragraph(NOT_MEASURED))
    shown = folder.figure("quality_by_batch", quality_figure(content.tools, content.best), "Tool quality by batch")
    words = paragraph(
        "Every mark is a printed tool: the mean over objects of its peak pull-off force, with the interval from "
        "repeats (often smaller than the mark). Circles are random designs, diamonds were chosen by the scientist, "
        "hollow marks are tools not measured on every object. Grey: median of the batch and, from five tools on, its "
        "middle half."
    )  # fmt: skip
    rows = []
    for batch in sorted({t.batch for t in content.tools if t.is_complete}):
        values = np.array([t.quality_n for t in content.tools if t.batch == batch and t.is_complete], dtype=float)
        spread = float(values.std(ddof=1)) if values.size > 1 else None
        rows.append(
            (f"B{batch:02d}", values.size, number(values.mean(), 2), number(spread, 2), number(values.max(), 2))
        )
    summary = table(("batch", "tools", "mean (N)", "SD (N)", "best (N)"), rows, numeric=(1, 2, 3, 4))
    return section(
        "progress", "Tool quality by batch", columns(shown, words + summary), folder.sources(content.quality)
    )
