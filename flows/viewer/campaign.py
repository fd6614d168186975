"""Rerun recording of a campaign, afterwards or while it runs: bench at work, what it measured and what was proposed."""

import logging
import time
import tomllib
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

import rerun as rr
import rerun.blueprint as rrb

from fast.flows.report.campaign.content import Content
from fast.flows.report.campaign.facts import Tool
from fast.flows.report.campaign.queries import literal
from fast.flows.viewer.bench import place_bench_eye
from fast.flows.viewer.bench_timeline import BenchTimeline
from fast.flows.viewer.curves import view_curves
from fast.flows.viewer.stream import lay_out, open_recording
from fast.hardware.parts.layout import N_OBJECTS, BenchLayout
from fast.lake.store import Lake
from fast.lake.tables.imported import is_imported
from fast.models.objects.catalogue import FIRST_OWN_ID
from fast.models.units import spell_name
from fast.models.validation import load_record
from fast.tasks.campaign.settings import ObjectPlan

_LOG = logging.getLogger(__name__)

POLL_S = 2.0
PLAYBACK_SPEED = 15.0
FULL_FORCES_N = (5.0, 10.0, 20.0, 40.0, 60.0, 80.0)  # of the lightest colour
_PEAK = "SELECT max(peak_force_n) AS peak_n FROM grasps WHERE campaign_id = {campaign} AND status = 'ok'"
_OBJECTS = "SELECT DISTINCT object_id FROM grasps WHERE campaign_id = {campaign} ORDER BY 1"


def write_recording(lake: Lake, campaign_id: str, path: Path) -> Path:
    """Write a campaign: the bench at work on the timeline `bench`; returns `path`.

    Raises:
        UsageError: there is no such campaign, or the file cannot be written.
    """
    content = Content.load(lake, campaign_id)
    with open_recording(f"campaign {campaign_id}", path, lay_out_campaign(content)) as recording:
        n_grasps = send_campaign(recording, content).n_grasps
    _LOG.info("%d grasps written to %s", n_grasps, path)
    return path


def follow(
    lake: Lake,
    campaign_id: str,
    path: Path,
    is_running: Callable[[], bool],
    *,
    began: Callable[[], None] | None = None,
    progress: Callable[[str], None] | None = None,
    poll_s: float = POLL_S,
) -> int:
    """Write to a file what the campaign measures and proposes, until it ends.

    Looks at the lake every `poll_s`; `began` is called once the file has a beginning. Ctrl-C ends it too; what was
    written stays. Returns the number of grasps.

    Raises:
        UsageError: there is no such campaign, or the file cannot be written.
    """
    content = Content.load(lake, campaign_id)
    blueprint = lay_out_campaign(content, is_live=True)
    with open_recording(f"campaign {campaign_id} live", path, blueprint) as stream:
        timeline = send_campaign(stream, content)
        stream.flush()
        if began is not None:
            began()
        with suppress(KeyboardInterrupt):
            is_last = False
            while not is_last:
                is_last = not is_running()  # asked first: what is written until then is still sent
                if timeline.update() and progress is not None:
                    progress(f"{timeline.n_grasps} grasps of {campaign_id}")
                stream.flush()
                if not is_last:
                    time.sleep(poll_s)
    return timeline.n_grasps


def send_campaign(recording: rr.RecordingStream, content: Content) -> BenchTimeline:
    """Send what there is of a campaign; the timeline can be asked for more."""
    document = rr.TextDocument(describe(content), media_type="text/markdown")
    recording.log("about", document, static=True)
    campaign_id = content.campaign.campaign_id
    (layout, objects), full_n = find_objects(content), choose_full_force_n(content)
    timeline = BenchTimeline(recording, content.lake, campaign_id, layout, objects, full_n, content.space)
    timeline.update()
    return timeline


def find_objects(content: Content) -> tuple[BenchLayout, list[int]]:
    """Find the bench of a campaign, and the objects that its tools shall meet.

    Of a campaign that was run elsewhere, the objects that its tools met; where its own ones stood is not known, and
    they are drawn on free places.
    """
    config_toml = content.campaign.config_toml
    if is_imported(config_toml):
        rows = content.lake.query(_OBJECTS.format(campaign=literal(content.campaign.campaign_id))).to_pylist()
        met = [row["object_id"] for row in rows]
        free = (place for place in range(N_OBJECTS) if place not in met)
        own = tuple(zip((number for number in met if number >= FIRST_OWN_ID), free, strict=False))
        here = [number for number in met if 0 <= number < N_OBJECTS]
        return BenchLayout(own_objects=own), [*here, *dict(own)]
    plan = load_record(ObjectPlan, tomllib.loads(config_toml).get("objects", {}), "stored config")
    return plan.stand_on(BenchLayout()), sorted(plan.object_ids)


