"""A campaign on one timeline, `bench`: the head on its way, its force, objects coloured by it, proposals.

`bench` is the time in which the bench worked: each grasp follows the one before it by as long as it really did, but
waits for a print are cut, and grasps of a bench in lockstep, whose clock stands still, last as long as their traces.
"""

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
import rerun as rr
from matplotlib import colormaps

from fast.flows.report.campaign.queries import literal
from fast.flows.report.style import BEST, COMPLIANT, FIRST, INK, MUTED, OBJECT
from fast.flows.viewer.bench import build_head, send_bench
from fast.flows.viewer.curves import Curves
from fast.flows.viewer.scene import draw_object, flatten_mesh, rgb
from fast.flows.viewer.stream import read_design
from fast.hardware.parts.layout import BenchLayout
from fast.lake.store import Lake
from fast.lake.tables.campaign import design_of_columns
from fast.models.design.space import FIN_RAYS, DesignSpace
from fast.models.errors import UsageError
from fast.models.ids import tool_label
from fast.models.records import GraspSetup

KEEP_EVERY = 16  # of the readings at 80 a second
LONGEST_WAIT_S = 5.0
FORCE_COLOURS = "viridis"
LABEL_ABOVE_MM = 75.0  # over an object's bottom

_TOOLS = """
SELECT tool_id, max((sequence, created_at)) AS newest FROM grasps
WHERE campaign_id = {campaign} AND status = 'ok' GROUP BY tool_id ORDER BY min("order"), min(started_at), tool_id"""
_GRASPS = f"""
SELECT grasp_id, tool_id, batch, slot, design_id, object_id, object_name, repeat, setup_id, started_at, peak_force_n,
       time_s[1:-:{KEEP_EVERY}] AS time_s, lift_mm[1:-:{KEEP_EVERY}] AS lift_mm, force_n[1:-:{KEEP_EVERY}] AS force_n
FROM grasp_traces WHERE tool_id = {{tool}} AND status = 'ok'
ORDER BY "order", started_at, grasp_id"""
_PROPOSALS = """
SELECT p.proposal_id, p.fidelity, p.created_at, d.* FROM proposals p JOIN designs d USING (design_id)
WHERE p.campaign_id = {campaign} ORDER BY p.sequence, p.created_at, p.proposal_id"""


