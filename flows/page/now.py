"""What the tab Now shows, derived from the lake: how far the campaign is, when a person is needed, the last grasps."""

import math
import statistics
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from fast.flows.campaign.pace import (
    LONGEST_GAP_S,
    PROPOSAL_S,
    Forecast,
    StageLeft,
    count_left,
    find_stage,
    forecast,
    name_uncounted,
)
from fast.flows.campaign.progress import Workload, count_work
from fast.flows.campaign.status import read_campaign
from fast.flows.progress import describe_duration, leave_out
from fast.hardware.parts.layout import N_OBJECTS, N_SLOTS, BenchLayout
from fast.lake.store import Lake
from fast.lake.tables.campaign import SimTraceRow, SimulationRow
from fast.models.design.profile import profile_path
from fast.models.errors import FastError
from fast.models.gap.findings import Findings
from fast.models.objects.catalogue import get_object, name_object
from fast.models.records import Design
from fast.models.traces.verdict import judge_grasp
from fast.tasks.bench.leave_out import find_batch_at_bench
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.left_out import LeftOut, Part
from fast.tasks.campaign.simulator_versions import at_present
from fast.tasks.campaign.state import CampaignState, rank_tools
from fast.tasks.gap.findings import find_last_run, find_newest_run

N_TILES = 12
_PACE_OF = 60  # grasps or simulations from whose times a pace is taken
_TILE_POINTS = 48
_KEPT = 200  # little pictures of traces
_LAST_TIMES = "SELECT epoch(created_at) AS at FROM {table} WHERE {where} ORDER BY created_at DESC LIMIT {n}"
_LAST_GRASPS = """
    SELECT grasp_id, tool_id, design_id, object_id, repeat, status, reason, peak_force_n, setup_id, started_at
    FROM grasps WHERE campaign_id = $campaign ORDER BY "order" DESC NULLS LAST, created_at DESC LIMIT $n
"""
_REPEATS = """
    SELECT tool_id, object_id,
        list(peak_force_n ORDER BY repeat, grasp_id) AS peaks, list(grasp_id ORDER BY repeat, grasp_id) AS ids
    FROM grasps WHERE campaign_id = $campaign AND status = 'ok' AND request_id IS NULL GROUP BY ALL
"""
_GAPS = """
    SELECT tool_id, object_id, gap_n, sim_peak_force_n FROM sim_vs_real
    WHERE campaign_id = $campaign AND version_id = $version
"""


@dataclass(frozen=True)
class Tile:
    """A grasp that has ended: its little picture, and what it says."""

    grasp_id: str
    """Of the lake."""
    label: str
    """The tool without its campaign, `B01T0`."""
    object_name: str
    """Of the catalogue."""
    repeat: int
    """Of this tool on this object."""
    sentence: str
    """The verdict on its peak, or why it failed."""
    is_strange: bool
    """Whether it is far from the simulator or from its repeats, or failed."""
    is_failed: bool
    """Whether it gave no force."""
    peak_n: float | None
    """Its peak pull-off force; None if it failed."""
    points: str
    """Of an SVG line, force over lift in a box of 100 by 40; empty without samples."""


@dataclass(frozen=True)
class Place:
    """A place of the bench's map. `state`: done, left, out (not in the campaign), skipped (a person left it out).

    `done` of `n` grasps with the tool in view.
    """

    object_id: int
    name: str
    state: str
    done: int
    n: int
    x: int
    y: int


@dataclass(frozen=True)
class Slot:
    """A slot of the rack. `state`: empty, left, done, rejected, unprinted, skipped (a person left it out)."""

    slot: int
    label: str
    state: str


@dataclass(frozen=True)
class Best:
    """The best finger so far, and its profile as an SVG path."""

    tool_id: str
    label: str
    quality_n: float
    sd_n: float | None
    path: str
    height_mm: float
    length_mm: float


