import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import trimesh
from rerun.chunk import RrdReader

from fast.flows.report.campaign.content import Content
from fast.flows.viewer.bench import place_bench_eye
from fast.flows.viewer.campaign import choose_full_force_n, choose_tools, find_objects, follow, write_recording
from fast.flows.viewer.design import find_edges, write_design_recording
from fast.flows.viewer.grasp import Clock, write_grasp_recording
from fast.flows.viewer.scene import build_fingers, draw_object, move_fingers
from fast.hardware.parts.layout import BenchLayout
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, GraspRow
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import UsageError
from fast.models.objects.catalogue import register
from fast.models.objects.own import object_of_mesh
from fast.models.records import GraspSetup, Trace
from fast.models.simulation.mesh.build import build_mesh
from fast.models.simulation.version import MeshSettings, SimulatorVersion
from tests.flows.synthetic_lake import Campaign, build


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    return build(Lake.open(tmp_path_factory.mktemp("lake") / "data", create=True), Campaign())


def rows_by_entity(path: Path) -> dict[str, int]:
    """Rows on timelines per entity; static data counts as none."""
    found: dict[str, int] = defaultdict(int)
    for chunk in RrdReader(path).stream():
        found[chunk.entity_path] += 0 if chunk.is_static else chunk.num_rows
    return found


def assert_verified(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "without error" in done.stdout + done.stderr


def test_campaign_shows_the_bench_at_work(lake, tmp_path):
    rows = rows_by_entity(write_recording(lake, "demo", tmp_path / "demo.rrd"))
    n_grasps = sum(1 for g in lake.records(GraspRow) if g.status == "ok")
    assert rows["/force/peak"] == n_grasps
    assert rows["/log"] == n_grasps + 6  # six tools were put on the head
    assert rows["/cell/head/right"] == 6
    assert rows["/cell/head"] == rows["/force/load_cell"] > 20 * n_grasps
    on_third = [g for g in lake.records(GraspRow, object_id=3) if g.status == "ok"]
    assert rows["/cell/objects/object_03"] == len(on_third) + 1  # the colours, and the one before all grasps
    assert rows["/cell/peaks/object_03"] == len(on_third)
    assert rows["/curves/lines/object_03"] == len(on_third)
    assert rows["/curves/tool"] == rows["/curves/lines"] == 6  # each tool begins with a clear plane
    assert rows["/quality/best"] == rows["/quality/tools"] == 6  # each tool once, when it leaves the head
    assert rows["/proposals/rib_angle_deg/printed"] == 6
    assert rows["/proposals/rib_angle_deg/simulated"] == 4


def test_force_on_the_bench_timeline_never_goes_back(lake, tmp_path):
    path = write_recording(lake, "demo", tmp_path / "demo.rrd")
    starts = [
        chunk.to_record_batch().column("bench").to_pylist()[0].total_seconds()
        for chunk in RrdReader(path).stream()
        if chunk.entity_path == "/force/load_cell" and not chunk.is_static
    ]
    assert len(starts) > 1
    assert len(set(starts)) == len(starts)


def test_live_follows_a_growing_lake_until_the_campaign_ends(tmp_path):
    lake = build(Lake.open(tmp_path / "lake", create=True), Campaign(n_measured_batches=0))
    states = iter([True, False])

    def is_running() -> bool:
        build(lake, Campaign())
        return next(states)

    told: list[str] = []
    path = tmp_path / "live.rrd"
    sizes: list[int] = []
    n_grasps = follow(lake, "demo", path, is_running, began=lambda: sizes.append(path.stat().st_size),
                      progress=told.append, poll_s=0.0)  # fmt: skip
    assert sizes[0] > 0  # a page that opens now has something to show
    assert n_grasps == sum(1 for g in lake.records(GraspRow) if g.status == "ok")
    assert told == [f"{n_grasps} grasps of demo"]
    assert rows_by_entity(path)["/force/peak"] == n_grasps


def test_campaign_without_measurements_is_still_a_recording(tmp_path):
    lake = build(Lake.open(tmp_path / "lake", create=True), Campaign(n_measured_batches=0))
    path = write_recording(lake, "demo", tmp_path / "empty.rrd")
    assert_verified(path)
    assert "/about" in rows_by_entity(path)


def test_grasp_shows_measured_and_simulated_force_and_moving_fingers(lake, tmp_path):
    grasp = next(g for g in lake.records(GraspRow) if g.status == "ok")
    path = write_grasp_recording(lake, grasp.grasp_id, tmp_path / "grasp.rrd", is_simulated=False)
    assert_verified(path)
    rows = rows_by_entity(path)
    n_samples = len(lake.trace(grasp.grasp_id).time_s)
    assert rows["/force/measured"] == rows["/lift/measured"] == rows["/cell/fingers/left"] == n_samples
    assert rows["/force/simulated_0"] > 0
    assert rows["/force/simulated_1"] > 0


def test_grasp_shows_the_fingers_that_the_simulator_deforms(lake, tmp_path, monkeypatch):
    coarse = SimulatorVersion(mesh=MeshSettings(edge_mm=10))
    monkeypatch.setattr("fast.flows.report.grasp_frames.find_newest_version", lambda *_: coarse)
    grasp = next(g for g in lake.records(GraspRow) if g.status == "ok" and g.object_id == 1)
    rows = rows_by_entity(write_grasp_recording(lake, grasp.grasp_id, tmp_path / "grasp.rrd"))
    assert rows["/cell/fingers/left/surface"] == rows["/cell/fingers/right/contact_force"] + 1 > 10  # one is at rest
    assert rows["/cell/fingers/left"] > 5  # on their way to the first touch


def test_simulated_times_are_stretched_until_both_lifts_agree():
    simulated = Trace(np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 0.0, 5.0, 10.0]), np.zeros(4))
    measured = Trace(np.array([0.0, 2.0, 3.0, 5.0, 7.0]), np.array([0.0, 0.0, 2.0, 6.0, 8.0]), np.zeros(5))
    moved = Clock.between(simulated, measured).moved(simulated)
    # Closing 1 s on 2 s; 5 mm lies three quarters of the way from 3 to 5 s; 10 mm is 2 mm on, at 5 s for 8 mm.
    np.testing.assert_allclose(moved.time_s, [0.0, 2.0, 4.5, 7.0 + 2.0 * 5.0 / 8.0])
    np.testing.assert_array_equal(moved.lift_mm, simulated.lift_mm)


