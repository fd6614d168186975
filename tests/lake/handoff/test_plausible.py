"""A hand-off folder that cannot be true is refused in words; a dry run and a second import say what they wrote."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fast.lake.handoff.export_folder import export_handoff
from fast.lake.handoff.import_folder import Origin, import_handoff
from fast.lake.handoff.samples import check_samples
from fast.lake.handoff.tables import HandoffError, Reader
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ObjectRow
from fast.models.errors import UsageError
from fast.models.objects import catalogue
from fast.models.objects.own import object_of_mesh
from fast.models.records import Trace
from tests.flows.cli.cli_lakes import Fast
from tests.lake.handoff.handoff_folder import PROVENANCE, good_folder, read_csv, write_csv


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return good_folder(tmp_path / "their-lab")


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake.open(tmp_path / "lake", create=True)


def change(folder: Path, file: str, column: str, values: dict[int, object]) -> None:
    rows = read_csv(folder / file)
    write_csv(folder / file, [row | ({column: values[i]} if i in values else {}) for i, row in enumerate(rows)])


def scale(folder: Path, column: str, factor: float) -> None:
    rows = read_csv(folder / "traces.csv")
    write_csv(folder / "traces.csv", [row | {column: float(row[column]) * factor} for row in rows])


WRONG = {
    "year 1": (lambda f: change(f, "grasps.csv", "started_at", {0: "0001-01-01T00:00:00"}), "must be from 2000 to now"),
    "year 9999": (lambda f: change(f, "grasps.csv", "started_at", {0: "9999-12-31T00:00:00"}), "must be from 2000"),
    "mN": (lambda f: scale(f, "force_n", 1000.0), "must be at most 2000 N in size; look at unit"),
    "downwards": (lambda f: scale(f, "force_n", -1.0), "the pull is counted downwards in the whole file: 2 of 2"),
    "um": (lambda f: scale(f, "lift_mm", 1000.0), "must be at most 1000 mm in size"),
    "ms": (lambda f: scale(f, "time_s", 10_000.0), "slower than 0.05 mm/s; times are in s, not ms, lifts in mm"),
    "huge": (lambda f: change(f, "traces.csv", "lift_mm", {2: "1e308"}), "must be at most 1000 mm in size"),
    "back": (lambda f: change(f, "traces.csv", "lift_mm", {1: "30", 4: "40"}), "must not fall by more than 2 mm"),
    "object": (lambda f: change(f, "grasps.csv", "object_id", {0: "36"}), "must be 0 to 35, or an own object"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_true_is_refused_and_nothing_is_written(folder: Path, lake: Lake, name: str) -> None:
    damage, words = WRONG[name]
    damage(folder)
    with pytest.raises(HandoffError, match=words):
        import_handoff(lake, folder, PROVENANCE)
    assert lake.rows(GraspRow) == []


def test_fingers_may_push_the_object_down_until_they_leave_it(folder: Path, lake: Lake) -> None:
    rows = read_csv(folder / "traces.csv")
    push_n = {0.0: "-6", 0.1: "-5.5", 1 / 3: "-2", 2.0: "0.02"}  # by lift: a push only fades
    write_csv(folder / "traces.csv", [row | {"force_n": push_n[float(row["lift_mm"])]} for row in rows])
    import_handoff(lake, folder, PROVENANCE)
    assert [row["peak_force_n"] for row in lake.rows(GraspRow)] == [0.02, 0.02]


def test_a_pull_counted_downwards_after_a_push_is_refused(folder: Path, lake: Lake) -> None:
    rows = read_csv(folder / "traces.csv")
    force_n = {0.0: "6", 0.1: "5.5", 1 / 3: "0.5", 2.0: "-9"}  # by lift: the peak is 5.5 N, the work -6 mJ
    write_csv(folder / "traces.csv", [row | {"force_n": force_n[float(row["lift_mm"])]} for row in rows])
    with pytest.raises(HandoffError, match="the pull is counted downwards"):
        import_handoff(lake, folder, PROVENANCE)
    assert lake.rows(GraspRow) == []


def test_a_mirrored_file_is_named_once_also_where_most_of_its_pulls_look_like_pushes(tmp_path: Path) -> None:
    lift_mm = np.linspace(0.0, 10.0, 40)
    pull = Trace(lift_mm / 5.0, lift_mm, -np.sin(lift_mm / 10.0 * np.pi) * 9.0)
    fading = Trace(lift_mm / 5.0, lift_mm, -4.0 * (1.0 - lift_mm / 10.0))
    for mirrored in ([pull, *[fading] * 3], [fading] * 8):
        reader = Reader(tmp_path)
        real = {"fidelity": "real", "status": "ok", "reason": ""}
        traces = {f"G{place}": ([1] * 40, trace) for place, trace in enumerate(mirrored)}
        check_samples(reader, {key: (place, real) for place, key in enumerate(traces)}, traces)
        (fault,) = reader.faults
        assert f"{len(mirrored)} of {len(mirrored)} measured grasps have negative work" in str(fault)
    reader = Reader(tmp_path)
    upright = Trace(pull.time_s, lift_mm, -pull.force_n)
    traces = {f"G{place}": ([1] * 40, trace) for place, trace in enumerate([fading, upright, upright, pull])}
    check_samples(reader, {key: (place, real) for place, key in enumerate(traces)}, traces)
    assert ["G3" in str(fault) for fault in reader.faults] == [True], "one of them alone"


@pytest.mark.parametrize("n_down", [1, 2])
def test_one_in_twenty_simulated_fingers_may_push_alone(tmp_path: Path, n_down: int) -> None:
    """So do some of FAST's own, which it must read back; of another sign are many."""
    lift_mm = np.linspace(0.0, 10.0, 40)
    up = Trace(lift_mm / 5.0, lift_mm, np.sin(lift_mm / 10.0 * np.pi) * 9.0)
    down = Trace(lift_mm / 5.0, lift_mm, -up.force_n)
    traces = {f"S{place}": ([1] * 40, down if place < n_down else up) for place in range(20)}
    reader = Reader(tmp_path)
    check_samples(reader, {key: (place, {"fidelity": "sim"}) for place, key in enumerate(traces)}, traces)
    assert len(reader.faults) == (0 if n_down == 1 else 2)