@dataclass(frozen=True)
class Now:
    """All that the tab shows of a campaign."""

    campaign_id: str
    """That is shown."""
    batches_done: int
    """Batches that are confirmed and owe no grasp."""
    batches_total: int
    """Of the whole schedule."""
    load: Workload
    """Grasps, measured and simulated, that are done and that the schedule asks for."""
    is_complete: bool
    """Whether nothing of it is owed."""
    need: str
    """When a person is needed, and for what."""
    left: str
    """How long the rest takes at the pace of the last grasps, prints left aside, in words."""
    s_per_grasp: float | None
    """From grasp to grasp, mean of the last ones without breaks; None where none is known."""
    ticks: tuple[float, ...]
    """Shares of the bar at which a batch begins, which a person prints, 0 to 1."""
    best: Best | None
    """The best measured finger; None before there is one."""
    version: str
    """Id of the simulator version in use."""
    effects: str
    """That it has, by name, joined by commas."""
    misses: str
    """What the newest gap search found; empty where there was none."""
    gap_id: str
    """Id of that search, of the campaign or else of the lake; empty where there was none."""
    tiles: tuple[Tile, ...]
    """The last grasps, at most `N_TILES`, the newest first."""
    places: tuple[Place, ...]
    """The 36 of the bench's map."""
    slots: tuple[Slot, ...]
    """The ten of the rack."""
    parts: tuple[Part, ...]
    """Of the batch at the bench, which may be left out now."""
    left_out: tuple[LeftOut, ...]
    """Words by which something of that batch is left out."""
    tool: str
    """Id of the tool in view, which is that of the last grasp or the next to be measured; empty: none is printed."""
    is_folder: bool
    """Whether the bench is the lab's own, of which grasps are told."""
    as_of: datetime
    """When this was read."""


