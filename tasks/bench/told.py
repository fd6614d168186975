"""Grasps that a bench of one's own made: told as peaks or traces, checked against what was asked, written to the lake.

Nothing is written unless all of it can be. What is told twice with the same numbers is kept once.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from typing import Any

import numpy as np

from fast.lake.handoff.samples import find_mirrored
from fast.lake.tables.campaign import GraspRow, ProposalRow, ToolRow, TraceRow
from fast.lake.tables.requests import setup_columns
from fast.models.errors import UsageError
from fast.models.ids import canonical_json
from fast.models.question import Question, settle
from fast.models.records import BENCH_FAULT, GraspRequest, Trace, find_setup_id
from fast.models.traces import find_counted_down, initial_force_n, peak_force_n, work_j
from fast.models.units import spell_count, spell_number
from fast.tasks.bench.asked import read_open_requests
from fast.tasks.bench.measure import SPEED_FACTOR, find_first_order
from fast.tasks.bench.plan import order_grasps
from fast.tasks.bench.print import confirm_told
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.requests import append_event
from fast.tasks.campaign.state import CampaignState, ProposedTool

TOLD = "told"  # kind of events
TAKEN_BACK = "taken_back"
_SHOWN = 10  # faults of one answer that are named
_LEAST_SAMPLES = 10
_LIFT_BACK_MM = 1.0  # more is no noise of an encoder
_REMEDY = "nothing was written"
Key = tuple[str, int, int]  # tool id, object id, repeat
Ask = Callable[[Campaign, Mapping[str, ProposedTool], Sequence["ToldGrasp"]], list[Question]]


@dataclass(frozen=True)
class ToldGrasp:
    """A grasp as somebody tells it: with a peak, a trace (then the peak is its), or a reason why it failed."""

    place: str
    """File and row, for messages."""
    tool_id: str
    """With or without its campaign."""
    object_id: int
    """What was grasped."""
    repeat: int
    """Counts the grasps of a tool on the object."""
    peak_force_n: float | None = None
    """Largest force during the lift."""
    trace: Trace | None = None
    """The samples."""
    reason: str = ""
    """Why it failed; empty: it did not."""
    started_at: datetime | None = None
    """When, if it is said."""
    setup_id: str | None = None
    """Of how it was made, where it says so."""

    @property
    def key(self) -> Key:
        """Which grasp it is."""
        return self.tool_id, self.object_id, self.repeat

    @property
    def force_n(self) -> float | None:
        """The peak pull-off force, if it did not fail."""
        return self.peak_force_n if self.trace is None else peak_force_n(self.trace)


@dataclass(frozen=True)
class Telling:
    """How measured grasps are told."""

    operator: str = "unknown"
    """Who measured."""
    is_dry: bool = False
    """Only check."""
    may_replace: bool = False
    """Correct what was told before with other numbers."""
    is_sure: bool = False
    """Strange numbers are right, and are marked in the lake; without it they are a question."""


@dataclass(frozen=True)
class Taken:
    """What came of it: grasps written (of them with a trace, and failed ones), and those the lake had already."""

    n_written: int
    n_traces: int
    n_failed: int
    n_known: int
    notes: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """In words."""
        words = f"{spell_count(self.n_written, 'grasp')} written"
        if self.n_written:
            words += f" ({self.n_traces} with a trace, {self.n_failed} failed)"
        words += f", {self.n_known} {'was' if self.n_known == 1 else 'were'} there already" if self.n_known else ""
        n_peaks = self.n_written - self.n_traces - self.n_failed
        if n_peaks:
            words += f"; {spell_count(n_peaks, 'peak')} without a trace: the scientist and the report take that, "
            words += "calibration on traces and `fast gap` cannot"
        return words


def take_told(
    campaign: Campaign,
    told: Sequence[ToldGrasp],
    how: Telling,
    ask: Ask | None = None,
    way: str = "--sure",
) -> Taken:
    """Write what was told; tools of which a grasp is told count as printed, unless somebody has said otherwise.

    ask: what finds strange numbers. way: how a person says that they are sure.

    Raises:
        UsageError: a grasp was not asked for, is told twice or with other numbers than before, or is implausible;
            nothing was written.
    """
    state = campaign.state()
    named = find_named_tools(campaign)
    told = [replace(one, tool_id=_full_id(campaign, named, one)) for one in told]
    tools = {tool.tool_id: tool for tool in state.tools}
    before = {(row.tool_id, row.object_id, row.repeat): row for row in _known_rows(campaign, told)}
    known = _find_known(campaign, told, before)
    asked = _find_asked(campaign, state)
    if mirrored := find_mirrored([one.trace for one in told if one.trace is not None]):
        raise UsageError(_say([mirrored]))
    faults = [fault for one in told if (fault := _find_fault(campaign, state, tools, asked, one))]
    faults += _find_doubles(told) + _find_disorder(asked, told)
    faults += (
        []
        if how.may_replace
        else [
            _say_change(one, row)
            for one in told
            if one.key not in known and (row := before.get(one.key)) and row.status == "ok"
        ]
    )
    if faults:
        raise UsageError(_say(faults))
    new = [one for one in told if one.key not in known]
    questions = ask(campaign, tools, new) if ask is not None else []
    settle(questions, how.is_sure, "Correct the file", way)
    if new and not how.is_dry:
        _write(campaign, state, new, before, asked, how.operator, _mark(questions, new))
    n_traces = sum(one.trace is not None for one in new)
    n_failed = sum(one.force_n is None for one in new)
    return Taken(len(new), n_traces, n_failed, len(told) - len(new))


def take_back(campaign: Campaign, operator: str) -> int:
    """Take back the last telling: its grasps count as not made, and are asked for again. Returns how many they are.

    The rows stay in the lake, superseded by rows that say who took them back; numbers that `--replace` had corrected
    do not come back.

    Raises:
        UsageError: nothing was told, or all of it was taken back.
    """
    told = [
        row
        for row in campaign.lake.records(GraspRow, campaign_id=campaign.campaign_id)
        if "told_by" in json.loads(row.details_json)
    ]
    if not told:
        raise UsageError(f"campaign `{campaign.campaign_id}` has no telling that could be taken back.")
    last = max(row.order or 0 for row in told)
    moment = next(json.loads(row.details_json)["telling"] for row in told if (row.order or 0) == last)
    rows = [row for row in told if json.loads(row.details_json).get("telling") == moment]
    taken = [_take_back_row(row, operator) for row in rows]
    campaign.lake.append(taken, campaign.provenance(parents=sorted({row.tool_id for row in rows})))
    text = f"{operator} took back {spell_count(len(rows), 'grasp')}"
    append_event(campaign.lake, campaign.campaign_id, TAKEN_BACK, text, n=len(rows))
    return len(rows)


def _take_back_row(row: GraspRow, operator: str) -> GraspRow:
    """Make the row that stands for a grasp which counts as not made."""
    details = canonical_json({"end": BENCH_FAULT, "taken_back_by": operator})
    changes = {"status": "failed", "reason": f"taken back by {operator}", "peak_force_n": None, "work_j": None}
    return row.model_copy(update={**changes, "initial_force_n": None, "details_json": details})


def find_named_tools(campaign: Campaign) -> dict[str, list[str]]:
    """Find the ids of the tools of each design of one's own, by its name as it is compared."""
    found: dict[str, list[str]] = {}
    for row in campaign.lake.rows(ProposalRow, campaign_id=campaign.campaign_id, fidelity="real"):
        if row["name"] and row["batch"] is not None and row["slot"] is not None:
            tool_id = ToolRow.make_id(campaign.campaign_id, row["batch"], row["slot"])
            found.setdefault(_bare_name(row["name"]), []).append(tool_id)
    return found