def test_a_pull_may_end_in_a_kick_that_is_larger_than_itself(folder: Path, lake: Lake) -> None:
    rows = read_csv(folder / "traces.csv")
    tops = {row["grasp_id"]: row for row in rows}
    pulled = [(40.0, 7.0), (40.1, -20.0), (40.2, 0.0)]  # mm, N
    more = [
        row | {"time_s": lift_mm / 5.0, "lift_mm": lift_mm, "force_n": force_n}
        for row in tops.values()
        for lift_mm, force_n in pulled
    ]
    write_csv(folder / "traces.csv", [*rows, *more])
    import_handoff(lake, folder, PROVENANCE)
    assert [row["peak_force_n"] for row in lake.rows(GraspRow)] == [8.0, 8.0]


def test_a_bench_may_hold_at_the_top_for_as_long_as_it_likes(folder: Path, lake: Lake) -> None:
    rows = read_csv(folder / "traces.csv")
    tops = {row["grasp_id"]: row for row in rows}  # the last sample of each
    held = [
        row | {"time_s": float(row["time_s"]) + 600.0, "lift_mm": float(row["lift_mm"]) + 0.001}  # an encoder's noise
        for row in tops.values()
    ]
    write_csv(folder / "traces.csv", [*rows, *held])
    import_handoff(lake, folder, PROVENANCE)
    assert len(lake.rows(GraspRow)) > 0


def test_a_grasp_that_is_there_twice_is_named(folder: Path, lake: Lake) -> None:
    rows = [row for row in read_csv(folder / "grasps.csv") if row["fidelity"] == "real"]
    assert len(rows) >= 2
    twin = {name: rows[0][name] for name in ("tool_id", "object_id", "repeat", "design_id")}
    every = read_csv(folder / "grasps.csv")
    write_csv(folder / "grasps.csv", [row | (twin if row == rows[1] else {}) for row in every])
    with pytest.raises(HandoffError, match="is there twice for this tool and object, first in row"):
        import_handoff(lake, folder, PROVENANCE)


