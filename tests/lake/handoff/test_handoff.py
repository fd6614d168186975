from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from fast.lake.handoff.export_folder import export_handoff
from fast.lake.handoff.import_folder import import_handoff
from fast.lake.handoff.tables import HandoffError
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    TABLES,
    DesignRow,
    GraspRow,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
    TraceRow,
)
from fast.models.design.space import BEST_PUBLISHED, PARAMETERS
from fast.models.errors import UsageError
from tests.lake.handoff.handoff_folder import DESIGN, PROVENANCE, good_folder, read_csv, samples, write_csv


@pytest.fixture
def folder(tmp_path):
    return good_folder(tmp_path / "their-lab")


def change(path: Path, row: int, **values: object) -> None:
    """Change cells of the spreadsheet row `row` (the header is 1)."""
    rows = read_csv(path)
    rows[row - 2] |= {k: str(v) for k, v in values.items()}
    write_csv(path, rows)


def faults_of(lake, folder):
    with pytest.raises(HandoffError) as caught:
        import_handoff(lake, folder, PROVENANCE)
    assert all(str(fault) in str(caught.value) for fault in caught.value.faults)
    assert all(lake.query(f"SELECT 1 FROM {t.table}").num_rows == 0 for t in TABLES)
    assert sorted(path.name for path in lake.root.iterdir()) == ["lake.json"]
    return [str(fault) for fault in caught.value.faults]


@pytest.mark.parametrize("is_upper", [False, True])
def test_a_folder_that_a_spreadsheet_wrote_is_the_same(lake, folder, tmp_path, is_upper):
    for path in folder.glob("*.csv"):
        rows = read_csv(path)
        names = [name.upper() if is_upper else name for name in rows[0]]
        lines = [
            ";".join(names),
            *(
                ";".join(str(cell).replace(".", ",") if is_decimal(cell) else cell for cell in row.values())
                for row in rows
            ),
        ]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8-sig")
    own = Lake.open(tmp_path / "own", create=True)
    import_handoff(own, good_folder(tmp_path / "good"), PROVENANCE)
    import_handoff(lake, folder, PROVENANCE)
    found = [[(row["peak_force_n"], row["work_j"]) for row in one.rows(GraspRow)] for one in (lake, own)]
    assert found[0] == found[1]
    assert [row["length_mm"] for row in lake.rows(DesignRow)] == [DESIGN["length_mm"]]


def is_decimal(cell: str) -> bool:
    return cell.replace(".", "", 1).replace("-", "", 1).isdigit()


def test_numbers_and_empty_rows_of_a_table_program_are_left_out(lake, folder):
    rows = read_csv(folder / "grasps.csv")
    lines = [",".join(["", *rows[0]]), *(",".join([str(n), *row.values()]) for n, row in enumerate(rows))]
    (folder / "grasps.csv").write_text("\n".join([*lines, "," * len(rows[0]), ""]))
    found = [one for grasp_id in ("a", "b", "s", "t") for one in samples(grasp_id)]
    table = pa.Table.from_pylist(found).append_column("__index_level_0__", pa.array(range(len(found))))
    (folder / "traces.csv").unlink()
    pq.write_table(table, folder / "traces.parquet")
    assert import_handoff(lake, folder, PROVENANCE) == (1, 2, 2, 20, 0, (), 0)


def test_a_missing_column_is_one_fault_and_not_one_in_every_row(lake, folder):
    rows = read_csv(folder / "designs.csv")
    write_csv(
        folder / "designs.csv", [{name: cell for name, cell in row.items() if name != "width_mm"} for row in rows]
    )
    (fault,) = faults_of(lake, folder)
    assert fault.startswith("designs.csv, width_mm: the column is missing")