def _bare_name(name: str) -> str:
    """Return a name without blanks, as file names have none."""
    return name.strip().replace(" ", "_").casefold()


def _full_id(campaign: Campaign, named: Mapping[str, Sequence[str]], one: ToldGrasp) -> str:
    """Return `quick/B01T3` of `B01T3`, of `b01t3`, or of the name that designs.csv gives to its design."""
    name, found, short = one.tool_id.strip().rpartition("/")
    is_id = re.fullmatch(r"B\d+T\d", short.upper()) is not None
    tools = () if is_id else tuple(dict.fromkeys(named.get(_bare_name(one.tool_id), ())))
    if len(tools) > 1:
        raise UsageError(
            f"{one.place}: `{one.tool_id}` was printed as {' and '.join(tools)}; nothing was written: name the tool."
        )
    if tools:
        return tools[0]
    return f"{name if found else campaign.campaign_id}/{short.upper()}"


def _mark(questions: Sequence[Question], told: Sequence[ToldGrasp]) -> dict[Key, list[str]]:
    """Mark what was strange of each grasp that a person is sure of."""
    measured = [one for one in told if one.force_n is not None]
    marks: dict[Key, list[str]] = {}
    for question in questions:
        for number in question.numbers:
            marks.setdefault(measured[number].key, []).append(question.kind)
    return marks


