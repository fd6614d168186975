"""Sections of the report that show what was found."""

import logging

import numpy as np

from flows.report import queries
from flows.report.content import Content
from flows.report.facts import Tool, agreement, design_pairs, mean_quality_n, n_objects_won, object_pairs
from flows.report.figures import agreement_figure, quality_figure, work_figure
from flows.report.finger import finger_picture, profile_figure
from flows.report.folder import Folder
from flows.report.page import Markup, columns, number, paragraph, picture, section, table, text, tiles
from flows.report.render import object_picture
from flows.report.traces import Panel, common_limits, panel_figure, panels_of
from models.design_space import BEST_PUBLISHED, LOWER, PARAMETERS, UPPER
from models.errors import UsageError
from models.units import unit_of

_LOG = logging.getLogger(__name__)

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
N_EXTREMES = 6
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
        return Markup(paragraph(NOT_MEASURED, "lead") + tiles(numbers))
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


def traces_section(content: Content, folder: Folder) -> Markup:
    """Small multiples of force over lift."""
    best, rival = content.best, content.rival
    if best is None:
        return section("traces", "Force during the lift", paragraph(NOT_MEASURED))
    other_id = rival.tool_id if rival else best.tool_id
    measured = content.result("traces", queries.TRACES, best=best.tool_id, other=other_id, step=queries.TRACE_STEP_MM)
    shown = [measured]
    simulated = []
    if content.compared:
        setup = next(r["setup_id"] for r in content.pairs.rows if r["version_id"] == content.compared[-1])
        result = content.result(
            "simulated_traces",
            queries.SIMULATED_TRACES,
            design=best.design_id,
            version=content.compared[-1],
            setup=setup,
        )
        simulated = result.rows
        shown.append(result)
    panels = panels_of(measured.rows, simulated, best.tool_id, other_id)
    names = {row["object_id"]: row["object_name"] for row in content.work.rows}
    limits = common_limits(panels) if panels else None
    cells = [_panel(panel, names.get(panel.object_id), limits, folder) for panel in panels if limits]
    words = paragraph(
        f"Mean over repeats in steps of {queries.TRACE_STEP_MM:g} mm; all panels share their axes. Below zero the "
        "object is still pushed down; the highest point is the peak pull-off force; where the line returns to zero "
        "the object has left the grip.", "note",
    )  # fmt: skip
    return section(
        "traces", "Force during the lift, object by object", _trace_key(best, rival, bool(simulated)), words,
        f'<div class="panels">{"".join(cells)}</div>', folder.sources(*shown),
    )  # fmt: skip


def _trace_key(best: Tool, rival: Tool | None, has_simulated: bool) -> Markup:
    entries = [f"<span><i></i>{best.label}, the best tool</span>"]
    if rival:
        entries.append(f'<span><i class="first"></i>{rival.label}, the middle tool of the first batch</span>')
    if has_simulated:
        entries.append(f'<span><i class="sim"></i>{best.label} simulated</span>')
    return Markup(f'<div class="key">{"".join(entries)}</div>')


def _panel(
    panel: Panel, name: str | None, limits: tuple[tuple[float, float], tuple[float, float]], folder: Folder
) -> str:
    label = name or "object"
    figure = folder.figure(
        f"traces/object_{panel.object_id:02d}", panel_figure(panel, limits), f"Force over lift, {label}"
    )
    try:
        address = folder.image(f"objects/object_{panel.object_id:02d}", object_picture(panel.object_id))
        image = f'<img src="{address}" alt="">'
    except UsageError as error:
        _LOG.info("object %d is drawn without its picture: %s", panel.object_id, error)
        image = ""
    return f'<div class="panel"><h3>{image}<span>{text(label)} <i>{panel.object_id}</i></span></h3>{figure}</div>'


def work_section(content: Content, folder: Folder) -> Markup:
    """Grasp work per object, first batch against last."""
    if not content.first:
        return section("work", "Grasp work by object", paragraph(NOT_MEASURED))
    first, last = content.first[0].batch, content.last[0].batch
    shown = folder.figure("work_by_object", work_figure(content.work.rows, first, last), "Work per object")
    words = paragraph(
        "The area under force over lift, in joule, is the work that it takes to break a grasp: a grasp that holds long "
        "counts for more than one that is strong for a moment. Each dot is a tool, each bar the median of its batch; "
        "objects are sorted by the newest batch."
    )  # fmt: skip
    return section(
        "work", "Grasp work by object", columns(shown, words + _work_changes(content, first, last)),
        folder.sources(content.work),
    )  # fmt: skip