class BenchTimeline:
    """Sends what a lake has of a campaign to a recording; asked again, only what is new.

    `objects` are those that its tools shall meet, on their places of `layout`; `full_n` is the force of the lightest
    colour and of the curves' top. `space`: of the designs.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        lake: Lake,
        campaign_id: str,
        layout: BenchLayout,
        objects: Sequence[int],
        full_n: float,
        space: DesignSpace = FIN_RAYS,
    ) -> None:
        self._space = space
        self._stream, self._lake, self._campaign = stream, lake, literal(campaign_id)
        self._layout, self._objects, self._full_n = layout, objects, full_n
        self._curves = Curves(stream, objects, full_n)
        self._tips_mm = self._layout.mount_height_mm - GraspSetup().tip_below_mm
        self._sent: set[str] = set()
        self._n_grasps = 0
        self._drawn: set[int] = set()
        self._newest: dict[str, Any] = {}
        self._peaks: dict[str, dict[int, list[float]]] = {}
        self._clock_s = 0.0
        self._last_start: datetime | None = None
        self._bench_times: list[tuple[datetime, float]] = []
        self._lasted_s = 0.0
        self._tool_id, self._label = "", ""
        self._qualities: dict[str, float] = {}
        self._send_names()
        send_bench(stream, self._layout, objects)
        for object_id in objects:
            self._draw_object(object_id)

    @property
    def n_grasps(self) -> int:
        """Grasps sent so far."""
        return self._n_grasps

    def update(self) -> int:
        """Send grasps and proposals that were not sent before; returns how many grasps."""
        before = self.n_grasps
        for tool in self._lake.query(_TOOLS.format(campaign=self._campaign)).to_pylist():
            if self._newest.get(tool["tool_id"]) == tool["newest"]:
                continue
            self._newest[tool["tool_id"]] = tool["newest"]
            for row in self._lake.query(_GRASPS.format(tool=literal(tool["tool_id"]))).to_pylist():
                if row["grasp_id"] not in self._sent:
                    self._sent.add(row["grasp_id"])
                    self._n_grasps += 1
                    self._send_grasp(row)
        self._send_quality()
        self._send_proposals()
        return self.n_grasps - before

    def _send_names(self) -> None:
        points = {"force/peak": ("peak of a grasp", FIRST, 3.0), "quality/tools": ("tool", BEST, 6.0)}
        for entity, (name, colour, size) in points.items():
            look = rr.SeriesPoints(names=name, colors=rgb(colour), markers="circle", marker_sizes=size)
            self._stream.log(entity, look, static=True)
        self._stream.log("force/load_cell", rr.SeriesLines(names="load cell", colors=rgb(BEST)), static=True)
        steps = rr.SeriesLines(names="best so far", colors=rgb(INK), interpolation_mode="StepAfter")
        self._stream.log("quality/best", steps, static=True)
        for name in self._space.names:
            for fidelity, colour, size in (("simulated", MUTED, 2.5), ("printed", BEST, 5.0)):
                look = rr.SeriesPoints(names=fidelity, colors=rgb(colour), markers="circle", marker_sizes=size)
                self._stream.log(f"proposals/{name}/{fidelity}", look, static=True)

    def _send_grasp(self, row: Mapping[str, Any]) -> None:
        """Send one grasp: the head over its object, the force as it is read, the colour of the object, the words."""
        times = np.asarray(row["time_s"], dtype=float)
        start = self._start_of(row["started_at"], float(times[-1]) if times.size else 0.0)
        if row["tool_id"] != self._tool_id:
            self._mount(row, start)
        self._draw_object(row["object_id"])
        bench = [rr.TimeColumn("bench", duration=start + times)]
        x, y = self._layout.object_xy_mm(row["object_id"])
        z = self._tips_mm + np.asarray(row["lift_mm"], dtype=float)
        places = np.column_stack([np.full_like(z, x), np.full_like(z, y), z])
        self._stream.send_columns("cell/head", bench, rr.Transform3D.columns(translation=places))
        self._stream.send_columns("force/load_cell", bench, rr.Scalars.columns(scalars=row["force_n"]))
        self._at(self._clock_s)
        self._stream.log("force/peak", rr.Scalars(row["peak_force_n"]))
        self._curves.add(row)
        self._colour_object(row["object_id"], (x, y), row["peak_force_n"])
        where = f"{row['object_name'] or 'object'} ({row['object_id']}), repeat {row['repeat']}"
        words = f"{self._label}  {where}: {row['peak_force_n']:.1f} N"
        self._stream.log("log", rr.TextLog(words, level=rr.TextLogLevel.INFO))
        self._peaks.setdefault(row["tool_id"], {}).setdefault(row["object_id"], []).append(row["peak_force_n"])

    def _colour_object(self, object_id: int, place: tuple[float, float], peak_n: float) -> None:
        """Show the peak of an object's last grasp, as its colour and in figures above it."""
        colour = colormaps[FORCE_COLOURS](np.clip(peak_n / self._full_n, 0.0, 1.0))
        self._stream.log(f"cell/objects/object_{object_id:02d}", rr.Mesh3D.from_fields(albedo_factor=colour))
        above = [*place, self._layout.mount_height_mm + LABEL_ABOVE_MM]
        figures = rr.Points3D([above], labels=[f"{peak_n:.1f} N"], show_labels=True, radii=0.1, colors=rgb(INK))
        self._stream.log(f"cell/peaks/object_{object_id:02d}", figures)

    def _start_of(self, started_at: datetime | None, lasts_s: float) -> float:
        """Return where a grasp begins on the timeline; move the clock to its end."""
        wait = 1.0
        if started_at is not None and self._last_start is not None:
            since = (started_at - self._last_start).total_seconds() - self._lasted_s
            wait = min(max(since, 0.5), LONGEST_WAIT_S)
        start = self._clock_s + wait
        self._clock_s, self._lasted_s, self._last_start = start + lasts_s, lasts_s, started_at
        if started_at is not None:
            self._bench_times.append((started_at, start))
        return start

    def _mount(self, row: Mapping[str, Any], start: float) -> None:
        """Mount another tool on the head."""
        self._send_quality()
        self._tool_id, self._label = row["tool_id"], _label_of(row)
        self._at(start - 0.4)
        for name, mesh in build_head(read_design(self._lake, row["design_id"])):
            self._stream.log(f"cell/head/{name}", flatten_mesh(mesh, MUTED if name == "head" else COMPLIANT))
        self._curves.start(self._label)
        self._stream.log("log", rr.TextLog(f"{self._label} on the head", level=rr.TextLogLevel.INFO))

    def _draw_object(self, object_id: int) -> None:
        """Draw the object in its place on the table, the first time that it is met."""
        if object_id in self._drawn:
            return
        self._drawn.add(object_id)
        try:
            place = (*self._layout.object_xy_mm(object_id), self._layout.mount_height_mm)
            mesh = draw_object(object_id, place, None)
        except UsageError:
            return  # another lab's object, of which only the number is known
        entity = f"cell/objects/object_{object_id:02d}"
        self._stream.log(entity, mesh, static=True)
        self._at(0.0)
        self._stream.log(entity, rr.Mesh3D.from_fields(albedo_factor=rgb(OBJECT)))

    def _send_quality(self) -> None:
        """Send the quality of the tool on the head, if it has met every object; and the best of the campaign."""
        peaks = self._peaks.get(self._tool_id, {})
        if not peaks or not peaks.keys() >= set(self._objects):
            return
        quality = float(np.mean([np.mean(values) for values in peaks.values()]))
        if self._qualities.get(self._tool_id) == quality:
            return
        self._qualities[self._tool_id] = quality
        self._at(self._clock_s)
        self._stream.log("quality/tools", rr.Scalars(quality))
        self._stream.log("quality/best", rr.Scalars(max(self._qualities.values())))

    def _send_proposals(self) -> None:
        """Send the nine parameters of every proposal, at the time at which it was made."""
        rows = self._lake.query(_PROPOSALS.format(campaign=self._campaign)).to_pylist()
        fresh = [row for row in rows if row["proposal_id"] not in self._sent]
        self._sent.update(row["proposal_id"] for row in fresh)
        for fidelity, name in (("sim", "simulated"), ("real", "printed")):
            chosen = [row for row in fresh if row["fidelity"] == fidelity]
            if not chosen:
                continue
            moments = [rr.TimeColumn("bench", duration=self._moments(chosen))]
            space = self._space
            values = space.lower + space.to_unit([design_of_columns(row) for row in chosen]) * (
                space.upper - space.lower
            )
            for parameter, column in zip(space.names, values.T, strict=True):
                self._stream.send_columns(f"proposals/{parameter}/{name}", moments, rr.Scalars.columns(scalars=column))

    def _moments(self, rows: Sequence[Mapping[str, Any]]) -> np.ndarray:
        """Return the times on `bench` of the moments at which rows were written."""
        written = np.array([row["created_at"].timestamp() for row in rows])
        if not self._bench_times:
            return np.zeros(len(rows))
        known = np.array([(at.timestamp(), seconds) for at, seconds in self._bench_times])
        return np.interp(written, known[:, 0], known[:, 1])

    def _at(self, seconds: float) -> None:
        self._stream.set_time("bench", duration=max(seconds, 0.0))


def _label_of(row: Mapping[str, Any]) -> str:
    known = row["batch"] is not None and row["slot"] is not None
    return tool_label(row["batch"], row["slot"]) if known else str(row["tool_id"])
