"""The page of a gap search: where the simulator is wrong, what is missing, and how much of the gap that closes.

It is written from the answer (`Findings`) and, as far as it is there, from what the answer rests on. With it goes
`findings.json`, the same for machines.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fast.flows.report.folder import Folder, write_page
from fast.flows.report.gap.answer import (
    OLD,
    GapPage,
    describe_answer,
    describe_closed,
    describe_decision,
    describe_effect,
    describe_notes,
    describe_probability,
    describe_smallness,
    describe_sureness,
    shorten_answer,
    shorten_tool,
)
from fast.flows.report.gap.figures import (
    choose_cells,
    draw_classes,
    draw_errors,
    draw_law,
    draw_map,
    draw_names,
    draw_rest,
    draw_trace,
    name_cell,
)
from fast.flows.report.gap.question import write_next
from fast.flows.report.html import (
    Column,
    Markup,
    Page,
    columns,
    folded,
    number,
    paragraph,
    record_table,
    section,
    table,
    text,
    tiles,
)
from fast.models.gap.evaluation.evaluate import Evaluation
from fast.models.gap.findings import Decision, Findings, RoundFindings
from fast.models.gap.where.cells import find_heaviest_cells
from fast.models.gap.where.locate import describe_silence
from fast.models.gap.where.permutation_tests import Q
from fast.models.gap.where.residuals import PHASES
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_name

PAGE, FINDINGS = "report.html", "findings.json"
_MOST_UNSURE = 5

NAV = {
    "name": "What is missing",
    "where": "Where",
    "show": "Before and after",
    "theta": "Material and friction",
    "next": "What to measure next",
    "assumed": "What was assumed",
}
_KEY = Markup(
    '<div class="key"><span><i style="border-color:#1a1a1a;border-width:2px"></i>measured, each repeat</span>'
    '<span><i style="border-color:#d55e00;border-top-style:dashed"></i>simulated before</span>'
    "<span><i></i>simulated after, band: 90 %</span></div>"
)
_THETA = {"young_modulus_mpa": "Young's modulus (MPa)", "friction": "friction", "poisson_ratio": "Poisson ratio"}


def write_findings(findings: Findings, out: Path) -> Path:
    """Write `findings.json` into a folder; returns its path."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / FINDINGS
    path.write_text(findings.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return path


def write_gap_report(content: GapPage, out: Path, name: str, of: str = "") -> Path:
    """Write the page of a search, its figures and numbers, and `findings.json` into the folder `out`.

    name: of the search. of: what was searched, for the line above the title. Returns the path of the page.

    Raises:
        UsageError: the folder cannot be written.
    """
    folder = Folder(Path(out))
    write_findings(content.findings, folder.root)
    page = Page(
        title="What the simulator misses",
        kicker=of or f"FAST gap search {name}",
        footer=f"Gap search {name}. Units: mm, N, MPa. For machines: {FINDINGS}.",
        nav=NAV,
        file=PAGE,
    )
    sections = (write_name, write_where, write_show, write_theta, write_next, write_assumed)
    return write_page(folder, content, page, headline, sections)


def headline(content: GapPage) -> Markup:
    """The answer in a sentence and four numbers."""
    findings = content.findings
    gap = findings.gap
    shown = [(shorten_answer(findings), describe_sureness(findings))]
    if any(found.version for found in findings.rounds):
        shown += [
            (number(gap.rmse_before_n, 2, "N"), "error on held-out grasps before, material and friction recalibrated"),
            (number(gap.rmse_after_n, 2, "N"), f"after; noise floor {gap.rmse_floor_n:.2f} N"),
            describe_closed(gap),
        ]
    else:
        shown += [
            (number(gap.rmse_before_n, 2, "N"), "error on held-out grasps; nothing was added to the simulator"),
            (number(gap.rmse_floor_n, 2, "N"), "noise floor: repeats and meshes, without scatter of prints"),
        ]
    small = describe_smallness(gap)
    notes = "".join(paragraph(sentence, "note") for sentence in ([small] if small else []))
    warnings = "".join(paragraph(f"Warning: {sentence}", "note") for sentence in findings.warnings)
    return Markup(paragraph(describe_answer(findings), "lead") + tiles(shown) + notes + warnings)


def write_where(content: GapPage, folder: Folder) -> Markup:
    """Sentences, the map of the phase that they are about, and single cells."""
    rounds = content.findings.rounds
    parts = [_sentences(found, place, len(rounds), content.findings.power) for place, found in enumerate(rounds)]
    if content.where and content.residuals is not None:
        where = content.where[0]
        lead = where.findings[0].phase if where.findings else "peak"
        phases = [phase for phase in PHASES if phase == lead or phase in where.tests.phases]
        maps = {
            phase: folder.figure(
                f"gap_map_{phase}", draw_map(content.residuals, phase), f"Gap by tool, object: {phase}"
            )
            for phase in phases
        }
        note = paragraph(
            "Purple: the simulator promises too little; orange: too much. Tools and objects are sorted by their means, "
            "so that what belongs together lies together. A gap that is one colour per column is a print, not physics.",
            "note",
        )
        parts += [maps[lead], note]
        parts.append(columns(_heavy_cells(content), _unsure_cells(content)))
        if silence := describe_silence(where.tests):
            parts.append(paragraph(silence, "note"))
        others = "".join(picture for phase, picture in maps.items() if phase != lead)
        parts.append(folded("Maps of the other phases", f'<div class="two">{others}</div>'))
    return section("where", "Where they disagree", *parts)


def write_name(content: GapPage, folder: Folder) -> Markup:
    """The answer of every round with its law or what is left, what each candidate predicts, and what could be told."""
    rounds = content.findings.rounds
    parts: list[str] = []
    for place, found in enumerate(rounds):
        title = describe_decision(found.named)
        if len(rounds) > 1:
            title = f"Round {place + 1}: {title}"
        told = _answer(found, title, content.findings.is_leftover(place))
        bars = _bars(found, place, folder)
        pictures = _law_or_rest(found, place, folder)
        parts += [columns(told, pictures or bars)]
        if pictures:
            parts.append(folded("Evidence for each candidate", columns(bars, "")) if bars else "")
    parts.append(_rehearsed(content))
    parts.append(_visible_sizes(content))
    parts.append(_candidates(rounds, folder))
    return section("name", "What is missing", *parts)


def _answer(found: RoundFindings, title: str, is_leftover: bool) -> Markup:
    named = found.named
    # The sentence of an answer is its titles and parameters again; formulas and the table show them better.
    known = [CATALOGUE[effect] for effect in named.effects if effect in CATALOGUE and named.parameters]
    titles = [f"{text(spec.title)}: " if len(known) > 1 else "" for spec in known]
    told = [f"<p>{title}<code>{text(spec.formula)}</code></p>" for title, spec in zip(titles, known, strict=True)]
    told = told or [paragraph(named.sentence)]
    if found.rest_sentence not in ("", named.sentence):
        told.append(paragraph(found.rest_sentence))
    told.append(paragraph(f"Probability that this answer is right: {describe_probability(named.probability)}."))
    if named.family:
        told.append(paragraph(f"Family: {named.family}."))
    told.append(_parameters(named))
    told += [paragraph(note, "note") for note in describe_notes(found, is_leftover)]
    if found.dropped:
        told.append(paragraph(f"No longer needed: {', '.join(describe_effect(e) for e in found.dropped)}."))
    return Markup(f"<h3>{text(title)}</h3>{''.join(told)}")


def _law_or_rest(found: RoundFindings, place: int, folder: Folder) -> Markup:
    shown, named = "", found.named
    if named.law is not None:
        added = (
            " The new simulator has the law of the catalogue that fits best."
            if found.version and not found.refused
            else ""
        )
        which = f"If it is {describe_effect(named.effects[0])}: the" if named.kind == "set" else "The"
        caption = f"{which} law as the data have it, with its 90 % band.{added}"
        shown += folder.figure(f"gap_law_{place + 1}", draw_law(named.law), "The law that was found", caption)
    if named.rest is not None:
        caption = "The force that nothing in the simulator explains: mean and 90 % band over tools and objects."
        shown += folder.figure(f"gap_rest_{place + 1}", draw_rest(named.rest), "What is left", caption)
    return Markup(shown)


def _bars(found: RoundFindings, place: int, folder: Folder) -> Markup:
    if all(c.nats is None for c in found.candidates):
        return Markup("")
    figure = draw_names(found.candidates, found.named)
    shown = folder.figure(f"gap_names_{place + 1}", figure, "Evidence for each candidate")
    note = paragraph(
        "The bar says how much more probable a candidate makes what was measured, as a logarithm: 2.3 more is ten "
        "times as probable. The best were put into the simulator, and everything was fitted again. "
        "Several may do well; the probability beside the answer says how sure the choice is.", "note",
    )  # fmt: skip
    told = paragraph(
        "Whether anything is missing is told by the bank of all theta, before; these bars are of the bank around the "
        "fitted theta, for which no line is known.", "note",
    )  # fmt: skip
    return Markup(shown + (note if place == 0 else "") + (told if found.named.kind == "none" else ""))


def _rehearsed(content: GapPage) -> Markup:
    rows = [
        (
            one.family,
            f"{one.n_alarms} of {one.n}",
            "never" if one.seen_size is None else f"{100.0 * one.seen_size:.1f} %",
            f"{one.n_right} of {one.n_alarms}",
            f"{one.n_unknown} of {one.n_alarms}",
            "; ".join(one.taken_for) or "nothing",
        )
        for one in content.rehearsed
    ]
    if not rows:
        return Markup("")
    note = paragraph(
        "Before the answer, made-up worlds of these very tools, objects, repeats and noise were answered in the same "
        "way. Each hides one cause of this kind, at 1 to 20 % of the force. This is what became of them: whether "
        "anything was noticed, the smallest size that was, and whether it got its right name, none, or a wrong one.",
        "note",
    )
    heads = ("hidden", "noticed", "smallest noticed", "right name", "“unknown”", "taken for")
    return folded("What this panel can tell", note + f'<div class="words">{table(heads, rows)}</div>')


def _visible_sizes(content: GapPage) -> Markup:
    rows = [(describe_effect(one.effect), one.words) for one in content.visible]
    if not rows:
        return Markup("")
    note = paragraph(
        "The smallest size of each effect that would have been seen here, if nothing else were missing. Smaller ones "
        "may be there.", "note",
    )  # fmt: skip
    listed = table(("effect", "smallest size that would have been seen"), rows)
    return folded("How large an effect must be to be seen", note + f'<div class="words">{listed}</div>')


def write_show(content: GapPage, folder: Folder) -> Markup:
    """Errors beside the floor, held-out traces, classes of objects, and all metrics."""
    evaluation = content.evaluation
    if evaluation is None:
        return section("show", "Before and after", paragraph(OLD))
    errors = folder.figure("gap_errors", draw_errors(evaluation), "Held-out errors")
    note = paragraph(
        "Designs and objects that were put aside before the search. The floor is what repeats scatter, or what a finer "
        "mesh changes.", "note",
    )  # fmt: skip
    classes = folder.figure("gap_classes", draw_classes(evaluation), "Held-out error by class of object")
    panels = [_trace(evaluation, rows, place, folder) for place, rows in enumerate(choose_cells(evaluation))]
    pairs = [columns(*panels[i : i + 2]) for i in range(0, len(panels), 2)]
    return section(
        "show",
        "Before and after, on what was held out",
        columns(errors + note, classes),
        Markup("<h3>Held-out grasps</h3>"),
        _KEY,
        *pairs,
        _metrics(evaluation, folder),
    )


def write_assumed(content: GapPage, folder: Folder) -> Markup:
    """What the answer rests on, and what it cost."""
    findings = content.findings
    budget = [
        (name.replace("_", " "), number(value, 0 if value == round(value) else 1))
        for name, value in findings.budget.items()
    ]
    power = (findings.power,) if findings.power else ()
    general = (
        "Theta was calibrated again before anything was called a gap; rho is 1.",
        f"Findings of WHERE hold a false discovery rate of {100 * Q:.0f} % over phases and factors; the unit is the "
        "tool or the object, never the grasp.",
        "Names are those of the catalogue; what is not in it can only be called unknown.",
        f"Seed {findings.seed}.",
    )
    return section(
        "assumed",
        "What was assumed",
        _list((*general, *power, *content.assumed)),
        table(("cost", "value"), budget, (1,)),
    )


def write_theta(content: GapPage, folder: Folder) -> Markup:
    """Whether the constants moved towards what other instruments say."""
    is_known = any(row.independent is not None for row in content.theta)
    headings = ("constant", "before", "with what was named", "tensile bars of the paper", "")[: 5 if is_known else 3]
    rows = [
        (
            _THETA.get(r.parameter, r.parameter),
            _median(r.before),
            _median(r.after),
            None if r.independent is None else f"{r.independent[0]:.3g} \u00b1 {r.independent[1]:.2g}",
            _moved(r.before[0], r.after[0], r.independent),
        )[: len(headings)]
        for r in content.theta
    ]
    words_ = paragraph(
        "Median and 90 % interval. A missing effect bends these constants; with the right effect they move back to "
        "what other instruments say.", "note",
    )  # fmt: skip
    return section(
        "theta", "Material and friction before and after", table(headings, rows, empty=OLD), words_ if rows else ""
    )


def _sentences(found: RoundFindings, place: int, n_rounds: int, power: str) -> Markup:
    head = Markup(f"<h3>Round {place + 1}</h3>") if n_rounds > 1 else Markup("")
    if not found.where:
        sentence = "No single tool, object or phase stands out from noise, scatter of prints and meshes."
        if found.named.kind != "none":
            unsure = "There is a gap, but no single tool, object or phase is sure to carry more of it than others."
            explained = "What is named above explains the traces together." if found.named.effects else ""
            sentence = " ".join(filter(None, [unsure, power, explained]))
        return Markup(head + paragraph(sentence))
    first, *others = found.where
    return Markup(head + paragraph(first.sentence, "lead" if place == 0 else "") + _list([f.sentence for f in others]))


def _heavy_cells(content: GapPage) -> Markup:
    if content.residuals is None:
        return Markup("")
    cells = find_heaviest_cells(content.residuals)
    rows = [
        (shorten_tool(c.tool), c.object_name, f"{100 * c.share:.0f} %", number(c.gap_n, 2), number(c.peak_n, 1))
        for c in cells
    ]
    headings = ("tool", "object", "of all squares", "gap (N)", "peak (N)")
    return Markup("<h3>Where most of the gap is</h3>" + table(headings, rows, (2, 3, 4)))


def _unsure_cells(content: GapPage) -> Markup:
    head = Markup("<h3>Where the simulator itself is unsure</h3>")
    if not content.unsure:
        return Markup(
            head + paragraph("Nowhere does another mesh, contact or height change the force by a tenth of the peak.")
        )
    causes = {"mesh": "another mesh or contact", "height": "0.25 mm of height"}
    rows = [
        (shorten_tool(c.tool), c.object_name, causes[c.cause], f"{c.spread_n:.2f} of {c.peak_n:.1f} N")
        for c in content.unsure[:_MOST_UNSURE]
    ]
    more = len(content.unsure) - len(rows)
    note = paragraph(
        "Here the force changes by more than a tenth of the peak, mostly because a rim may snap or not. These grasps "
        "count little." + (f" {more} more cells are like this." if more else ""), "note",
    )  # fmt: skip
    return Markup(head + table(("tool", "object", "changed by", "by"), rows, (3,)) + note)


def _list(sentences: Sequence[str]) -> Markup:
    items = "".join(f"<li>{text(s)}</li>" for s in sentences)
    return Markup(f"<ul>{items}</ul>" if items else "")


def _parameters(named: Decision) -> Markup:
    rows = [
        (spell_name(name, with_unit=True), f"{p.median:.3g}", f"{p.ci90[0]:.3g} to {p.ci90[1]:.3g}")
        for name, p in named.parameters.items()
    ]
    which = f"parameter of {describe_effect(named.effects[0])}" if named.kind == "set" else "parameter"
    return table((which, "median", "90 % interval"), rows, (1,)) if rows else Markup("")


def _candidates(rounds: tuple[RoundFindings, ...], folder: Folder) -> Markup:
    rows = [
        {"round": i + 1, **c.model_dump(exclude={"parameters"})} for i, r in enumerate(rounds) for c in r.candidates
    ]
    return folder.numbers("gap_candidates", rows) if rows else Markup("")


def _trace(evaluation: Evaluation, rows: list[int], place: int, folder: Folder) -> Markup:
    held_out = evaluation.held_out
    row = rows[0]
    fresh = [
        word
        for word, is_new in (("design", held_out.is_new_tool[row]), ("object", held_out.is_new_object[row]))
        if is_new
    ]
    title = f"{name_cell(evaluation, row)} (new {' and '.join(fresh)})"
    return folder.figure(f"gap_trace_{place + 1}", draw_trace(evaluation, rows, title), title)


def _metrics(evaluation: Evaluation, folder: Folder) -> Markup:
    rows = [m.model_dump() for m in evaluation.metrics]
    columns_of: dict[str, Column] = {
        "model": "label",
        "of": "block",
        "RMSE (N)": ("rmse_n", 2),
        "peak bias (%)": lambda row: number(100 * row["peak_bias_share"], 1),
        "peak MAE (N)": ("peak_mae_n", 2),
        "rank, designs": ("rank_by_design", 2),
        "rank, per object": ("rank_by_object", 2),
        "work (J)": ("work_error_j", 3),
        "in 90 %": ("coverage_90", 2),
        "width (N)": ("width_90_n", 2),
    }
    note = paragraph(
        "Bias: measured less simulated. Rank: Spearman, of mean peaks over designs, and over designs within an object.",
        "note",
    )
    shown = folded("All figures of merit", record_table(rows, columns_of) + note)
    return Markup(shown + folder.numbers("gap_metrics", rows))


def _median(of: tuple[float, float, float]) -> str:
    median, low, high = of
    return f"{median:.3g} [{low:.3g}, {high:.3g}]" if high > low else f"{median:.3g}"


def _moved(before: float, after: float, independent: tuple[float, float] | None) -> str:
    """Whether a constant came nearer to its independent measurement."""
    if independent is None or np.isclose(before, after, rtol=0.01):
        return ""
    return "nearer" if abs(after - independent[0]) < abs(before - independent[0]) else "further away"