def choose_full_force_n(content: Content) -> float:
    """Choose a round force that no grasp of the campaign exceeds so far; 40 N before the first."""
    found = content.lake.query(_PEAK.format(campaign=literal(content.campaign.campaign_id))).to_pylist()
    peak_n = found[0]["peak_n"] if found and found[0]["peak_n"] is not None else 40.0
    return next((full for full in FULL_FORCES_N if full >= peak_n), FULL_FORCES_N[-1])


def lay_out_campaign(content: Content, is_live: bool = False) -> rrb.Blueprint:
    """Lay out the bench and its log on the left; force, tool quality, curves over lift and proposals on the right."""
    scene = rrb.Spatial3DView(
        origin="cell",
        name=f"Bench; objects by the peak of their last grasp: dark 0, yellow {choose_full_force_n(content):g} N",
        eye_controls=place_bench_eye(*find_objects(content)),
        background=[255, 255, 255],
        line_grid=False,
    )
    log = rrb.TextLogView(
        origin="log",
        name="Log",
        columns=rrb.TextLogColumns(timeline_columns=["bench"], text_log_columns=["body"]),
    )
    notes = rrb.Tabs(log, rrb.TextDocumentView(origin="about", name="About"), active_tab=0)
    left = rrb.Vertical(scene, notes, row_shares=[3, 1])
    right = rrb.Tabs(_results_tab(), _proposals_tab(content.space.names), active_tab=0)
    playing: Literal["following", "playing"] = "following" if is_live else "playing"
    return lay_out(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.TimePanel(timeline="bench", state="collapsed", play_state=playing, playback_speed=PLAYBACK_SPEED),
    )


def _results_tab() -> rrb.Vertical:
    return rrb.Vertical(
        view_curves(),
        rrb.TimeSeriesView(
            origin="force",
            contents=["force/load_cell"],
            name="Force on the load cell (N), last minute",
            plot_legend=rrb.PlotLegend(visible=False),
            time_ranges=rrb.VisibleTimeRange(
                "bench",
                start=rrb.TimeRangeBoundary.cursor_relative(seconds=-60.0),
                end=rrb.TimeRangeBoundary.cursor_relative(),
            ),
        ),
        rrb.TimeSeriesView(
            origin="/",
            contents=["force/peak", "quality/**"],
            name="Peak of every grasp, and tool quality (N)",
            plot_legend=rrb.PlotLegend("LeftTop"),
            axis_x=_whole_time(),
        ),
        row_shares=[5, 3, 4],
        name="Results",
    )


def _whole_time() -> rrb.TimeAxis:
    """Return all of the time in which the bench worked, however far the cursor has come."""
    start, end = rrb.TimeRangeBoundary.absolute(seconds=0.0), rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end))


def _proposals_tab(names: Sequence[str]) -> rrb.Grid:
    views = [
        rrb.TimeSeriesView(
            origin=f"proposals/{name}",
            name=spell_name(name, with_unit=True),
            plot_legend=rrb.PlotLegend("LeftTop", visible=place == 0),
            axis_x=_whole_time(),
        )
        for place, name in enumerate(names)
    ]
    return rrb.Grid(*views, grid_columns=3, name="Proposals")


def describe(content: Content) -> str:
    """Describe what the recording shows, and the tools so far, as Markdown."""
    rows = "\n".join(
        f"| {t.label} | {t.kind} | {'' if t.quality_n is None else format(t.quality_n, '.2f')} | {t.n_objects} |"
        for t in choose_tools(content)
    )
    return (
        f"# {content.campaign.name or content.campaign.campaign_id}\n\nThe head goes from object to "
        "object; an object takes the colour of the peak force of its last grasp. Timeline `bench`: the time in which "
        "the bench worked, waits cut.\n\n"
        f"| tool | design | quality (N) | objects |\n|---|---|---|---|\n{rows}\n"
    )


def choose_tools(content: Content) -> list[Tool]:
    """Choose the best tool first, then the best of each other batch, in order."""
    measured = [t for t in content.tools if t.n_grasps > 0]
    batches = sorted({t.batch for t in measured})
    best_tools = [
        max((t for t in measured if t.batch == batch), key=lambda t: (t.is_complete, t.quality_n or 0.0))
        for batch in batches
    ]
    return sorted(best_tools, key=lambda t: (t is not content.best, t.batch, t.slot))
