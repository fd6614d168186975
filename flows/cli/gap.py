"""`fast gap`: where the simulator is wrong, what is missing, and what adding it changes."""

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.campaign import open_lake, resolve_campaign
from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, make_app, show, table_text
from fast.flows.cli.live import open_reporter
from fast.models.errors import UsageError
from fast.models.gap.evidence import REHEARSED
from fast.models.units import spell_share

if TYPE_CHECKING:
    from fast.flows.gap.search import GapOutcome, GapRequest
    from fast.lake.store import Lake
    from fast.models.gap.evidence.visible import VisibleSize
    from fast.models.gap.findings import Findings

app = make_app(name="gap", help="Find where simulation and measurement disagree, name what is missing, add it.")
_AT_LEAST_ONE = Number(gte=1)
_MOST_CANDIDATES = 6
_EVIDENCE = (
    "evidence: natural logarithm of how much more probable the grasps are with it than without (3: 20 to 1), once an "
    "effect is fitted in full."
)
_VISIBLE = (
    "visible: how much of what an effect changes is left when material and friction are fitted again; the rest looks "
    "like other material."
)
_SIZES = (
    "Nine in ten are seen from these shares of the force on: of a family, of what material and friction cannot make up "
    "for; of an effect, of all that it changes."
)
_COSTS = (
    "cost P: post-processing of a trace; C: other closings or frictions of the simulator without it; "
    "F: finite elements of its own"
)


@app.default
def gap(
    *,
    lake: LakePath = DEFAULT_LAKE,
    campaign: Annotated[
        str | None, Parameter(help="Campaign whose measurements count; default: all of the lake.")
    ] = None,
    example: Annotated[
        bool,
        Parameter(negative="", help="Search a small lake that comes with FAST, in --out or a temporary folder."),
    ] = False,
    catalogue: Annotated[bool, Parameter(negative="", help="Only print the catalogue of effects.")] = False,
    out: Annotated[
        Path | None,
        Parameter(help="Folder for report.html and findings.json; default: of the search, in the lake's outputs."),
    ] = None,
    rounds: Annotated[int, Parameter(help="Effects to look for, one after the other.", validator=_AT_LEAST_ONE)] = 4,
    seed: Annotated[int, Parameter(help="Seed of what is held out, and of the chains.")] = 0,
    budget_minutes: Annotated[
        float | None,
        Parameter(help="Minutes to simulate in; what is left is simulated by the next call.", validator=Number(gt=0)),
    ] = None,
    workers: Annotated[int, Parameter(help="Worker processes; changes no result.", validator=_AT_LEAST_ONE)] = 2,
    tools: Annotated[
        int | None, Parameter(help="Search with at most so many designs, spread over those measured; default: all.")
    ] = None,
    objects: Annotated[
        int | None, Parameter(help="Search with at most so many objects, spread over their classes; default: all.")
    ] = None,
    rehearse: Annotated[
        int, Parameter(help="Made-up worlds that say what could still hide.", validator=Number(gte=8, lte=10_000))
    ] = REHEARSED,
    simulated: Annotated[
        Path | None,
        Parameter(
            help="CSV of your own simulator's forces (tool_id, object_id, lift_mm, force_n): what that one lacks."
        ),
    ] = None,
    dry_run: Annotated[bool, Parameter(negative="", help="Only say what would be simulated and how long.")] = False,
    json: AsJson = False,
) -> None:
    """Find where simulation and measurement disagree, name the missing effect, add it, and show the gap shrink.

    Designs and objects are held out first. What the lake lacks of the bank of simulations around the measured tools is
    simulated, which may take hours: `--dry-run` says how long, `--tools` and `--objects` take fewer of the measured
    ones. A killed command continues when it is given again. `--example` has its simulations with it: a minute or two.
    A panel too small to hold any out, and forces of your own simulator, are weighed with all grasps, and added nowhere.
    """
    if catalogue:
        _show_catalogue(json)
        return
    from fast.flows.gap.example import CAMPAIGN, open_example
    from fast.flows.gap.search import GapRequest
    from fast.flows.gap.weigh import is_small
    from fast.tasks.gap.panel import PanelSize

    found, folder = open_example(out) if example else (open_lake(lake), out)
    campaign = campaign or (CAMPAIGN if example else None)
    name = resolve_campaign(found, campaign) if campaign is not None else None
    panel = PanelSize(tools, objects)
    order = GapRequest(name, seed, rounds, budget_minutes, panel, rehearsed=rehearse).with_workers(workers)
    if simulated is None and not is_small(found, order):
        _search(found, order, folder, dry_run, json)
        return
    _weigh(found, order, simulated, out, dry_run, json)