def _find_asked(campaign: Campaign, state: CampaignState) -> Mapping[Key, GraspRequest]:
    """Find every grasp that a batch, or an open question, asks for: made or not."""
    setup = campaign.config.grasp
    asked: dict[Key, GraspRequest] = {}
    for tool in state.tools:
        if tool.batch in state.imported:
            continue
        for object_id, repeat in order_grasps(campaign, tool):
            request = GraspRequest(tool_id=tool.tool_id, object_id=object_id, repeat=repeat, setup=setup)
            asked[tool.tool_id, object_id, repeat] = request
    own = {tool.tool_id for tool in state.tools}
    for request, _ in read_open_requests(campaign.lake):
        if request.tool_id in own:
            asked[request.tool_id, request.object_id, request.repeat] = request
    return asked


def _known_rows(campaign: Campaign, told: Sequence[ToldGrasp]) -> list[GraspRow]:
    """Return the newest attempt of each grasp that is told and that the lake has."""
    wanted = {one.key for one in told}
    rows = campaign.lake.records(GraspRow, tool_id=sorted({one.tool_id for one in told}))
    return sorted(
        (row for row in rows if (row.tool_id, row.object_id, row.repeat) in wanted), key=lambda row: row.attempt
    )


def _find_fault(
    campaign: Campaign,
    state: CampaignState,
    tools: Mapping[str, ProposedTool],
    asked: Mapping[Key, GraspRequest],
    one: ToldGrasp,
) -> str | None:
    """Find what is wrong with a grasp by itself."""
    if one.tool_id not in tools:
        return f"{one.place}: tool {one.tool_id} was not asked for; tools are named like {_example(state)}"
    if state.confirmed.get(one.tool_id) == "rejected":
        return f"{one.place}: tool {one.tool_id} was rejected when it was printed, so it cannot have made a grasp"
    if one.key not in asked:
        config = campaign.config.objects
        return (
            f"{one.place}: object {one.object_id}, repeat {one.repeat} of tool {one.tool_id} was not asked for; "
            f"objects are {', '.join(map(str, config.object_ids))}, repeats 0 to {config.repeats - 1}"
        )
    request = asked[one.key]
    if one.setup_id not in (None, find_setup_id(request.setup, request.placement)):
        return f"{one.place}: it was made with another setup or placement than its row of grasps.csv asked for"
    if one.trace is not None:
        return _find_trace_fault(campaign, request, one, one.trace)
    if one.peak_force_n is None:
        return None if one.reason else f"{one.place}: it has neither a force nor a reason why there is none"
    if one.reason:
        return f"{one.place}: it has a force and a reason why there is none; remove one"
    return _find_force_fault(campaign, one, one.peak_force_n)


def _find_force_fault(campaign: Campaign, one: ToldGrasp, force_n: float) -> str | None:
    limit_n = campaign.config.bench.max_force_n
    if 0 <= force_n <= limit_n:
        return None
    return (
        f"{one.place}: the peak is {force_n:g} N, it must be from 0 to {limit_n:g} N; look at unit, sign and decimal "
        "point, or raise bench.max_force_n"
    )


