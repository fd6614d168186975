"""Everything that a grasp is survives an export: bench, setup, failures, told peaks, measured tools, material lots."""

from pathlib import Path

import pytest

from fast.lake.handoff.export_folder import export_handoff
from fast.lake.handoff.import_folder import Origin, import_handoff
from fast.lake.handoff.tables import HandoffError
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ToolRow
from fast.lake.tables.material import MaterialRow
from fast.lake.tables.requests import setup_columns
from fast.models.design.space import BEST_PUBLISHED
from fast.models.material import MaterialMeasurement
from fast.models.records import GraspSetup, Placement
from tests.lake.handoff.handoff_folder import PROVENANCE, good_folder, read_csv, write_csv

SETUP = GraspSetup(closed_gap_mm=30.0, tip_below_mm=0.0, dwell_s=2.0)
HOW = setup_columns(SETUP, Placement(offset_x_mm=1.5, offset_y_mm=-0.5, yaw_deg=3.0))


@pytest.fixture
def full(lake: Lake, small_rows, make_grasp) -> Lake:
    tool = ToolRow(
        tool_id="c1/B01T0", campaign_id="c1", batch=1, slot=0, design_id=BEST_PUBLISHED.design_id, status="printed",
        operator="ada", material_lot="A30-7", measured_front_thickness_mm=2.45, hardness_shore_a=31.5,
        confirmed_by="person",
    )  # fmt: skip
    modulus = MaterialMeasurement(value=0.9, unit="MPa", sd=0.05, n=5, method="ISO 37", source="lab book 12")
    told, _ = make_grasp(object_id=4, bench="pull-tester", peak_force_n=12.25, work_j=None)
    failed, _ = make_grasp(object_id=5, status="failed", reason="no air", peak_force_n=None, work_j=None)
    rows = [
        *make_grasp(world_hash="ab12cd", lab="turin", request_id="r-1", tare_force_n=1.75, **HOW),
        *make_grasp(object_id=5, repeat=1, attempt=1, **HOW),
        told.model_copy(update={"initial_force_n": None}),
        failed.model_copy(update={"initial_force_n": None}),
        tool,
        MaterialRow.of("A30-7", "young_modulus", modulus),
    ]
    lake.append([*[row for row in small_rows if not isinstance(row, ToolRow)], *rows], PROVENANCE)
    return lake


def test_what_was_measured_comes_back_as_it_was(full: Lake, tmp_path: Path) -> None:
    export_handoff(full, tmp_path / "out")
    other = Lake.open(tmp_path / "other", create=True)
    import_handoff(other, tmp_path / "out", PROVENANCE, Origin(source="them"))
    # `setup_id` says how a grasp was made; its JSON may write 16 as 16.0. `software` is empty in the lake that made it.
    kept = set(GraspRow.model_fields) - {"campaign_id", "details_json", "setup_json", "software", "fidelity"}
    before, after = (
        {row.grasp_id: row.model_dump(include=kept) for row in lake.records(GraspRow)} for lake in (full, other)
    )
    usual = GraspRow.model_construct().model_dump() | {"repeat": 0, "status": "ok", "bench": "virtual"}
    empty = {name for name in kept if all(row[name] == usual.get(name) for row in before.values())}
    assert empty == set(), "a column that no grasp of this lake has: give it one, so that its loss is seen"
    changed = {i: {n: (v, after[i][n]) for n, v in row.items() if after[i][n] != v} for i, row in before.items()}
    assert {i: names for i, names in changed.items() if names} == {}
    assert set(after) == set(before)
    assert {row["bench"] for row in after.values()} == {"virtual", "pull-tester"}
    assert {row.software for row in other.records(GraspRow)} == {f"fast-gripper-lab {PROVENANCE.code_version}"}
    (tool,) = other.records(ToolRow)
    assert (tool.material_lot, tool.measured_front_thickness_mm, tool.hardness_shore_a) == ("A30-7", 2.45, 31.5)
    assert (tool.operator, tool.confirmed_by) == ("ada", "auto")
    assert other.records(MaterialRow) == full.records(MaterialRow)


def test_an_export_of_an_import_is_the_same_folder(full: Lake, tmp_path: Path) -> None:
    export_handoff(full, tmp_path / "out", traces="csv")
    other = Lake.open(tmp_path / "other", create=True)
    import_handoff(other, tmp_path / "out", PROVENANCE, Origin(source="them"))
    export_handoff(other, tmp_path / "again", traces="csv")
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert files == ["designs.csv", "grasps.csv", "materials.csv", "tools.csv", "traces.csv"]
    assert {name: (tmp_path / "again" / name).read_bytes() for name in files} == {
        name: (tmp_path / "out" / name).read_bytes() for name in files
    }