class NowReader:
    """Reads `Now`, and keeps the little pictures of traces that it drew."""

    def __init__(self, lake: Lake) -> None:
        self._lake = lake
        self._pictures: OrderedDict[str, str] = OrderedDict()

    def read(self, campaign_id: str) -> Now:
        """Read a campaign as it is now."""
        campaign = at_present(read_campaign(self._lake, campaign_id))
        state = campaign.state()
        load = count_work(campaign, state)
        s_per_grasp, s_per_simulation = self._paces(campaign_id)
        seen = forecast(campaign, state, s_per_grasp, s_per_simulation)
        run = find_newest_run(self._lake, campaign_id) or find_last_run(self._lake)
        tool_id = self._find_tool(campaign, state)
        left = count_left(campaign, state)
        schedule = campaign.config.schedule
        n_batches = max(schedule.batches_of(schedule.n_stages - 1))
        done = [b for b in range(1, n_batches + 1) if state.is_confirmed(b) and not _is_owed(campaign, state, b)]
        now, batch = datetime.now().astimezone(), find_batch_at_bench(campaign, state)
        return Now(
            campaign_id=campaign_id,
            batches_done=len(done),
            batches_total=n_batches,
            load=load,
            is_complete=load.fraction >= 1.0,
            need=_say_need(seen, now),
            left=_say_left(campaign, left, s_per_grasp, s_per_simulation),
            s_per_grasp=s_per_grasp,
            ticks=_place_ticks(campaign, load),
            best=self._find_best(campaign, state),
            version=campaign.version.version_id,
            effects=", ".join(one.effect.replace("_", " ") for one in campaign.version.effects),
            misses="" if run is None else _say_misses(run.findings),
            gap_id="" if run is None else run.gap_id,
            tiles=tuple(self._tiles(campaign)),
            places=tuple(_map_places(campaign, state, tool_id)),
            slots=tuple(_map_slots(campaign, state, tool_id)),
            parts=tuple(_list_parts(campaign, state, batch)),
            left_out=tuple(state.left_out.valid(batch)),
            tool=tool_id,
            is_folder=campaign.config.bench.is_folder,
            as_of=now,
        )

    def simulated(self, campaign_id: str, tool_id: str, object_id: int) -> dict[str, list[float]]:
        """Return lift and force that the simulator in use has of a tool on an object; empty where it has nothing."""
        campaign = at_present(read_campaign(self._lake, campaign_id))
        tool = next((tool for tool in campaign.state().tools if tool.tool_id == tool_id), None)
        if tool is None:
            return {"lift_mm": [], "force_n": []}
        for version_id in reversed(campaign.force_ratios(campaign.version)):
            simulation_id = SimulationRow.make_id(
                tool.design.design_id, object_id, version_id, campaign.config.grasp.setup_id
            )
            if self._lake.has(SimTraceRow, simulation_id):
                trace = self._lake.trace(simulation_id, SimTraceRow)
                lift, force = thin(trace.lift_mm, trace.force_n, 240)
                return {"lift_mm": lift, "force_n": force}
        return {"lift_mm": [], "force_n": []}

    def _paces(self, campaign_id: str) -> tuple[float | None, float | None]:
        """Compute seconds from grasp to grasp, and per simulated grasp, of the last ones."""
        grasps = self._lake.query(
            _LAST_TIMES.format(table="grasps", where="campaign_id = $campaign", n=_PACE_OF), {"campaign": campaign_id}
        )["at"].to_pylist()
        simulations = self._lake.query(_LAST_TIMES.format(table="simulations", where="true", n=_PACE_OF))[
            "at"
        ].to_pylist()
        return _mean_gap_s(grasps), _mean_gap_s(simulations)

    def _find_tool(self, campaign: Campaign, state: CampaignState) -> str:
        """Find the tool in view: that of the last grasp, or the first that is printed and not done."""
        last = self._lake.query(_LAST_GRASPS, {"campaign": campaign.campaign_id, "n": 1}).to_pylist()
        if last:
            return str(last[0]["tool_id"])
        return next((tool.tool_id for tool in state.tools if state.confirmed.get(tool.tool_id) == "printed"), "")

    def _find_best(self, campaign: Campaign, state: CampaignState) -> Best | None:
        ranked = rank_tools(self._lake, campaign.campaign_id)
        if not ranked:
            return None
        best = ranked[0]
        design = next((tool.design for tool in state.tools if tool.tool_id == best["tool_id"]), None)
        sd = self._lake.query("SELECT repeat_sd_n FROM tool_quality WHERE tool_id = ?", [best["tool_id"]])
        sds = sd["repeat_sd_n"].to_pylist()
        return Best(
            tool_id=best["tool_id"],
            label=best["tool_id"].rpartition("/")[2],
            quality_n=best["tool_quality_n"],
            sd_n=sds[0] if sds else None,
            path=draw_path(design),
            height_mm=design.height_mm if design else 0.0,
            length_mm=design.length_mm if design else 0.0,
        )

    def _tiles(self, campaign: Campaign) -> list[Tile]:
        name = campaign.campaign_id
        last = self._lake.query(_LAST_GRASPS, {"campaign": name, "n": N_TILES}).to_pylist()
        if not last:
            return []
        repeats = {
            (r["tool_id"], r["object_id"]): r for r in self._lake.query(_REPEATS, {"campaign": name}).to_pylist()
        }
        found = self._lake.query(_GAPS, {"campaign": name, "version": campaign.version.version_id}).to_pylist()
        gaps = {(row["tool_id"], row["object_id"]): row for row in found}
        variances = [float(np.var(row["peaks"], ddof=1)) for row in repeats.values() if len(row["peaks"]) > 1]
        sd_n = math.sqrt(statistics.fmean(variances)) if variances else None
        return [self._tile(row, repeats, gaps, sd_n) for row in last]

    def _tile(
        self,
        row: dict[str, Any],
        repeats: dict[tuple[str, int], dict[str, Any]],
        gaps: dict[tuple[str, int], dict[str, Any]],
        sd_n: float | None,
    ) -> Tile:
        cell = row["tool_id"], row["object_id"]
        if row["status"] == "ok" and row["peak_force_n"] is not None:
            own = repeats.get(cell, {"peaks": [], "ids": []})
            others = [
                p for p, i in zip(own["peaks"], own["ids"], strict=True) if i != row["grasp_id"] and p is not None
            ]
            simulated = gaps[cell]["sim_peak_force_n"] if cell in gaps else None
            elsewhere = [gap["gap_n"] for key, gap in gaps.items() if key != cell and gap["gap_n"] is not None]
            verdict = judge_grasp(row["peak_force_n"], simulated, elsewhere, others, sd_n)
            sentence, is_strange = verdict.sentence, verdict.is_strange
        else:
            sentence, is_strange = row["reason"] or "failed", True
        return Tile(
            grasp_id=row["grasp_id"],
            label=row["tool_id"].rpartition("/")[2],
            object_name=name_object(row["object_id"]),
            repeat=row["repeat"],
            sentence=sentence,
            is_strange=is_strange,
            is_failed=row["status"] != "ok",
            peak_n=row["peak_force_n"],
            points=self._picture(row["grasp_id"]),
        )

    def _picture(self, grasp_id: str) -> str:
        """Draw a trace as points of an SVG line, 100 wide and 40 high; empty without samples."""
        if grasp_id in self._pictures:
            return self._pictures[grasp_id]
        try:
            trace = self._lake.trace(grasp_id)
        except FastError:
            return ""
        self._pictures[grasp_id] = draw_points(trace.lift_mm, trace.force_n)
        while len(self._pictures) > _KEPT:
            self._pictures.popitem(last=False)
        return self._pictures[grasp_id]


