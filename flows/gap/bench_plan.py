"""`fast gap next`: the grasps that a search asks for, as a plan and a printable sheet for a bench without gantry."""

import shlex
from collections.abc import Collection
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from fast.hardware.station.cycle_time import plan_asked_minutes
from fast.lake.handoff.plan_folder import RESULTS, SHEET, find_tools, write_plan
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.models.gap.findings import NextExperiment
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspRequest, GraspSetup, Placement
from fast.models.units import spell_count, spell_minutes, spell_name, unit_of
from fast.tasks.bench.asked import read_open_requests
from fast.tasks.campaign.state import load_designs
from fast.tasks.gap.findings import find_last_run, find_run
from fast.tasks.gap.readings import is_answered
from fast.tasks.templates import render


@dataclass(frozen=True)
class BenchPlan:
    """Grasps in the order in which they are to be made, and how long a bench with a gantry takes for them (0: none)."""

    requests: tuple[GraspRequest, ...]
    minutes: float

    @property
    def sentence(self) -> str:
        """How much there is to do."""
        tools = len({request.tool_id for request in self.requests})
        words = f"asked for: {spell_count(len(self.requests), 'grasp')} of {spell_count(tools, 'tool')}"
        return f"{words}; about {spell_minutes(self.minutes)} with the gantry" if self.minutes else words


def plan_next(lake: Lake, search_id: str | None = None) -> BenchPlan:
    """Plan the grasps that are still open, of one search or of all.

    Raises:
        UsageError: a tool is no longer there.
    """
    requests = tuple(request for request, _ in read_open_requests(lake, search_id=search_id))
    if not requests:
        return BenchPlan((), 0.0)
    tools, designs = find_tools(lake, requests), load_designs(lake)
    known = {tool_id: designs[tool.design_id] for tool_id, tool in tools.items()}
    return BenchPlan(requests, plan_asked_minutes(requests, known))


def explain_silence(lake: Lake, search_id: str | None = None) -> str:
    """Explain why no grasp is asked for: what a search, or the lake's last, asks of a person or says of the ranking.

    Raises:
        UsageError: no such search has ended.
    """
    run = find_run(lake, search_id) if search_id is not None else find_last_run(lake)
    if run is None and search_id is not None:
        raise UsageError(f"no search `{search_id}` has ended in this lake; leave out --search for all that ask.")
    asked = run.findings.next_experiment if run is not None else None
    if run is not None and asked is not None and asked.person is not None:
        if not is_answered(lake, run.gap_id, asked.person.kind):
            return asked.sentence
    if run is not None and run.findings.ranking is not None:
        return run.findings.ranking.sentence
    return "No grasp is asked for; `fast gap` asks where it cannot tell what is missing."


def write_bench_plan(
    lake: Lake, plan: BenchPlan, directory: Path, config: str = "", *, shown_at: Path | None = None
) -> Path:
    """Write the plan and its sheet; returns the sheet.

    config: file of a campaign on a bench of one's own, of which peaks alone may be told, of tools still to be printed.
    shown_at: where the sheet says that the folder is, if it is moved there.

    Raises:
        UsageError: the folder holds such files already, or a tool is no longer there.
    """
    sheet = make_sheet(plan, lake.address, shown_at or directory, config)
    write_plan(lake, plan.requests, sheet, directory, is_told=bool(config))
    return directory / SHEET


def make_sheet(plan: BenchPlan, address: str, directory: Path, config: str = "") -> str:
    """Make the sheet as one HTML page: a row for each grasp, with what differs from the row before in bold."""
    rows = []
    known: Collection[str] | None = None
    for place, request in enumerate(plan.requests, 1):
        settings = describe_settings(request.setup, request.placement)
        how = {words: known is not None and words not in known for words in settings}
        object_name = f"{request.object_id} {get_object(request.object_id).name}"
        rows.append((request.tool_id, {"place": place, "object": object_name, "repeat": request.repeat, "how": how,
                                       "purpose": request.purpose}))  # fmt: skip
        known = settings
    tools = [(tool_id, [row for _, row in group]) for tool_id, group in groupby(rows, key=lambda row: row[0])]
    told = {
        "address": shlex.quote(address),
        "directory": shlex.quote(str(directory)),
        "config": config and shlex.quote(config),
        "results": RESULTS,
    }
    return render("flows/gap/bench_plan.html.j2", sentence=plan.sentence, tools=tools, **told)


def describe_settings(setup: GraspSetup, placement: Placement) -> list[str]:
    """List what a person sets on the bench, with units: `lift speed 20 mm/s`; offsets and waits if there are any."""
    always = ("lift_speed_mm_per_s", "open_gap_mm", "closed_gap_mm", "tip_below_mm", "close_speed_mm_per_s")
    found = [_spell(name, getattr(setup, name)) for name in always]
    if setup.dwell_s:
        found.append(f"wait {setup.dwell_s:g} s before the lift")
    if setup.supply_pressure_psi is not None:
        found.append(_spell("supply_pressure_psi", setup.supply_pressure_psi))
    return found + [f"object: {_spell(name, value)}" for name, value in placement if value]


def _spell(name: str, value: float) -> str:
    return f"{spell_name(name)} {value:g} {unit_of(name) or ''}".rstrip()


def describe_command(asked: NextExperiment, campaign_id: str | None, address: str) -> str:
    """Write the command line that answers a question, or writes the plan of its grasps; empty if it has neither."""
    of = f" --campaign {campaign_id}" if campaign_id else ""
    if asked.person is not None:
        return f"fast gap answer {asked.person.kind} VALUE{of} --operator NAME --lake {shlex.quote(address)}"
    return f"fast gap next --lake {shlex.quote(address)} --out asked" if asked.grasps else ""