def test_failed_or_unknown_grasps_are_one_sentence(lake, tmp_path):
    failed = next(g for g in lake.records(GraspRow) if g.status == "failed")
    with pytest.raises(UsageError, match=r"failed \(separation_not_found\), so there is nothing to show"):
        write_grasp_recording(lake, failed.grasp_id, tmp_path / "x.rrd")
    with pytest.raises(UsageError, match="There is no grasp `Knone`"):
        write_grasp_recording(lake, "Knone", tmp_path / "x.rrd")
    with pytest.raises(UsageError, match="There is no design `Dnone`"):
        write_design_recording(lake, "Dnone", tmp_path / "x.rrd")


def test_design_shows_two_fingers(lake, tmp_path):
    design_id = lake.records(GraspRow)[0].design_id
    path = write_design_recording(lake, design_id, tmp_path / "design.rrd")
    assert_verified(path)
    bodies = {name for name in rows_by_entity(path) if name.startswith("/cell/fingers/")}
    assert {f"/cell/fingers/{side}/{body}" for side in ("left", "right") for body in ("compliant", "rigid")} <= bodies


def test_design_shows_parts_mesh_and_the_tray_of_its_batch(lake, tmp_path):
    design_id = lake.records(GraspRow, batch=2)[0].design_id
    rows = rows_by_entity(write_design_recording(lake, design_id, tmp_path / "design.rrd"))
    assert {"/parts/compliant", "/parts/rigid", "/mesh/elements", "/mesh/clamped", "/tray/plate"} <= rows.keys()
    on_tray = {name.split("/")[2] for name in rows if name.startswith("/tray/B")}
    assert on_tray == {"B02T0", "B02T1", "B02T2"}
    assert {f"/tray/B02T0/{finger}_{body}" for finger in "ab" for body in ("compliant", "rigid")} <= rows.keys()