@pytest.mark.parametrize("name", ["../../x", "/etc", "a/b", ".hidden", "", "x" * 101, "a\0b", "a\nb"])
def test_a_campaign_whose_name_leaves_the_folder_is_refused(folder: Path, lake: Lake, name: str) -> None:
    with pytest.raises(UsageError, match="cannot be the name of a campaign; nothing was written"):
        import_handoff(lake, folder, PROVENANCE, Origin(campaign_id=name or " "))
    assert lake.rows(GraspRow) == []


def test_what_is_printed_is_what_was_written(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fast, lake = Fast(capsys), tmp_path / "new"
    dry = fast("lake", "import", folder, "--lake", lake, "--dry-run")
    assert dry.out.startswith("nothing was written (--dry-run); it would be: ")
    assert not lake.exists()
    first = fast("lake", "import", folder, "--lake", lake, "--json").json
    assert first["n_real"] + first["n_sim"] == 4
    assert first["n_known"] == 0
    again = fast("lake", "import", folder, "--lake", lake)
    assert again.out.startswith("imported 0 designs, 0 measured grasps, 0 simulated grasps, 0 samples")
    assert again.out.endswith("; 4 grasps were there already\n")
    other = fast("lake", "import", folder, "--lake", lake, "--campaign", "other")
    there = f"; 4 grasps were there already, of the campaign import-{folder.name}, and stay there; if another lab "
    assert other.out.endswith(f"{there}measured them anew, say who with --lab, else give them other ids\n")
    assert "cannot be the name" in fast.refused(
        "lake", "import", folder, "--lake", tmp_path / "x", "--campaign", "../x"
    )
    assert not (tmp_path / "x").exists()


def test_how_grasps_were_made_may_be_told(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fast, lake = Fast(capsys), tmp_path / "new"
    fast("lake", "import", folder, "--lake", lake, "--set", "closed_gap_mm=30", "--set", "tip_below_mm=0")
    (gaps,) = Lake.open(lake).query("SELECT DISTINCT setup_json->>'closed_gap_mm' AS mm FROM grasps").to_pylist()
    assert float(gaps["mm"]) == 30.0
    assert "closed_gap_mm" in fast.refused("lake", "import", folder, "--lake", lake, "--set", "closed_gap_mm=900")
    assert "unknown key `gap`" in fast.refused("lake", "import", folder, "--lake", lake, "--set", "gap=3")


def test_own_objects_go_along(folder: Path, lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = object_of_mesh("ball", trimesh.creation.icosphere(1, 15.0), "ball.stl")
    lake.append([ObjectRow.of(ball)], PROVENANCE)
    change(folder, "grasps.csv", "object_id", {0: ball.object_id})
    import_handoff(lake, folder, PROVENANCE)
    export_handoff(lake, tmp_path / "out", traces="csv")
    lake.close()
    monkeypatch.setattr(catalogue, "_OWN", {})
    other = Lake.open(tmp_path / "other", create=True)
    import_handoff(other, tmp_path / "out", PROVENANCE)
    (row,) = [row for row in other.records(ObjectRow) if row.shape is not None]
    assert row.own_object == ball
    entries = json.loads((tmp_path / "out" / "objects.json").read_text())
    for values, words in (
        ({"object_id": 5000}, "is not the number of this shape"),
        ({"shape": "{}"}, "cannot be read; export it again"),
        ({"shape": entries[0]["shape"][:-9] + '"}'}, "cannot be read|is not the number"),
    ):
        (tmp_path / "out" / "objects.json").write_text(json.dumps([entries[0] | values]))
        with pytest.raises(HandoffError, match=words):
            import_handoff(Lake.open(tmp_path / "third", create=True), tmp_path / "out", PROVENANCE)