def _show_catalogue(as_json: bool) -> None:
    from fast.models.simulation.effects.catalogue import catalogue_entries, catalogue_rows

    show(catalogue_entries(), f"{table_text(catalogue_rows())}\n\n{_COSTS}", as_json)


def _search(lake: "Lake", request: "GapRequest", folder: Path | None, is_dry: bool, as_json: bool) -> None:
    """Search and write the page into a folder, or only say what that costs."""
    from fast.flows.gap.folder import write_folder
    from fast.flows.gap.search import describe_search_cost, run_gap

    with open_reporter() as reporter:
        told = describe_search_cost(lake, request, reporter) if is_dry else run_gap(lake, request, reporter)
    if isinstance(told, str):
        show({"cost": told}, told, as_json)
        return
    page = write_folder(lake, told, folder)
    show(_data(told) | {"report": str(page)}, _text(told, page), as_json)


def _weigh(
    lake: "Lake", request: "GapRequest", simulated: Path | None, out: Path | None, is_dry: bool, as_json: bool
) -> None:
    """Weigh a panel with all its grasps, or only say what that costs.

    Raises:
        UsageError: a folder was given, for which there is no page.
    """
    if out is not None:
        raise UsageError(
            f"{'--simulated' if simulated is not None else 'so small a panel'} gets no page, its answer is printed; "
            "leave out --out (`--json > FILE` keeps the answer)."
        )
    from fast.flows.gap.weigh import describe_cost, weigh_panel
    from fast.flows.report.gap.sentences import describe_thresholds

    with open_reporter() as reporter:
        told = (describe_cost if is_dry else weigh_panel)(lake, request, reporter, simulated)
    if isinstance(told, str):
        show({"cost": told}, told, as_json)
        return
    rows, warnings = told.list_rows(), told.warnings
    evidence = f"{_EVIDENCE} {describe_thresholds(asdict(told.naming.decider.rehearsal.thresholds))}"
    text = [told.sentence, "", table_text(rows), "", evidence, *(f"warning: {one}" for one in warnings)]
    show({"summary": told.sentence, "weighed": rows, "warnings": warnings}, "\n".join(text), as_json)


@app.command(name="plan")
def plan_(
    config: Annotated[Path, Parameter(help="TOML file of the campaign, e.g. campaigns/quick.toml.")],
    *,
    lake: LakePath = DEFAULT_LAKE,
    tools: Annotated[
        int | None,
        Parameter(help="How many of the campaign's first tools; default: 8, or all.", validator=_AT_LEAST_ONE),
    ] = None,
    objects: Annotated[
        int | None,
        Parameter(help="On how many objects, of different classes; default: 6, or all.", validator=_AT_LEAST_ONE),
    ] = None,
    rehearse: Annotated[int, Parameter(help="Made-up worlds.", validator=Number(gte=8, lte=10_000))] = REHEARSED,
    workers: Annotated[int, Parameter(help="Worker processes; changes no result.", validator=_AT_LEAST_ONE)] = 2,
    json: AsJson = False,
) -> None:
    """Say what a search of a campaign's first tools will be able to tell, before a finger is printed.

    The bank around these tools is simulated into the lake, where the search will find it. Then made-up worlds of the
    panel are answered as the real one will be: from what size on causes are seen, by which name, and what they are
    taken for. One tool, and one object, less are compared with it, and a measurement by a person, such as of walls or a
    tensile bar.
    """
    from fast.flows.gap.plan import choose_size, look_ahead
    from fast.flows.report.gap.sentences import list_families
    from fast.tasks.campaign.config import load_config

    choose_size(load_config(config), tools, objects)  # what is wrong is named before a lake is made
    found = open_lake(lake, create=True)
    with open_reporter() as reporter:
        outlook = look_ahead(found, config, tools, objects, rehearse, workers, reporter)
    families = [
        {name.replace("_", " "): words for name, words in row.items()}
        for row in list_families(outlook.rehearsal.describe_families())
    ]
    sizes = [
        {
            "effect": one.planned.effect,
            "seen from": one.planned.words,
            "of the force": _spell_size(one.planned),
            "an object less": _spell_size(one.fewer_objects),
            "a tool less": _spell_size(one.fewer_tools),
            "if measured": "-" if one.if_measured is None else _spell_size(one.if_measured),
        }
        for one in outlook.sizes
    ]
    lines = [outlook.sentence, "", table_text(families), "", table_text(sizes), "", _SIZES]
    show({"summary": outlook.sentence, "families": families, "sizes": sizes}, "\n".join(lines), json)