def test_a_good_folder_is_imported_whole(lake, folder):
    assert import_handoff(lake, folder, PROVENANCE) == (1, 2, 2, 20, 0, (), 0)
    row = lake.rows(GraspRow, grasp_id="a")[0]
    assert (row["campaign_id"], row["batch"], row["slot"], row["order"]) == ("import-their-lab", 2, 4, 12)
    assert row["started_at"].isoformat() == "2026-03-01T09:00:00+00:00"
    assert row["peak_force_n"] == 8.0
    assert row["initial_force_n"] == 0.0
    assert row["work_j"] == pytest.approx(1e-3 * np.trapezoid([-1, 3, 8, 0.1], [0, 0.1, 1 / 3, 2]))
    assert lake.rows(GraspRow, grasp_id="b")[0]["order"] is None
    simulation = lake.rows(SimulationRow, simulation_id="s")[0]
    version = lake.rows(SimulatorVersionRow, version_id=simulation["version_id"])[0]
    assert (version["young_modulus_mpa"], version["tier"], simulation["contact_force_n"]) == (9.5, "imported", 2.5)
    assert lake.trace("a").lift_mm.tolist() == [0, 0, 0.1, 1 / 3, 2]
    assert lake.records(DesignRow)[0].design == BEST_PUBLISHED
    assert lake.query("SELECT n_grasps FROM tool_quality").column(0).to_pylist() == [2]


def test_importing_again_duplicates_nothing(lake, folder):
    import_handoff(lake, folder, PROVENANCE)
    tables = sorted(path.parent.name for path in lake.root.rglob("rows-*"))
    import_handoff(lake, folder, PROVENANCE)
    assert sorted(path.parent.name for path in lake.root.rglob("rows-*")) == tables
    assert len(lake.rows(GraspRow)) == len(lake.rows(SimTraceRow)) == 2


@pytest.mark.parametrize("traces", ["csv", "parquet"])
def test_export_gives_the_files_back(lake, folder, tmp_path, traces):
    import_handoff(lake, folder, PROVENANCE)
    out = tmp_path / "out"
    assert export_handoff(lake, out, traces=traces) == (1, 2, 2, 20, 0, (), 0)
    theirs, ours = read_csv(folder / "grasps.csv"), read_csv(out / "grasps.csv")
    theirs[0]["started_at"] = "2026-03-01T09:00:00+00:00"  # the same time, as UTC
    theirs = [row | {"closed_gap_mm": "16.0", "tip_below_mm": "5.0"} for row in theirs]  # an export says what it took
    key = "grasp_id"
    assert sorted(ours, key=lambda r: r[key]) == sorted(theirs, key=lambda r: r[key])
    assert read_csv(out / "designs.csv") == read_csv(folder / "designs.csv")
    assert read_csv(out / "simulations.csv") == read_csv(folder / "simulations.csv")
    if traces == "csv":
        assert read_csv(out / "traces.csv") == read_csv(folder / "traces.csv")
    else:
        table = pq.read_table(out / "traces.parquet")
        assert table["lift_mm"].to_pylist() == [float(r["lift_mm"]) for r in read_csv(folder / "traces.csv")]