def test_labels_of_another_lab_that_cannot_be_marks_are_no_hindrance(lake, tmp_path, monkeypatch):
    design_id = lake.records(GraspRow)[0].design_id
    monkeypatch.setattr("fast.flows.viewer.design.tool_label", lambda batch, slot: f"rig {slot}")
    assert_verified(write_design_recording(lake, design_id, tmp_path / "design.rrd"))
    unprinted = BEST_PUBLISHED.model_copy(update={"rib_angle_deg": 1.0})
    lake.append([DesignRow.of(unprinted)], current_provenance("", 0))
    assert_verified(write_design_recording(lake, unprinted.design_id, tmp_path / "alone.rrd"))


def test_edges_of_a_mesh_are_those_of_its_elements():
    edges = find_edges(build_mesh(BEST_PUBLISHED, MeshSettings(edge_mm=10), full_width=True))
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert (edges[:, 0] < edges[:, 1]).all()


def test_unwritable_file_is_one_sentence(lake, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(UsageError, match="cannot be written"):
        write_recording(lake, "demo", tmp_path / "file" / "demo.rrd")


def test_fingers_hang_tips_down_with_their_faces_to_the_object():
    meshes = build_fingers(BEST_PUBLISHED)
    for side, sign in (("right", 1), ("left", -1)):
        corners = np.array(meshes[f"{side}/compliant"].vertex_positions.as_arrow_array().to_pylist())
        assert corners[:, 2].min() == pytest.approx(-BEST_PUBLISHED.height_mm, abs=1e-4)
        assert (sign * corners[:, 0]).min() == pytest.approx(0.0, abs=1e-4)
        assert np.ptp(corners[:, 1]) == pytest.approx(BEST_PUBLISHED.width_mm, abs=1e-4)


def test_a_mesh_of_ones_own_has_flat_faces_and_sharp_edges():
    box = trimesh.creation.box((20.0, 24.0, 30.0))
    obj = object_of_mesh("brick", box, "brick.stl")
    register(obj)
    drawn = draw_object(obj.object_id)
    assert drawn.vertex_normals is not None
    normals = np.array(drawn.vertex_normals.as_arrow_array().to_pylist())
    assert len(normals) == 6 * 4
    np.testing.assert_allclose(np.sort(np.abs(normals), axis=1), np.tile([0.0, 0.0, 1.0], (24, 1)), atol=1e-6)


def test_fingers_close_then_rise():
    setup = GraspSetup()
    trace = Trace(np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.0, 5.0]), np.zeros(4))
    places = move_fingers(BEST_PUBLISHED, setup, trace)
    # Design.md 5.1: the base hangs at H - 5, faces 70 mm apart when open and 16 mm when closed.
    np.testing.assert_allclose(places["right"][0], [35.0, 0.0, BEST_PUBLISHED.height_mm - 5.0])
    np.testing.assert_allclose(places["right"][-1], [8.0, 0.0, BEST_PUBLISHED.height_mm])
    np.testing.assert_allclose(places["left"][:, 0], -places["right"][:, 0])


def test_campaign_knows_its_objects_its_forces_and_its_leading_tools(lake):
    content = Content.load(lake, "demo")
    assert find_objects(content)[1] == [0, 1, 2, 3]
    peak_n = max(g.peak_force_n for g in lake.records(GraspRow) if g.status == "ok")
    assert peak_n <= choose_full_force_n(content) <= max(5.0, 2.0 * peak_n)
    assert [t.batch for t in choose_tools(content)] == [2, 1]
    assert choose_tools(content)[0] is content.best


@pytest.mark.parametrize("objects", [[0], [2, 6, 14, 18, 24, 28, 30, 32], list(range(36))])
def test_all_objects_are_in_view(objects):
    layout = BenchLayout()
    eye = place_bench_eye(layout, objects)
    place, target = (
        np.array(getattr(eye, name).as_arrow_array().to_pylist()[0]) for name in ("position", "look_target")
    )
    ahead = (target - place) / np.linalg.norm(target - place)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    for number in objects:
        away = np.array([*layout.object_xy_mm(number), 60.0]) - place
        depth = away @ ahead
        aside = away @ right / np.linalg.norm(right)
        upwards = away @ np.cross(right / np.linalg.norm(right), ahead)
        assert depth > 0
        assert np.degrees(np.arctan2(abs(upwards), depth)) < 55 / 2
        assert abs(aside) / depth < 1.3 * np.tan(np.radians(55 / 2))
