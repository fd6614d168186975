"""The page of a gap search: where the simulator is wrong, what is missing, and how much of the gap that closes.

It is written from the answer (`Findings`) and, as far as it is there, from what the answer rests on. With it goes
`findings.json`, the same for machines.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fast.flows.report.folder import Folder, write_page
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
from fast.flows.report.gap.question import prepare_next
from fast.flows.report.gap.sentences import (
    GapPage,
    ThetaRow,
    describe_closed,
    describe_decision,
    describe_effect,
    describe_findings,
    describe_notes,
    describe_probability,
    describe_size,
    describe_smallness,
    describe_sureness,
    describe_thresholds,
    list_families,
    shorten_findings,
    shorten_tool,
)
from fast.models.gap.evaluation.evaluate import Evaluation
from fast.models.gap.findings import Findings, RoundFindings
from fast.models.gap.where.cells import find_heaviest_cells
from fast.models.gap.where.locate import describe_silence
from fast.models.gap.where.permutation_tests import Q
from fast.models.gap.where.residuals import PHASES
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_name, spell_number, spell_share
from fast.tasks.templates import number

PAGE, FINDINGS = "report.html", "findings.json"
_MOST_UNSURE = 5
_THETA = {"young_modulus_mpa": "Young's modulus (MPa)", "friction": "friction", "poisson_ratio": "Poisson ratio"}
_CAUSES = {"mesh": "another mesh or contact", "height": "0.25 mm of height"}


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
    told = {"name": name, "of": of}
    return write_page(
        folder, "flows/report/gap/page.html.j2", lambda folder: told | _prepare_page(content, folder), PAGE
    )


def _prepare_page(content: GapPage, folder: Folder) -> dict[str, Any]:
    findings, evaluation, panel = content.findings, content.evaluation, content.findings.panel
    return {
        "findings": findings,
        "describe_effect": describe_effect,
        "describe_probability": describe_probability,
        "answer": describe_findings(findings),
        "short_answer": shorten_findings(findings),
        "sureness": describe_sureness(findings),
        "closed": describe_closed(findings.gap),
        "smallness": describe_smallness(findings.gap),
        "rounds": [_prepare_round(findings, place, folder) for place in range(len(findings.rounds))],
        "rehearsed": list_families(panel.families) if panel is not None else [],
        "visible": [{"name": describe_effect(one.effect), "words": describe_size(one)} for one in panel.sizes]
        if panel is not None
        else [],
        "lines": describe_thresholds(panel.lines) if panel is not None else "",
        "has_candidates": _save_candidates(findings.rounds, folder),
        "where": _prepare_where(content, folder),
        "show": _prepare_show(evaluation, folder) if evaluation is not None else None,
        "theta": [_describe_constant(row) for row in content.theta],
        "assumed": _list_assumed(content),
        "budget": [
            {"name": cost.replace("_", " "), "value": number(value, 0 if value == round(value) else 1)}
            for cost, value in findings.budget.items()
        ],
        **prepare_next(content, folder),
    }


def _prepare_round(findings: Findings, place: int, folder: Folder) -> dict[str, Any]:
    """Prepare an answer with its law or what is left, and what each candidate predicts."""
    found, is_leftover = findings.rounds[place], findings.is_leftover(place)
    named, title, n = found.named, describe_decision(found.named), place + 1
    title = f"what is left is most like this: {title}" if is_leftover and named.effects else title
    is_weighed = any(candidate.nats is not None for candidate in found.candidates)
    return {
        "place": n,
        "found": found,
        "named": named,
        "is_leftover": is_leftover,
        "title": f"Round {n}: {title}" if len(findings.rounds) > 1 else title,
        # The sentence of an answer is its titles and parameters again; formulas and the table show them better.
        "known": [CATALOGUE[effect] for effect in named.effects if effect in CATALOGUE and named.parameters],
        "parameters": [
            {"name": spell_name(name, with_unit=True), "median": spell_number(p.median, 3),
             "interval": f"{spell_number(p.ci90[0], 3)} to {spell_number(p.ci90[1], 3)}"}
            for name, p in named.parameters.items()
        ],
        "notes": describe_notes(found, is_leftover),
        "dropped": [describe_effect(effect) for effect in found.dropped],
        "law": folder.draw(f"gap_law_{n}", draw_law(named.law)) if named.law is not None else None,
        "rest": folder.draw(f"gap_rest_{n}", draw_rest(named.rest)) if named.rest is not None else None,
        "bars": folder.draw(f"gap_names_{n}", draw_names(found.candidates, named)) if is_weighed else None,
    }  # fmt: skip


def _save_candidates(rounds: Sequence[RoundFindings], folder: Folder) -> bool:
    """Save the candidates of all rounds as CSV; False where there are none."""
    rows = [
        {"round": i + 1, **c.model_dump(exclude={"parameters"})} for i, r in enumerate(rounds) for c in r.candidates
    ]
    if rows:
        folder.numbers("gap_candidates", rows)
    return bool(rows)


def _prepare_where(content: GapPage, folder: Folder) -> dict[str, Any] | None:
    """Prepare maps of the phases and which of them the sentences are about; heavy and unsure cells."""
    residuals = content.residuals
    if not content.where or residuals is None:
        return None
    where = content.where[0]
    lead = where.findings[0].phase if where.findings else "peak"
    phases = [phase for phase in PHASES if phase == lead or phase in where.tests.phases]
    return {
        "lead": lead,
        "maps": {phase: folder.draw(f"gap_map_{phase}", draw_map(residuals, phase)) for phase in phases},
        "heavy": [
            vars(c) | {"tool": shorten_tool(c.tool), "share": spell_share(c.share)}
            for c in find_heaviest_cells(residuals)
        ],
        "unsure": [
            {"tool": shorten_tool(c.tool), "object_name": c.object_name, "cause": _CAUSES[c.cause],
             "spread": f"{c.spread_n:.2f} of {c.peak_n:.1f} N"}
            for c in content.unsure[:_MOST_UNSURE]
        ],
        "n_more_unsure": max(len(content.unsure) - _MOST_UNSURE, 0),
        "silence": describe_silence(where.tests),
    }  # fmt: skip


def _prepare_show(evaluation: Evaluation, folder: Folder) -> dict[str, Any]:
    """Prepare errors beside the floor, classes of objects, held-out traces by title, and all metrics."""
    traces, held_out = {}, evaluation.held_out
    for place, rows in enumerate(choose_cells(evaluation), 1):
        fresh = [("design", held_out.is_new_tool[rows[0]]), ("object", held_out.is_new_object[rows[0]])]
        new = " and ".join(word for word, is_new in fresh if is_new)
        title = f"{name_cell(evaluation, rows[0])} (new {new})"
        traces[title] = folder.draw(f"gap_trace_{place}", draw_trace(evaluation, rows, title))
    metrics = [metric.model_dump() for metric in evaluation.metrics]
    folder.numbers("gap_metrics", metrics)
    return {
        "errors": folder.draw("gap_errors", draw_errors(evaluation)),
        "classes": folder.draw("gap_classes", draw_classes(evaluation)),
        "traces": traces,
        "metrics": [row | {"peak_bias": number(100 * row["peak_bias_share"], 1)} for row in metrics],
    }


def _list_assumed(content: GapPage) -> list[str]:
    """List what the answer rests on."""
    findings = content.findings
    return [
        "Material and friction were fitted again before anything was called a gap; simulated forces are not scaled.",
        f"Of the places named under Where, {spell_share(Q)} may be there by chance; the unit is the tool or the "
        "object, never the grasp.",
        "Names are those of the catalogue; what is not in it can only be called unknown.",
        f"Random numbers: seed {findings.seed}.",
        *([findings.power] if findings.power else []),
        *content.assumed,
    ]


def _describe_constant(row: ThetaRow) -> dict[str, Any]:
    """Tell a constant before and after, and whether it moved towards what another instrument says."""
    known = row.independent
    return {
        "name": _THETA.get(row.parameter, row.parameter),
        "before": _median(row.before),
        "after": _median(row.after),
        "independent": known,
        "bars": None if known is None else f"{spell_number(known[0], 3)} \u00b1 {spell_number(known[1])}",
        "moved": _moved(row.before[0], row.after[0], known),
    }


def _median(of: tuple[float, float, float]) -> str:
    median, low, high = of
    told = spell_number(median, 3)
    return f"{told} [{spell_number(low, 3)}, {spell_number(high, 3)}]" if high > low else told


def _moved(before: float, after: float, independent: tuple[float, float] | None) -> str:
    """Tell whether a constant came nearer to its independent measurement."""
    if independent is None or np.isclose(before, after, rtol=0.01):
        return ""
    return "nearer" if abs(after - independent[0]) < abs(before - independent[0]) else "further away"