def _find_trace_fault(campaign: Campaign, request: GraspRequest, one: ToldGrasp, trace: Trace) -> str | None:
    time_s, lift_mm = trace.time_s, trace.lift_mm
    if len(time_s) < _LEAST_SAMPLES:
        return (
            f"{one.place}: the trace has {spell_count(len(time_s), 'sample')}, it must have at least {_LEAST_SAMPLES}"
        )
    if not all(np.isfinite(channel).all() for channel in (time_s, lift_mm, trace.force_n)):
        return f"{one.place}: the trace has values that are not finite numbers; correct it"
    if (np.diff(time_s) < 0).any():
        row = int(np.flatnonzero(np.diff(time_s) < 0)[0]) + 2
        return f"{one.place}: time goes back at sample {row} ({time_s[row - 1]:g} s); samples are in order of time"
    if lift_mm.min() < -1.0 or lift_mm.max() <= 0:
        return (
            f"{one.place}: lift goes from {lift_mm.min():g} to {lift_mm.max():g} mm, it must begin at 0 and rise; look "
            "at sign and zero"
        )
    back_mm = np.maximum.accumulate(lift_mm) - lift_mm
    up_to_top = back_mm[: int(lift_mm.argmax()) + 1]
    if _are_exchanged(lift_mm, trace.force_n):
        return f"{one.place}: the lift comes back and the force never does; look whether the two are exchanged"
    if up_to_top.max() > _LIFT_BACK_MM:
        return (
            f"{one.place}: the lift goes back by {up_to_top.max():.1f} mm at sample {int(up_to_top.argmax()) + 1}; "
            "give the lift alone, without the way there and back"
        )
    lifted = np.flatnonzero(lift_mm > 0.05 * lift_mm.max())
    took_s = float(time_s[lifted[-1]] - time_s[lifted[0]])
    speed, wanted = float(np.ptp(lift_mm[lifted])) / max(took_s, 1e-9), request.setup.lift_speed_mm_per_s
    if not wanted / SPEED_FACTOR <= speed <= wanted * SPEED_FACTOR:
        return (
            f"{one.place}: the lift has {spell_number(speed, 3)} mm/s, {wanted:g} mm/s were asked for; look at the "
            "units of time and lift, or set grasp.lift_speed_mm_per_s"
        )
    if (lowest := find_counted_down(trace)) is not None:
        return (
            f"{one.place}: the pull is counted downwards, to {trace.force_n[lowest]:g} N at sample {lowest + 1}; force "
            "is positive when the object pulls the gripper down: change the sign"
        )
    return _find_force_fault(campaign, one, peak_force_n(trace)) or _find_force_fault(
        campaign, one, float(np.abs(trace.force_n).max())
    )


def _are_exchanged(lift_mm: np.ndarray, force_n: np.ndarray) -> bool:
    """Return whether what is told as force goes one way, like a lift, and the lift rises and falls, like a force."""
    falls_mm = float(lift_mm.max() - lift_mm[int(lift_mm.argmax()) :].min())
    back_n = float((np.maximum.accumulate(force_n) - force_n).max())
    return back_n <= _LIFT_BACK_MM < 0.2 * float(np.ptp(force_n)) and falls_mm > 0.5 * float(lift_mm.max())


def _find_doubles(told: Sequence[ToldGrasp]) -> list[str]:
    first: dict[Key, ToldGrasp] = {}
    faults = []
    for one in told:
        other = first.setdefault(one.key, one)
        if other is not one:
            name = f"tool {one.tool_id}, object {one.object_id}, repeat {one.repeat}"
            faults.append(f"{one.place}: {name} is told twice, first in {other.place}; leave one of the two out")
    return faults


def _find_disorder(asked: Mapping[Key, GraspRequest], told: Sequence[ToldGrasp]) -> list[str]:
    """Find a search's grasps not in the order asked for: the effects of wear and time cancel only in that order."""
    place = {request.request_id: number for number, request in enumerate(asked.values()) if request.request_id}
    timed = [
        (one.started_at, place[asked[one.key].request_id], one)
        for one in told
        if one.started_at is not None and one.key in asked and asked[one.key].request_id
    ]
    timed.sort(key=lambda entry: entry[0])
    return [
        f"{after[2].place}: it was made after {before[2].place}, the plan asks for it before; make the grasps in the "
        "order of the plan, or correct their times"
        for before, after in pairwise(timed)
        if before[1] > after[1]
    ]


def _find_known(campaign: Campaign, told: Sequence[ToldGrasp], before: Mapping[Key, GraspRow]) -> set[Key]:
    """Find the grasps that the lake has as they are told, their samples too; a failure, with its reason."""
    alike = [one for one in told if (row := before.get(one.key)) is not None and _has_equal_numbers(one, row)]
    traced = [before[one.key].grasp_id for one in alike if one.trace is not None]
    traces = {row.grasp_id: row.trace for row in campaign.lake.records(TraceRow, grasp_id=traced)} if traced else {}
    return {
        one.key for one in alike if one.trace is None or _are_equal(one.trace, traces.get(before[one.key].grasp_id))
    }


def _has_equal_numbers(one: ToldGrasp, row: GraspRow) -> bool:
    if row.status != "ok" or one.force_n is None:
        return row.status != "ok" and one.force_n is None and row.reason == one.reason
    is_traced = row.work_j is not None
    return is_traced == (one.trace is not None) and abs((row.peak_force_n or 0.0) - one.force_n) <= 1e-9


def _are_equal(one: Trace, other: Trace | None) -> bool:
    channels = ("time_s", "lift_mm", "force_n")
    return other is not None and all(np.array_equal(getattr(one, name), getattr(other, name)) for name in channels)