def thin(lift_mm: np.ndarray, force_n: np.ndarray, n: int) -> tuple[list[float], list[float]]:
    """Thin a trace over lift to about `n` samples that keep its shape: each step of samples' smallest and largest."""
    lift = np.maximum.accumulate(np.nan_to_num(np.asarray(lift_mm, dtype=float)))
    force = np.asarray(force_n, dtype=float)
    if len(force) > n:
        places: list[int] = []
        for part in np.array_split(np.arange(len(force)), n // 2):
            places += sorted({int(part[force[part].argmin()]), int(part[force[part].argmax()])})
        lift, force = lift[places], force[places]
    return lift.round(3).tolist(), force.round(3).tolist()


def draw_points(lift_mm: np.ndarray, force_n: np.ndarray) -> str:
    """Draw a trace as points of an SVG line in a box of 100 by 40."""
    if not len(force_n):
        return ""
    lift, force = thin(lift_mm, force_n, _TILE_POINTS)
    top, low, end = max(*force, 1.0), min(*force, 0.0), max(*lift, 1.0)
    return " ".join(
        f"{100 * x / end:.1f},{38 - 36 * (y - low) / (top - low):.1f}" for x, y in zip(lift, force, strict=True)
    )


def draw_path(design: Design | None) -> str:
    """Draw the profile of a finger as an SVG path; empty for one that has none."""
    if design is None:
        return ""
    try:
        return profile_path(design)
    except FastError:
        return ""


def _mean_gap_s(times: Sequence[float]) -> float | None:
    """Compute the mean time between things that ended one after the other, newest first, without breaks."""
    gaps = [later - earlier for later, earlier in zip(times, times[1:], strict=False)]
    known = [gap for gap in gaps if 0 <= gap <= LONGEST_GAP_S]
    return statistics.fmean(known) if known else None


def _say_need(seen: Forecast, now: datetime) -> str:
    if seen.batch is not None and seen.in_s:
        at = (now + timedelta(seconds=seen.in_s)).astimezone()  # the clocks may change
        day = "" if at.date() == now.date() else f" on {at:%A, %d %B}"
        return f"You are needed in {describe_duration(seen.in_s)} ({at:%H:%M %Z}{day}): print B{seen.batch:02d}"
    return seen.in_words(now).rstrip(".")


def _say_left(
    campaign: Campaign, left: Sequence[StageLeft], s_per_grasp: float | None, s_per_simulation: float | None
) -> str:
    """Say how long the rest of the schedule takes at the pace of the last grasps, prints left aside."""
    total_s = 0.0
    for stage in left:
        for n, each_s in ((stage.grasps, s_per_grasp), (stage.simulated, s_per_simulation)):
            if n and each_s is None:
                return "how long is not known yet"
        bench_s = stage.grasps * (s_per_grasp or 0.0)
        proposal_s = PROPOSAL_S / len(campaign.object_ids) if stage.is_guided else 0.0
        total_s += max(bench_s, stage.simulated * ((s_per_simulation or 0.0) + proposal_s))
    if not total_s:
        return "all is done"
    return leave_out(f"{describe_duration(total_s)} of work left", name_uncounted(campaign.config))


def _say_misses(findings: Findings) -> str:
    # A second of imports, which a lake without searches does without.
    from fast.flows.report.gap.sentences import shorten_findings

    return f"{shorten_findings(findings)}; error {findings.gap.rmse_after_n:.2f} N"


def _is_owed(campaign: Campaign, state: CampaignState, batch: int) -> bool:
    plan, limit = campaign.config.objects.list_grasps(0), campaign.config.max_grasp_attempts
    return any(state.missing_grasps(tool, plan, limit) for tool in state.tools_of(batch))


def _place_ticks(campaign: Campaign, load: Workload) -> tuple[float, ...]:
    """Find where on the bar of grasps a batch begins, which a person prints."""
    schedule, per_tool = campaign.config.schedule, campaign.config.objects.n_grasps
    total = max(load.grasps_total, 1)
    ticks, made = [], 0
    for stage in range(schedule.n_stages):
        for batch in schedule.batches_of(stage):
            ticks.append(min(made / total, 1.0))
            made += schedule.tools_of(batch) * per_tool
    return tuple(ticks)


def _map_places(campaign: Campaign, state: CampaignState, tool_id: str) -> list[Place]:
    """Map the 36 places, with how far the tool in view is on each."""
    layout = campaign.config.objects.stand_on(BenchLayout())
    cells, done = campaign.config.objects.list_grasps(0), state.measured.get(tool_id, set())
    own = {place: object_id for object_id, place in layout.own_objects}
    skipped = state.left_out.objects(find_batch_at_bench(campaign, state))
    wanted: dict[int, int] = {}
    for object_id, _ in cells:
        wanted[object_id] = wanted.get(object_id, 0) + 1
    places = []
    for number in range(N_OBJECTS):
        object_id = own.get(number, number)
        n, n_done = wanted.get(object_id, 0), sum(cell[0] == object_id for cell in done)
        status = "out" if not n else "done" if n_done >= n else "skipped" if object_id in skipped else "left"
        row, column = divmod(number, layout.n_columns)
        places.append(
            Place(object_id, get_object(object_id).name, status, n_done, n, column, layout.n_columns - 1 - row)
        )
    return places


def _map_slots(campaign: Campaign, state: CampaignState, tool_id: str) -> list[Slot]:
    """Map the ten slots of the rack, with the tools of the batch that hangs there."""
    batch = next((tool.batch for tool in state.tools if tool.tool_id == tool_id), None)
    stage = find_stage(campaign, state)
    waiting = [b for b in campaign.config.schedule.batches_of(stage) if state.tools_of(b) and not state.is_confirmed(b)]
    if batch is None and waiting:
        batch = waiting[0]
    tools = {tool.rack_slot: tool for tool in state.tools_of(batch)} if batch is not None else {}
    slots = []
    for number in range(N_SLOTS):
        tool = tools.get(number)
        if tool is None:
            slots.append(Slot(number, "", "empty"))
            continue
        said = state.confirmed.get(tool.tool_id)
        plan, limit = campaign.config.objects.list_grasps(0), campaign.config.max_grasp_attempts
        status = "unprinted" if said is None else said
        if said == "printed":
            is_out = state.left_out.has_tool(tool.batch, tool.slot)
            status = "skipped" if is_out else "left" if state.missing_grasps(tool, plan, limit) else "done"
        slots.append(Slot(number, tool.label, status))
    return slots


def _list_parts(campaign: Campaign, state: CampaignState, batch: int) -> list[Part]:
    """List what of the batch at the bench can be left out: its tools, its objects, and all that is left of it."""
    plan, limit = campaign.config.objects.list_grasps(0), campaign.config.max_grasp_attempts
    owed = {tool.slot: state.missing_grasps(tool, plan, limit) for tool in state.tools_of(batch)}
    slots = [slot for slot, cells in owed.items() if cells]
    if not slots:
        return []
    objects = sorted({object_id for cells in owed.values() for object_id, _ in cells})
    tools = [Part(batch=batch, slot=slot) for slot in slots]
    return [*tools, *(Part(batch=batch, object_id=object_id) for object_id in objects), Part(batch=batch)]