def _spell_size(size: "VisibleSize") -> str:
    return "never" if size.share is None else spell_share(size.share, 1)


@app.command(name="next")
def next_(
    *,
    lake: LakePath = DEFAULT_LAKE,
    search: Annotated[str | None, Parameter(help="Search that asks; default: all that do.")] = None,
    out: Annotated[
        Path | None, Parameter(help="Folder for the plan: grasps.csv, designs.csv and sheet.html to print.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Write down the grasps that a search asks for, to be made on a bench without the gantry.

    Add the samples to the folder and give it back with `fast lake import`; `fast gap` then goes on with the answer.
    """
    from fast.flows.gap.bench_plan import explain_silence, plan_next, write_bench_plan

    found = open_lake(lake)
    plan = plan_next(found, search)
    if not plan.requests:
        show({"grasps": []}, explain_silence(found, search), json)
        return
    rows = [
        {
            "tool": request.tool_id,
            "on": request.object_id,
            "repeat": request.repeat,
            "lift mm/s": request.setup.lift_speed_mm_per_s,
            "wait s": request.setup.dwell_s,
            "gap mm": request.setup.closed_gap_mm,
            "tips mm": request.setup.tip_below_mm,
            "air psi": request.setup.supply_pressure_psi,
            "object": ", ".join(f"{name} {value:g}" for name, value in request.placement if value),
        }
        for request in plan.requests
    ]
    lines = [f"{plan.sentence}.", "", table_text(rows)]
    sheet = None
    if out is not None:
        sheet = write_bench_plan(found, plan, out)
        lines += [
            "",
            f"sheet: {sheet}",
            f"then: {shlex.join(['fast', 'lake', 'import', str(out), '--lake', found.address])}",
        ]
    asked = [request.model_dump(mode="json") for request in plan.requests]
    show({"grasps": asked, "minutes": plan.minutes, "sheet": sheet}, "\n".join(lines), json)


@app.command
def answer(
    kind: Annotated[str, Parameter(help="What was measured, as questions call it: walls, dead_weight ...")],
    value: Annotated[float | None, Parameter(help="The number.", allow_leading_hyphen=True)] = None,
    *,
    operator: Annotated[str, Parameter(help="Who measured it.")],
    sure: Annotated[bool, Parameter(negative="", help="A strange number is so; it is marked in the lake.")] = False,
    undo: Annotated[bool, Parameter(negative="", help="Take the answer back; the question is open again.")] = False,
    campaign: Annotated[str | None, Parameter(help="Campaign that was searched; default: all of the lake.")] = None,
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Keep what a person measured, asked for by a search or not; the next search takes it."""
    from fast.models.gap.ask.answers import Reading
    from fast.models.validation import load_record
    from fast.tasks.gap.findings import find_newest_run
    from fast.tasks.gap.readings import name_unasked, take_back_reading, write_reading

    if undo == (value is not None):
        raise UsageError("give a number, or --undo and no number; nothing was changed.")
    found = open_lake(lake)
    campaign_id = resolve_campaign(found, campaign) if campaign is not None else None
    run = find_newest_run(found, campaign_id)
    asked = run.findings.next_experiment.person if run is not None and run.findings.next_experiment else None
    is_asked = asked is not None and asked.kind == kind
    if not is_asked:
        _check_unasked(found, kind)
    search_id = run.gap_id if run is not None and is_asked else name_unasked(campaign_id)
    data = {"search": search_id, "kind": kind, "value": value}
    if value is None:
        take_back_reading(found, campaign_id, search_id, kind, operator)
        show(data, f"{kind} is taken back; `fast gap answer {kind} VALUE` answers it again.", json)
        return
    reading = load_record(Reading, {"kind": kind, "value": value}, "the answer")
    write_reading(found, campaign_id, search_id, reading, operator, is_sure=sure)
    unasked = "" if is_asked else " No search asked for it."
    show(data, f"{kind} {value:g} is kept; `fast gap` goes on with it.{unasked}", json)


def _check_unasked(lake: "Lake", kind: str) -> None:
    """Check that a number for which the search at hand did not ask can be kept.

    Raises:
        UsageError: nobody can measure it, or a search of another campaign, or of the lake, asks for it.
    """
    from fast.models.gap.ask.person import list_measurements
    from fast.tasks.gap.findings import find_last_run

    kinds = [one.kind for _, one in list_measurements()]
    if kind not in kinds:
        raise UsageError(f"`{kind}` says nothing of any effect, it must be one of {', '.join(kinds)}; change it.")
    run = find_last_run(lake)
    asked = run.findings.next_experiment if run is not None else None
    if run is None or asked is None or asked.person is None or asked.person.kind != kind:
        return
    words = f"add --campaign {run.campaign_id}" if run.campaign_id else "leave out --campaign"
    raise UsageError(f"it is search {run.gap_id} that asks for `{kind}`: {words}; nothing was changed.")


def _data(outcome: "GapOutcome") -> dict[str, Any]:
    run = outcome.run.model_dump(mode="json")
    return {**run.pop("findings"), **run, "is_new": outcome.is_new, "summary": outcome.sentence}


def _text(outcome: "GapOutcome", page: Path) -> str:
    from fast.flows.report.gap.sentences import (
        describe_in_use,
        describe_notes,
        describe_probability,
        describe_thresholds,
    )

    findings = outcome.run.findings
    lines = [f"{outcome.sentence}.", *filter(None, [describe_in_use(findings)]), ""]
    for place, found in enumerate(findings.rounds):
        sure = f"right with probability {describe_probability(found.named.probability)}"
        what = f"{found.named.kind}, {'left over' if findings.is_leftover(place) else sure}"
        lines += [f"round {place + 1}: {what}. {found.named.sentence}"]
        lines += [f"  left: {found.named.rest.sentence}"] if found.named.rest is not None else []
        lines += [f"  {note}" for note in describe_notes(found, findings.is_leftover(place))]
        lines += [f"  where: {where.sentence}" for where in found.where[:3]]
        tried = [row for row in found.candidates if row.effect != "none"]
        rows = [
            {
                "candidate": "any model" if row.effect == "unknown" else row.effect,
                "evidence": None if row.nats is None else round(row.nats, 1),
                "visible": None if row.visible_fraction is None else spell_share(row.visible_fraction),
            }
            for row in sorted(tried, key=lambda row: -(row.nats or 0.0))[:_MOST_CANDIDATES]
        ]
        lines += ["", table_text(rows), ""]
    known = [describe_thresholds(findings.panel.lines)] if findings.panel is not None else []
    lines += [" ".join([_EVIDENCE, *known]), _VISIBLE, ""]
    lines.append(f"held out: {_held_out(findings)}")
    lines += [f"asked: {one.outcome}" for one in findings.asked]
    if findings.next_experiment is not None:
        lines.append(f"next experiment: {findings.next_experiment.sentence}")
    lines += [f"ranking: {findings.ranking.sentence}"] if findings.ranking is not None else []
    lines += [f"power: {findings.power}"] if findings.power else []
    lines += [f"not to be told from {alias.of}: {alias.effect}" for alias in findings.aliases]
    lines += [f"warning: {sentence}" for sentence in findings.warnings]
    lines += [f"simulator version: {outcome.run.after_version_id}", f"page: {page}"]
    return "\n".join(lines)


def _held_out(findings: "Findings") -> str:
    gap = findings.gap
    if not any(found.version for found in findings.rounds):
        return f"error {gap.rmse_before_n:.2f} N, floor {gap.rmse_floor_n:.2f} N; nothing was added to the simulator"
    interval = "(too few designs or objects held out for an interval)"
    if gap.ci95 is not None:
        interval = f"[{100 * gap.ci95[0]:.0f}, {100 * gap.ci95[1]:.0f}]"
    return (
        f"{gap.rmse_before_n:.2f} -> {gap.rmse_after_n:.2f} N, floor {gap.rmse_floor_n:.2f} N, closed "
        f"{spell_share(gap.closed_fraction)} {interval}"
    )