def test_peaks_alone_need_no_traces_file(lake: Lake, small_rows, make_grasp, tmp_path: Path) -> None:
    told, _ = make_grasp(bench="pull-tester", peak_force_n=12.25, work_j=None, initial_force_n=None)
    lake.append([*small_rows, told], PROVENANCE)
    export_handoff(lake, tmp_path / "out")
    assert not list((tmp_path / "out").glob("traces.*"))
    other = Lake.open(tmp_path / "other", create=True)
    assert import_handoff(other, tmp_path / "out", PROVENANCE, Origin(source="them")).n_samples == 0
    assert [row.peak_force_n for row in other.records(GraspRow)] == [12.25]


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("status", "lost", "must be ok or failed, or empty for ok"),
        ("status", "failed", "must say why the grasp failed"),
        ("bench", "../x", "must be virtual, real, or a name"),
        ("world_hash", "no hash", "must be a hash of letters and digits"),
        ("peak_force_n", "1e9", "must be a number from -5 to 2000 N"),
        ("attempt", "-1", "must be an integer from 0 to 1000"),
        ("lab", "The Lab", "must be a name of at most 41 of a-z"),
    ],
)
def test_a_wrong_end_of_a_grasp_is_named(tmp_path: Path, lake: Lake, column: str, value: str, words: str) -> None:
    folder = good_folder(tmp_path / "their-lab")
    rows = read_csv(folder / "grasps.csv")
    extra = {"status": "", "reason": "", "lab": "", "bench": "", "world_hash": "", "peak_force_n": "", "attempt": ""}
    write_csv(folder / "grasps.csv", [row | extra | ({column: value} if i == 0 else {}) for i, row in enumerate(rows)])
    with pytest.raises(HandoffError, match=words):
        import_handoff(lake, folder, PROVENANCE)


def test_a_failed_grasp_needs_a_reason_though_the_column_is_missing(tmp_path: Path, lake: Lake) -> None:
    folder = good_folder(tmp_path / "their-lab")
    rows = read_csv(folder / "grasps.csv")
    write_csv(folder / "grasps.csv", [row | {"status": "failed" if i == 0 else ""} for i, row in enumerate(rows)])
    with pytest.raises(HandoffError, match="must say why the grasp failed"):
        import_handoff(lake, folder, PROVENANCE)


@pytest.mark.parametrize(
    ("name", "row", "words"),
    [
        ("tools.csv", {"tool_id": "lab/B02T4", "design_id": "mine-1", "hardness_shore_a": "soft"}, "must be a number"),
        ("tools.csv", {"tool_id": "", "design_id": "mine-1"}, "must not be empty"),
        (
            "materials.csv",
            {"lot": "A", "quantity": "x", "value": "n", "unit": "MPa", "method": "m", "source": "s"},
            "value",
        ),
    ],
)
def test_a_wrong_tool_or_lot_is_named(tmp_path: Path, lake: Lake, name: str, row: dict, words: str) -> None:
    folder = good_folder(tmp_path / "their-lab")
    write_csv(folder / name, [row])
    with pytest.raises(HandoffError, match=words):
        import_handoff(lake, folder, PROVENANCE)


def test_a_lab_is_given_to_grasps_without_one_and_stands_in_their_ids(tmp_path: Path, lake: Lake) -> None:
    folder = good_folder(tmp_path / "their-lab")
    rows = read_csv(folder / "grasps.csv")
    labs = ("", "turin", "", "")
    write_csv(folder / "grasps.csv", [row | {"lab": lab} for row, lab in zip(rows, labs, strict=True)])
    for n_new in (2, 0):  # importing again changes nothing
        assert import_handoff(lake, folder, PROVENANCE, Origin(lab="delft")).n_real == n_new
    found = {row.grasp_id: row.lab for row in lake.records(GraspRow)}
    assert found == {"delft.a": "delft", "b": "turin"}
    export_handoff(lake, tmp_path / "out")
    exported = {row["grasp_id"]: row["lab"] for row in read_csv(tmp_path / "out" / "grasps.csv")}
    assert exported == {"delft.a": "delft", "b": "turin", "s": "", "t": ""}


def test_two_labs_may_use_the_same_ids(tmp_path: Path, lake: Lake) -> None:
    folder = good_folder(tmp_path / "their-lab")
    import_handoff(lake, folder, PROVENANCE, Origin(lab="delft"))
    table = read_csv(folder / "traces.csv")
    write_csv(folder / "traces.csv", [row | {"force_n": 1.1 * float(row["force_n"])} for row in table])
    grasps = [row for row in read_csv(folder / "grasps.csv") if row["fidelity"] == "real"]
    write_csv(folder / "grasps.csv", grasps)
    known = {row["grasp_id"] for row in grasps}
    write_csv(folder / "traces.csv", [row for row in read_csv(folder / "traces.csv") if row["grasp_id"] in known])
    (folder / "simulations.csv").unlink(missing_ok=True)
    import_handoff(lake, folder, PROVENANCE, Origin(lab="turin", campaign_id="turin"))
    assert sorted(lake.ids(GraspRow)) == ["delft.a", "delft.b", "turin.a", "turin.b"]