def _work_changes(content: Content, first: int, last: int) -> Markup:
    """On how many objects the median work rose, and the largest changes both ways."""
    medians = sorted(_work_medians(content, first, last), key=lambda row: row[1] - row[2])
    if first == last or not medians:
        return paragraph("Only one batch has been measured completely so far; the comparison begins with the next.")
    rose = sum(1 for _, before, after in medians if after > before)
    extremes = medians if len(medians) <= 2 * N_EXTREMES else [*medians[:N_EXTREMES], *medians[-N_EXTREMES:]]
    shown = [(name, number(b, 3), number(a, 3), f"{a - b:+.3f}".replace("-", "\u2212")) for name, b, a in extremes]
    which = "" if extremes is medians else f" The {N_EXTREMES} largest and the {N_EXTREMES} smallest changes:"
    return Markup(
        paragraph(f"From B{first:02d} to B{last:02d} the median work rose on {rose} of {len(medians)} objects.{which}")
        + table(("object", f"B{first:02d} (J)", f"B{last:02d} (J)", "change (J)"), shown, numeric=(1, 2, 3))
    )


def _work_medians(content: Content, first: int, last: int) -> list[tuple[str, float, float]]:
    """(object, median work in the first batch, in the last), for objects that both have measured."""
    found = []
    for object_id in sorted({row["object_id"] for row in content.work.rows}):
        rows = [r for r in content.work.rows if r["object_id"] == object_id and r["work_j"] is not None]
        values = [[r["work_j"] for r in rows if r["batch"] == batch] for batch in (first, last)]
        if all(values):
            name = f"{rows[0]['object_name'] or 'object'} ({object_id})"
            found.append((name, float(np.median(values[0])), float(np.median(values[1]))))
    return found


def agreement_section(content: Content, folder: Folder) -> Markup:
    """Simulated against measured, per design and per design and object."""
    title = "Simulated against measured"
    if not content.compared:
        return section(
            "agreement", title, paragraph("No measured design has been simulated with the same grasp setup yet.")
        )
    parts: list[str] = []
    rows = {row["version_id"]: row for row in content.versions.rows}
    for place, version_id in enumerate(content.compared):
        pairs = object_pairs(content.pairs.rows, version_id)
        designs = design_pairs(pairs)
        by_design, by_object = agreement(designs), agreement(pairs)
        suffix = "" if place == 0 else "_latest"
        when = "" if len(content.compared) == 1 else ("Oldest version: " if place == 0 else "Newest version: ")
        parts.append(paragraph(Markup(f"<b>{when}{text(_version_words(rows[version_id]))}</b>")))
        parts.append(
            columns(
                folder.figure(f"agreement_designs{suffix}", agreement_figure(designs, by_design, "mean over objects"),
                              "Simulated against measured, per design", "One mark per tool, mean over its objects."),
                folder.figure(f"agreement_grasps{suffix}", agreement_figure(pairs, by_object, "per object"),
                              "Simulated against measured, per tool and object", "One mark per tool and object."),
            )
        )  # fmt: skip
    words = paragraph(
        "On the dashed line simulation and bench agree. r is Pearson's correlation, rank is Spearman's; the mean error "
        "is simulated minus measured. A shifted or tilted cloud is absorbed by the surrogate (its scale rho and its "
        "discrepancy, Eq. 1); scatter around it is not."
    )  # fmt: skip
    return section("agreement", title, words, *parts, folder.sources(content.pairs, content.versions))


def _version_words(row: dict) -> str:
    effects = "no effects" if row["effects_json"] == "[]" else f"effects {row['effects_json']}"
    return (
        f"{row['version_id']} ({row['tier']}, E {row['young_modulus_mpa']:g} MPa, friction {row['friction']:g}, "
        f"Poisson ratio {row['poisson_ratio']:g}, {effects})"
    )
