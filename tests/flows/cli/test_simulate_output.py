"""Pictures and recording of a simulated grasp, and pictures of traces."""

import csv
import errno
import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from rerun.chunk import RrdReader

from fast.flows.cli.main import run
from fast.flows.cli.simulate_output import write_outputs, write_table
from fast.flows.report.grasp_frames import GraspFrames, five_instants
from fast.flows.report.slopes import peak_changes
from fast.flows.viewer.simulation import LONGEST_ARROW_MM, choose_arrow_mm_per_n
from fast.models.design.space import BEST_PUBLISHED
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup, GraspSimulation, Placement, Slope, Slopes
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.output.recording import SIDES, GraspRecording
from fast.models.simulation.tolerances import Tolerances
from fast.models.simulation.version import MeshSettings, SimulatorVersion

SPHERE, CUBE = get_object(1), get_object(30)
COARSE = SimulatorVersion(mesh=MeshSettings(edge_mm=10))
NO_SCATTER = [word for name in Tolerances.model_fields for word in ("--tolerance", f"{name}=0")]


@pytest.fixture(scope="module")
def grasp() -> tuple[GraspSimulation, GraspRecording]:
    recording = GraspRecording()
    return simulate_grasp(BEST_PUBLISHED, SPHERE, COARSE, recorder=recording.add), recording


def test_five_instants_are_in_order_and_where_they_say(grasp: tuple[GraspSimulation, GraspRecording]) -> None:
    result, recording = grasp
    instants = five_instants(recording, result.trace)
    times = [instant.right.time_s for instant in instants]
    assert times == sorted(times)
    assert len(set(times)) == 5
    assert [instant.right.phase for instant in instants] == ["closing"] * 3 + ["lift"] * 2
    assert instants[3].force_n == pytest.approx(result.peak_force_n)
    assert instants[4].right.pressure.size > 0


def test_cells_sum_to_the_contact_force(grasp: tuple[GraspSimulation, GraspRecording]) -> None:
    frame = five_instants(grasp[1], grasp[0].trace)[2].frames["left"]
    closed = frame.snapshot
    places, forces = frame.forces
    assert len(places) < len(closed.contact_points)
    sums = 2.0 * closed.scale * closed.contact_force.sum(axis=0)
    assert forces.sum(axis=0)[[0, 2]] == pytest.approx(sums[[0, 2]] * (-1.0, 1.0))  # the left finger is mirrored
    assert (frame.vertices[:, 0] < 1.0).all()


def test_longest_arrow_is_neither_lost_nor_larger_than_the_scene(grasp: tuple[GraspSimulation, GraspRecording]) -> None:
    frames = GraspFrames.of(grasp[1])
    forces = [frame.forces[1] for frame in frames.frames["right"] if frame.pressure_kpa.size]
    longest = choose_arrow_mm_per_n(frames) * max(float(np.linalg.norm(force, axis=1).max()) for force in forces)
    assert 0.4 * LONGEST_ARROW_MM <= longest <= LONGEST_ARROW_MM


def test_outputs_hold_every_step(grasp: tuple[GraspSimulation, GraspRecording], tmp_path: Path) -> None:
    result, recording = grasp
    files = write_outputs(tmp_path, BEST_PUBLISHED, SPHERE, Placement(), {"object_id": 1}, result, recording)
    assert [file.name for file in files] == ["result.json", "trace.csv", "trace.png", "grasp.png", "grasp.rrd"]
    for picture in files[2:4]:
        assert 0.02 < float((imread(picture)[:, :, :3].min(axis=2) < 0.9).mean()) < 0.6  # neither empty nor full
    rows: dict[str, int] = defaultdict(int)
    for chunk in RrdReader(files[4]).stream():
        rows[chunk.entity_path] += 0 if chunk.is_static else chunk.num_rows
    for side in ("left", "right"):
        assert rows[f"/cell/fingers/{side}/surface"] == 1 + len(recording.of("right"))  # as it approaches, first
        assert rows[f"/cell/fingers/{side}/contact_force"] == len(recording.of("right"))
    assert rows["/force/load_cell"] == len(result.trace.time_s)


def test_slopes_are_a_table_and_bars(grasp: tuple[GraspSimulation, GraspRecording], tmp_path: Path) -> None:
    result, recording = grasp
    force_n = result.trace.force_n
    walked_n = 2.0 * force_n
    walked_n[-2:] = np.nan
    by = {"friction": Slope("N", walked_n, 3.0, 0.1), "offset_z_mm": Slope("N/mm", -force_n, -1.0, 0.5, 0.5)}
    sloped = replace(result, slopes=Slopes(20.0, by, {}))
    files = write_outputs(tmp_path, BEST_PUBLISHED, SPHERE, Placement(), {"object_id": 1}, sloped, recording)
    table, picture = (file for file in files if file.stem == "slopes")
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert list(rows[0]) == ["time_s", "lift_mm", "friction (N)", "offset_z_mm (N/mm)"]
    found = [row["friction (N)"] for row in rows]
    assert [float(cell) for cell in found[:-2]] == pytest.approx(2.0 * force_n[:-2], rel=1e-4, abs=1e-4)
    assert found[-2:] == ["", ""]
    assert 0.02 < float((imread(picture)[:, :, :3].min(axis=2) < 0.9).mean()) < 0.6
    assert [change[0] for change in peak_changes(sloped.slopes)] == ["offset_z_mm", "friction"]