def test_a_campaign_travels_to_another_lake_without_loss(
    lake, tmp_path, provenance, small_rows, make_grasp, make_simulation
):
    grasps = [row for o in range(4) for row in make_grasp(object_id=o, peak_n=10 + o / 3)]
    lake.append([*small_rows, *grasps, *make_simulation(object_id=2)], provenance)
    export_handoff(lake, tmp_path / "one", campaign_id="c1")
    other = Lake.open(tmp_path / "other", create=True)
    import_handoff(other, tmp_path / "one", PROVENANCE)
    same = ("grasp_id", "tool_id", "design_id", "object_id", "repeat", "order", "started_at", "peak_force_n", "work_j")
    for row in lake.rows(GraspRow):
        (back,) = other.rows(GraspRow, grasp_id=row["grasp_id"])
        assert {k: back[k] for k in same} == {k: row[k] for k in same}
        for channel in ("time_s", "lift_mm", "force_n"):
            assert lake.trace(row["grasp_id"]).__dict__[channel].tobytes() == (
                other.trace(row["grasp_id"]).__dict__[channel].tobytes()
            )
    export_handoff(other, tmp_path / "two")
    for name in ("designs.csv", "grasps.csv", "simulations.csv", "traces.parquet"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_a_failed_grasp_goes_along_with_its_reason(lake, tmp_path, provenance, small_rows, make_grasp):
    failed, _ = make_grasp(object_id=1, status="failed", reason="air", peak_force_n=None, work_j=None)
    lake.append([*small_rows, *make_grasp(), failed], provenance)
    assert export_handoff(lake, tmp_path / "out").n_real == 2
    assert not (tmp_path / "out" / "simulations.csv").exists()
    rows = {row["grasp_id"]: row for row in read_csv(tmp_path / "out" / "grasps.csv")}
    assert (rows[failed.grasp_id]["status"], rows[failed.grasp_id]["reason"]) == ("failed", "air")


def test_export_never_overwrites(lake, folder):
    import_handoff(lake, folder, PROVENANCE)
    before = (folder / "grasps.csv").read_bytes()
    with pytest.raises(UsageError, match="/dev/null is no folder"):
        export_handoff(lake, Path("/dev/null"))
    with pytest.raises(UsageError, match=r"already holds designs\.csv"):
        export_handoff(lake, folder)
    assert (folder / "grasps.csv").read_bytes() == before


# Spreadsheet row 2, 3 or 4 of a file, the cell that is made wrong, and what the fault must say of it.
FAULTS = [
    ("designs.csv", 2, "length_mm", "36", "must be a number, at least 19 and at most 35 mm."),
    ("designs.csv", 2, "rib_count", "2.5", "must be an integer, at least 1 and at most 10."),
    ("designs.csv", 2, "rib_angle_deg", "flat", "must be a number, at least -40 and at most 40 deg."),
    ("designs.csv", 2, "width_mm", "nan", "must be a number, at least 28 and at most 35 mm."),
    ("designs.csv", 2, "design_id", "", "must not be empty."),
    ("grasps.csv", 3, "object_id", "36", "must be 0 to 35, or an own object of objects.json"),
    ("grasps.csv", 3, "object_id", "cube", "must be an integer of at least 0."),
    ("grasps.csv", 3, "repeat", "-1", "must be an integer of at least 0."),
    ("grasps.csv", 3, "fidelity", "virtual", "must be `real` or `sim`."),
    ("grasps.csv", 3, "started_at", "yesterday", "must be an ISO 8601 time"),
    ("grasps.csv", 3, "started_at", "0001-01-01T00:00:00+05:00", "must be an ISO 8601 time"),
    ("grasps.csv", 3, "order", "first", "must be an integer."),
    ("grasps.csv", 3, "order", "1e30", "must be an integer of at most 9007199254740992."),
    ("grasps.csv", 3, "grasp_id", "a", "must be unique"),
    ("grasps.csv", 3, "design_id", "yours", "must be a design_id of designs.csv"),
    ("grasps.csv", 3, "tool_id", "", "must name the tool of a measured grasp."),
    ("traces.csv", 4, "force_n", "inf", "must be a finite number, in N."),
    ("traces.csv", 4, "lift_mm", "x", "must be a finite number, in mm."),
    ("traces.csv", 4, "time_s", "-1.0", "must not be before the sample above it"),
    ("traces.csv", 4, "grasp_id", "zz", "must be a grasp of grasps.csv."),
    ("simulations.csv", 2, "friction", "7", "must be a number, at least 0 and at most 2."),
    ("simulations.csv", 2, "poisson_ratio", "0.5", "must be a number, at least 0 and below 0.5."),
    ("simulations.csv", 2, "grasp_id", "a", "must be a grasp of grasps.csv with fidelity sim."),
]


@pytest.mark.parametrize(("file", "row", "column", "value", "limit"), FAULTS)
def test_a_fault_names_file_row_column_value_and_limit(lake, folder, file, row, column, value, limit):
    change(folder / file, row, **{column: value})
    assert any(
        fault.startswith(f"{file} row {row}, {column} = {value!r}: {limit}") for fault in faults_of(lake, folder)
    )


def test_all_faults_are_named_at_once(lake, folder):
    change(folder / "designs.csv", 2, length_mm=1, width_mm=1)
    change(folder / "grasps.csv", 2, object_id=99, repeat="x")
    change(folder / "traces.csv", 3, force_n="?", lift_mm="?")
    change(folder / "simulations.csv", 2, friction=-1)
    assert len(faults_of(lake, folder)) == 7


def test_a_grasp_without_samples_is_a_fault(lake, folder):
    write_csv(folder / "traces.csv", [row for name in "abs" for row in samples(name)])
    assert faults_of(lake, folder) == [
        "grasps.csv row 5, grasp_id = 't': must have samples in the traces file, it has none."
    ]


def test_a_grasp_that_never_lifts_is_a_fault(lake, folder):
    rows = [
        row | {"lift_mm": 0 if row["grasp_id"] == "b" else row["lift_mm"]} for row in read_csv(folder / "traces.csv")
    ]
    write_csv(folder / "traces.csv", rows)
    (fault,) = faults_of(lake, folder)
    assert "must rise above 0 mm during the grasp `b`" in fault


@pytest.mark.parametrize("name", ["designs.csv", "grasps.csv", "traces.csv"])
def test_a_missing_or_empty_file_is_named(lake, folder, name):
    text = (folder / name).read_text()
    (folder / name).unlink()
    assert f"{name}: is missing; add it to the folder." in faults_of(lake, folder)
    (folder / name).write_text(text.splitlines()[0] + "\n")
    assert f"{name}: has no usable rows." in faults_of(lake, folder)
    (folder / name).write_bytes(b"\xff\xfe\x00")
    assert f"{name}: is not a text file in UTF-8; save it as CSV in UTF-8." in faults_of(lake, folder)
    (folder / name).write_text(text.replace(",", "|"))
    assert sum(fault.startswith(f"{name}: row 1 names no column; sep") for fault in faults_of(lake, folder)) == 1


def test_wrong_columns_are_named(lake, folder):
    text = (folder / "grasps.csv").read_text()
    (folder / "grasps.csv").write_text(text.replace("object_id", "object", 1))
    faults = faults_of(lake, folder)
    assert any("grasps.csv, object_id: the column is missing" in fault for fault in faults)
    assert any("grasps.csv, object: unknown column" in fault for fault in faults)


def test_a_short_row_is_named(lake, folder):
    with (folder / "grasps.csv").open("a") as file:
        file.write("c,mine-1\n")
    assert (
        "grasps.csv row 6: has 2 cells, the header has 8; write 12.5 with a point where commas separate."
        in faults_of(lake, folder)
    )


def test_parquet_traces_are_checked_too(lake, folder):
    rows = read_csv(folder / "traces.csv")
    (folder / "traces.csv").unlink()
    columns = {c: pa.array([float(r[c]) for r in rows]) for c in ("time_s", "lift_mm", "force_n")}
    table = pa.table({"grasp_id": [r["grasp_id"] for r in rows], **columns})
    bad = table.set_column(3, "force_n", pa.array([None, *table["force_n"].to_pylist()[1:]], type=pa.float64()))
    pq.write_table(bad, folder / "traces.parquet")
    (fault,) = faults_of(lake, folder)
    assert fault.startswith("traces.parquet row 1, force_n")
    pq.write_table(table.set_column(3, "force_n", pa.array(["1"] * len(rows))), folder / "traces.parquet")
    assert any("must be a column of numbers" in fault for fault in faults_of(lake, folder))
    (folder / "traces.parquet").write_bytes(b"no")
    assert any("not a readable Parquet file" in fault for fault in faults_of(lake, folder))
    pq.write_table(table, folder / "traces.parquet")
    assert import_handoff(lake, folder, PROVENANCE).n_samples == 20


def test_two_trace_files_are_ambiguous(lake, folder):
    pq.write_table(pa.table({"grasp_id": ["a"]}), folder / "traces.parquet")
    assert any("remove one of the two" in fault for fault in faults_of(lake, folder))


def test_an_id_that_means_something_else_in_the_lake_is_refused(lake, folder):
    import_handoff(lake, folder, PROVENANCE)
    before = {t.table: lake.query(f"SELECT * FROM {t.table} ORDER BY ALL") for t in TABLES}
    change(folder / "designs.csv", 2, length_mm=30)
    change(folder / "grasps.csv", 2, object_id=9)
    with pytest.raises(HandoffError) as caught:
        import_handoff(lake, folder, PROVENANCE)
    assert [(fault.file, fault.value) for fault in caught.value.faults] == [
        ("designs.csv", "mine-1"),
        ("grasps.csv", "a"),
    ]
    assert {t.table: lake.query(f"SELECT * FROM {t.table} ORDER BY ALL") for t in TABLES} == before


def test_grasps_may_name_designs_of_the_lake(lake, folder):
    import_handoff(lake, folder, PROVENANCE)
    other = {**DESIGN, "length_mm": 20.0}
    write_csv(folder / "designs.csv", [{"design_id": "mine-2", **other}])
    assert import_handoff(lake, folder, PROVENANCE).n_designs == 1
    assert len(lake.rows(DesignRow)) == 2


def test_spreadsheet_habits_are_accepted(lake, folder):
    change(folder / "grasps.csv", 2, order="12.0", started_at="2026-03-01 10:00:00")
    text = (folder / "grasps.csv").read_text()
    (folder / "grasps.csv").write_text("\ufeff" + text.replace("\n", "\r\n") + "\r\n")
    import_handoff(lake, folder, PROVENANCE)
    row = lake.rows(GraspRow, grasp_id="a")[0]
    assert (row["order"], row["started_at"].isoformat()) == (12, "2026-03-01T10:00:00+00:00")


def test_a_folder_that_is_none_is_wrong_use(lake, tmp_path):
    with pytest.raises(UsageError, match="not a folder"):
        import_handoff(lake, tmp_path / "nowhere", PROVENANCE)


@settings(
    max_examples=3,
    phases=[Phase.explicit, Phase.generate],
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.lists(st.tuples(*[st.floats(-900, 900)] * 2), min_size=1, max_size=40))
def test_any_number_survives_export_and_import(tmp_path_factory, values):
    root = tmp_path_factory.mktemp("round")
    lake = Lake.open(root / "lake", create=True)
    lift = np.sort([v[0] for v in values] + [1.0])  # a lift rises
    force = np.array([v[1] for v in values] + [900.0])  # a pull is positive
    time_s = (lift - lift[0]) / 3 + 0.001 * np.arange(len(lift))  # a slower one than any bench's is asked about
    row = GraspRow(
        grasp_id="K", campaign_id="c", tool_id="x", design_id="D", object_id=1, repeat=0, status="ok",
        setup_id="G", setup_json="{}", bench="real",
    )  # fmt: skip
    trace = TraceRow(grasp_id="K", time_s=time_s, lift_mm=lift, force_n=force)
    lake.append([DesignRow(design_id="D", **DESIGN), row, trace], PROVENANCE)
    for kind in ("csv", "parquet"):
        export_handoff(lake, root / kind, traces=kind)
        other = Lake.open(root / f"lake-{kind}", create=True)
        import_handoff(other, root / kind, PROVENANCE)
        back = other.trace("K")
        assert (back.time_s.tobytes(), back.lift_mm.tobytes(), back.force_n.tobytes()) == (
            time_s.tobytes(), lift.tobytes(), force.tobytes(),
        )  # fmt: skip
    assert set(PARAMETERS) < set(DesignRow.model_fields)