def _say_change(one: ToldGrasp, row: GraspRow) -> str:
    """Tell of a grasp that the lake has as a success with other numbers."""
    now = f"{one.force_n:g} N" if one.force_n is not None else f"failed ({one.reason})"
    was = f"{row.peak_force_n:g} N{'' if row.work_j is None else ' with its trace'}"
    if one.trace is not None:
        now += " with a trace" if row.work_j is None else " with another trace"
    remedy = "`fast tell --replace` (in Python `may_replace=True`) corrects it"
    return f"{one.place}: the lake has this grasp with {was}, now it is {now}; {remedy}"


def _example(state: CampaignState) -> str:
    return state.tools[-1].tool_id if state.tools else "NAME/B01T0, and none is proposed yet: `fast ask` first"


def _say(faults: Sequence[str]) -> str:
    if len(faults) == 1:
        return f"{faults[0]}; {_REMEDY}."
    shown = "\n".join(f"  {fault}." for fault in faults[:_SHOWN])
    more = f"\n  and {len(faults) - _SHOWN} more." if len(faults) > _SHOWN else ""
    return f"{len(faults)} things are wrong, {_REMEDY}:\n{shown}{more}"


def _write(
    campaign: Campaign,
    state: CampaignState,
    told: Sequence[ToldGrasp],
    before: Mapping[Key, GraspRow],
    asked: Mapping[Key, GraspRequest],
    operator: str,
    marks: Mapping[Key, list[str]],
) -> None:
    """Write tools, samples, grasps, in this order: a crash in between leaves nothing that telling again cannot mend."""
    tools = {tool.tool_id: tool for tool in state.tools}
    unsaid = [tools[i] for i in dict.fromkeys(one.tool_id for one in told) if i not in state.confirmed]
    confirm_told(campaign.lake, campaign.campaign_id, unsaid, operator)
    order = find_first_order(campaign)
    telling = order  # the number of its first grasp names a telling
    rows: list[Any] = []
    for place, one in enumerate(told):
        row = _grasp_row(campaign, tools[one.tool_id], one, before.get(one.key), asked[one.key])
        details = {"told_by": operator, "telling": telling} | ({"sure": marks[one.key]} if one.key in marks else {})
        row = row.model_copy(update={"order": order + place, "details_json": canonical_json(details)})
        rows += [TraceRow.of(row.grasp_id, one.trace), row] if one.trace is not None else [row]
    earlier = [(one, old) for one in told if (old := before.get(one.key)) is not None]
    rows += [_take_back_row(old, operator) for one, old in earlier if _drops_trace(one, old)]
    parents = sorted({tools[one.tool_id].design.design_id for one in told} | {one.tool_id for one in told})
    campaign.lake.append(rows, campaign.provenance(parents=parents))
    append_event(
        campaign.lake, campaign.campaign_id, TOLD, f"{operator} told {spell_count(len(told), 'grasp')}", n=len(told)
    )


def _grasp_row(
    campaign: Campaign, tool: ProposedTool, one: ToldGrasp, before: GraspRow | None, request: GraspRequest
) -> GraspRow:
    """Make the row that replaces a grasp's earlier one; a success after a failure or without trace is a new attempt."""
    is_new = before is not None and one.force_n is not None and (before.status != "ok" or _drops_trace(one, before))
    attempt = 0 if before is None else before.attempt + is_new
    lab = campaign.config.lab
    trace, force_n = one.trace, one.force_n
    return GraspRow(
        grasp_id=GraspRow.make_id(tool.tool_id, one.object_id, one.repeat, attempt, request.request_id, lab),
        campaign_id=campaign.campaign_id,
        tool_id=tool.tool_id,
        batch=tool.batch,
        slot=tool.slot,
        design_id=tool.design.design_id,
        object_id=one.object_id,
        repeat=one.repeat,
        attempt=attempt,
        status="ok" if force_n is not None else "failed",
        reason=one.reason,
        started_at=one.started_at,
        peak_force_n=force_n,
        work_j=None if trace is None else work_j(trace),
        initial_force_n=None if trace is None else initial_force_n(trace),
        bench=campaign.config.bench.name,
        request_id=request.request_id or None,
        lab=lab,
        **setup_columns(request.setup, request.placement),
    )


def _drops_trace(one: ToldGrasp, before: GraspRow) -> bool:
    """Return whether a peak alone replaces a grasp with its trace, which would stay beside the new peak."""
    return before.work_j is not None and one.trace is None and one.force_n is not None