def test_the_peak_is_told_with_its_scatter(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["simulate", "--object", "1", "--set", "edge_mm=12", "--set", "max_lift_mm=5"]
    mount = ["--tolerance", "offset_z_mm=0", "--tolerance", "wall_offset_mm=0", "--tolerance", "closed_gap_mm=0.1"]
    assert run([*argv, *mount, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    peaks = []
    for gap in ("15.9", "16.1"):
        assert run([*argv, "--set", f"closed_gap_mm={gap}", *NO_SCATTER, "--json"]) == 0
        peaks.append(json.loads(capsys.readouterr().out)["peak_force_n"])
    both = abs(peaks[1] - peaks[0]) / 2
    assert (told["peak_sd_n"], told["sd_is_of"]) == (pytest.approx(both), "closed gap 0.1 mm")
    assert "slopes" not in told
    assert run([*argv, *mount]) == 0
    assert f"N (sd {both:.2f} N between prints and mountings: closed gap" in capsys.readouterr().out
    assert run([*argv, "--tolerance", "offset_z_mm=0,wall_offset_mm=0, closed_gap_mm=0.1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["peak_sd_n"] == told["peak_sd_n"]
    said_of = {"wall_offset_mm=-1": "must be at least 0", "walls=1": "unknown", "closed_gap_mm": "number"}
    for wrong, said in said_of.items():
        assert run([*argv, "--tolerance", wrong]) == 2
        assert said in capsys.readouterr().err


def test_slopes_are_printed_with_what_has_none(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["simulate", "--object", "1", "--set", "edge_mm=12", "--set", "max_lift_mm=5", *NO_SCATTER]
    assert run([*argv, "--along", "young_modulus_mpa, nu"]) == 0
    printed = capsys.readouterr().out
    assert run([*argv, "--along", "young_modulus_mpa", "--along", "nu"]) == 0
    tables = [text.partition("parameter")[2] for text in (printed, capsys.readouterr().out)]
    assert tables[0] == tables[1] != ""
    assert "N/MPa" in printed
    assert "slopes of the trace are good up to 5.0 mm of lift" in printed
    assert run([*argv, "--along", "rib_count"]) == 2
    assert "`rib_count` has no slope; slopes are by material (" in capsys.readouterr().err


def test_a_turned_object_and_the_left_finger_are_drawn_where_they_are(tmp_path: Path) -> None:
    placement, setup, recording = (
        Placement(yaw_deg=5.0),
        GraspSetup(closed_gap_mm=34, max_lift_mm=0.5),
        GraspRecording(),
    )
    result = simulate_grasp(BEST_PUBLISHED, CUBE, COARSE, setup, placement=placement, recorder=recording.add)
    right, left = (GraspFrames.of(recording).frames[side][-1] for side in SIDES)
    assert left.nodes == pytest.approx(right.nodes * np.array([-1.0, -1.0, 1.0]))  # not the mirror image
    assert np.ptp(left.nodes[:, 1]) > 0.9 * BEST_PUBLISHED.width_mm
    files = write_outputs(tmp_path, BEST_PUBLISHED, CUBE, placement, {"object_id": 30}, result, recording)
    turned = [
        chunk.to_record_batch().column("Transform3D:mat3x3").to_pylist()
        for chunk in RrdReader(files[4]).stream()
        if chunk.entity_path == "/cell/object"
    ]
    assert np.ravel(turned)[:2] == pytest.approx([np.cos(np.radians(5.0)), np.sin(np.radians(5.0))])


def test_simulate_takes_a_placement(capsys: pytest.CaptureFixture[str]) -> None:
    words = "simulate --object 32 --set edge_mm=10 --set closed_gap_mm=36 --set max_lift_mm=2 --set yaw_deg=5"
    assert run(words.split()) == 0
    assert "largest twist" in capsys.readouterr().out
    assert run([*words.split(), "--set", "offset_y_mm=60"]) == 1
    assert "is outside the fingers: with offset_y_mm 60" in capsys.readouterr().err


def test_simulate_takes_the_best_design_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    words = "simulate --design best --object 1 --set edge_mm=10 --set closed_gap_mm=36 --set max_lift_mm=2 --json"
    assert run(words.split()) == 0
    assert json.loads(capsys.readouterr().out)["design_id"] == BEST_PUBLISHED.design_id


def test_a_full_disk_leaves_the_older_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_table(tmp_path / "designs.csv", [{"name": "a", "mean_n": 1.5}, {"name": "b", "mean_n": None}])
    before = path.read_text()
    assert before == "name,mean_n\na,1.5\nb,\n"

    def fill(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.replace", fill)
    with pytest.raises(UsageError, match=r"--out `.*designs.csv` cannot be written: No space left on device"):
        write_table(path, [{"name": "c"}])
    assert [one.name for one in tmp_path.iterdir()] == ["designs.csv"]
    assert path.read_text() == before
