"""What imported data become: a campaign of their own, beside which everything else in the lake stays as it was."""

import tomllib

import pyarrow as pa
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from fast.lake.handoff.export_folder import export_handoff
from fast.lake.handoff.format import GRASP_COLUMNS, SIMULATION_COLUMNS, TRACE_COLUMNS
from fast.lake.handoff.import_folder import Origin, import_handoff
from fast.lake.handoff.readers import HandoffTables, handoff_folder, load_reader
from fast.lake.handoff.tables import HandoffError
from fast.lake.store import Lake
from fast.lake.tables.campaign import TABLES, BatchRow, CampaignRow, GraspRow, ObjectRow, ToolRow
from fast.models.design.space import LOWER, PARAMETERS, UPPER
from fast.models.errors import UsageError
from fast.models.records import GraspSetup
from tests.lake.handoff.handoff_folder import DESIGN, PROVENANCE, good_folder, grasp, read_csv, samples, write_csv


@pytest.fixture
def folder(tmp_path):
    return good_folder(tmp_path / "their-lab")


def everything(lake):
    return {t.table: lake.query(f"SELECT * FROM {t.table} ORDER BY ALL").to_pylist() for t in TABLES}


def test_imported_data_are_a_campaign_that_names_its_source(lake, folder):
    import_handoff(lake, folder, PROVENANCE)
    (campaign,) = lake.rows(CampaignRow)
    config = tomllib.loads(campaign["config_toml"])
    assert (campaign["campaign_id"], config["kind"]) == ("import-their-lab", "imported")
    assert [source["folder"] for source in config["sources"]] == ["their-lab"]
    assert {row["config_hash"] for row in lake.rows(GraspRow)} == {config["sources"][0]["content_hash"]}
    (tool,) = lake.rows(ToolRow)
    assert (tool["tool_id"], tool["batch"], tool["slot"], tool["design_id"]) == ("lab/B02T4", 2, 4, "mine-1")
    assert [(row["batch"], row["kind"], row["n_tools"]) for row in lake.rows(BatchRow)] == [(2, "imported", 1)]
    assert len(lake.ids(ObjectRow)) == 36


def test_two_folders_of_one_campaign_are_both_named(lake, folder, tmp_path):
    import_handoff(lake, folder, PROVENANCE, Origin(campaign_id="theirs"))
    more = good_folder(tmp_path / 'more "data"')
    for name in ("grasps.csv", "traces.csv", "simulations.csv"):
        write_csv(more / name, [row | {"grasp_id": row["grasp_id"] + "2"} for row in read_csv(more / name)])
    import_handoff(lake, more, PROVENANCE, Origin(campaign_id="theirs"))
    import_handoff(lake, more, PROVENANCE, Origin(campaign_id="theirs"))
    (campaign,) = lake.rows(CampaignRow)
    sources = tomllib.loads(campaign["config_toml"])["sources"]
    assert [source["folder"] for source in sources] == ["their-lab", 'more "data"']
    assert len(lake.rows(GraspRow)) == 4
    assert len(lake.rows(ToolRow)) == 1


def test_a_corrected_folder_replaces_its_grasps_and_says_how_many(lake, folder):
    import_handoff(lake, folder, PROVENANCE)
    assert import_handoff(lake, folder, PROVENANCE).n_replaced == 0
    rows = read_csv(folder / "traces.csv")
    write_csv(folder / "traces.csv", [row | {"force_n": float(row["force_n"]) / 2} for row in rows])
    assert import_handoff(lake, folder, PROVENANCE, is_dry=True).n_replaced == 4
    counts = import_handoff(lake, folder, PROVENANCE)
    assert (counts.n_real, counts.n_sim, counts.n_known, counts.n_replaced) == (0, 0, 4, 4)
    assert {row["peak_force_n"] for row in lake.rows(GraspRow)} == {4.0}
    other_gap = Origin(setup=GraspSetup(closed_gap_mm=30.0))
    assert import_handoff(lake, folder, PROVENANCE, other_gap).n_replaced == 4


def test_tools_without_a_label_get_a_place_and_keep_their_id(lake, folder):
    names = ["rig", "old/B03T1", "new/B03T1", *(f"finger {i}" for i in range(11))]
    write_csv(folder / "grasps.csv", [grasp(f"g{i}", tool_id=name) for i, name in enumerate(names)])
    write_csv(folder / "traces.csv", [row for i in range(len(names)) for row in samples(f"g{i}")])
    (folder / "simulations.csv").unlink()
    import_handoff(lake, folder, PROVENANCE)
    places = {row["tool_id"]: (row["batch"], row["slot"]) for row in lake.rows(ToolRow)}
    assert set(places) == set(names)
    assert (places["old/B03T1"], places["rig"], places["new/B03T1"]) == ((3, 1), (4, 0), (4, 1))
    assert places["finger 10"] == (5, 2)
    assert {row["tool_id"]: (row["batch"], row["slot"]) for row in lake.rows(GraspRow)} == places
    assert {row["batch"]: row["n_tools"] for row in lake.rows(BatchRow)} == {3: 1, 4: 10, 5: 3}


def test_a_tool_of_several_designs_is_kept_and_told(lake, folder, caplog):
    designs = read_csv(folder / "designs.csv")
    write_csv(folder / "designs.csv", [*designs, designs[0] | {"design_id": "mine-2", "length_mm": 20}])
    write_csv(folder / "grasps.csv", [grasp("a"), grasp("b", design_id="mine-2"), *read_csv(folder / "grasps.csv")[2:]])
    import_handoff(lake, folder, PROVENANCE)
    assert lake.rows(ToolRow) == []
    assert len(lake.rows(GraspRow)) == 2
    assert "tool lab/B02T4 has 2 designs" in caplog.text


def test_a_lakes_own_export_comes_back_without_changing_it(
    lake, tmp_path, provenance, small_rows, make_grasp, make_simulation
):
    lake.append([*small_rows, *make_grasp(), *make_simulation()], provenance)
    before = everything(lake)
    export_handoff(lake, tmp_path / "out")
    assert import_handoff(lake, tmp_path / "out", PROVENANCE) == (0, 0, 0, 0, 2, ("c1",), 0)
    assert everything(lake) == before


def test_samples_of_another_campaign_cannot_be_changed(lake, tmp_path, provenance, small_rows, make_grasp):
    lake.append([*small_rows, *make_grasp()], provenance)
    before = everything(lake)
    export_handoff(lake, tmp_path / "out", traces="csv")
    rows = read_csv(tmp_path / "out" / "traces.csv")
    write_csv(tmp_path / "out" / "traces.csv", [*rows[:-1], rows[-1] | {"force_n": "9.5"}])
    with pytest.raises(HandoffError, match="is in the lake with other samples, and not from this import"):
        import_handoff(lake, tmp_path / "out", PROVENANCE)
    assert everything(lake) == before


def test_a_peak_of_another_campaign_cannot_be_changed(lake, tmp_path, provenance, small_rows, make_grasp):
    (grasp_row, _) = make_grasp(peak_force_n=13.5, work_j=None)
    lake.append([*small_rows, grasp_row], provenance)
    export_handoff(lake, tmp_path / "out")
    assert import_handoff(lake, tmp_path / "out", PROVENANCE) == (0, 0, 0, 0, 1, ("c1",), 0)
    (row,) = read_csv(tmp_path / "out" / "grasps.csv")
    write_csv(tmp_path / "out" / "grasps.csv", [row | {"peak_force_n": "13.6"}])
    with pytest.raises(HandoffError, match=r"is in the lake with a peak of 13.5 N.*or say with --lab who measured it"):
        import_handoff(lake, tmp_path / "out", PROVENANCE)


def test_nothing_is_imported_into_a_campaign_of_the_bench(lake, folder, provenance, small_rows):
    lake.append(small_rows, provenance)
    before = everything(lake)
    with pytest.raises(UsageError, match="campaign `c1` of this lake was not imported"):
        import_handoff(lake, folder, PROVENANCE, Origin(campaign_id="c1"))
    assert everything(lake) == before


words = st.text(st.sampled_from("aB7/-_.,;'\"# éβ手"), min_size=1, max_size=8).map(str.strip).filter(bool)
numbers = st.floats(-1e9, 1e9)
forces = st.floats(-2000, 2000)


@st.composite
def folders(draw) -> dict[str, list[dict]]:
    """The rows of all files of a hand-off folder, with ids that only another lab would think of."""
    spans = zip(PARAMETERS, LOWER, UPPER, strict=True)
    bounds = {name: (float(low), float(high)) for name, low, high in spans}
    designs = []
    for design_id in draw(st.lists(words, min_size=1, max_size=2, unique=True)):
        values = {name: draw(st.floats(*span)) for name, span in bounds.items()}
        designs.append({"design_id": design_id, **values, "rib_count": draw(st.integers(1, 10))})
    grasps, traces, simulations = [], [], []
    for grasp_id in draw(st.lists(words, min_size=1, max_size=3, unique=True)):
        is_real = draw(st.booleans())
        grasps.append(
            {
                "grasp_id": grasp_id,
                "design_id": draw(st.sampled_from(designs))["design_id"],
                "object_id": draw(st.integers(0, 35)),
                "repeat": len(grasps),  # a measured grasp is there once
                "fidelity": "real" if is_real else "sim",
                "tool_id": draw(words) if is_real else draw(st.just("") | words),
                "started_at": draw(st.sampled_from(["", "2026-03-01T10:00:00.000001+00:00"])),
                "order": draw(st.just("") | st.integers(-5, 5)),
                "lift_speed_mm_per_s": draw(st.floats(6, 20)),
                "dwell_s": draw(st.floats(0.5, 100)),
                "offset_y_mm": draw(st.floats(1, 5)),
            }
        )
        for i, force_n in enumerate([*draw(st.lists(forces, max_size=2)), 2000.0]):  # a pull is positive
            traces.append(dict(zip(TRACE_COLUMNS, (grasp_id, i / 3, 1 + i / 7, force_n), strict=True)))
        if not is_real:
            theta = (draw(st.none() | st.floats(1, 20)), draw(st.none() | st.floats(0, 2)), None, draw(numbers))
            values = ["" if value is None else value for value in theta]
            simulations.append(dict(zip(SIMULATION_COLUMNS, (grasp_id, *values), strict=True)))
    return {"designs.csv": designs, "grasps.csv": grasps, "traces.csv": traces, "simulations.csv": simulations}


@settings(
    max_examples=4,
    phases=[Phase.explicit, Phase.generate],
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(folders(), st.sampled_from(["csv", "parquet"]))
def test_everything_the_format_holds_survives_a_round_trip(tmp_path_factory, files, kind):
    root = tmp_path_factory.mktemp("trip")
    (root / "in").mkdir()
    for name, rows in files.items():
        if rows:
            write_csv(root / "in" / name, rows)
    for place, traces in (("there", kind), ("back", "csv")):
        lake = Lake.open(root / f"lake-{place}", create=True)
        import_handoff(lake, root / ("in" if place == "there" else "there"), PROVENANCE)
        export_handoff(lake, root / place, traces=traces)
        lake.close()
    for name, rows in files.items():
        key = next(iter(rows[0])) if rows else ""
        wanted = [{column: str(value) for column, value in row.items()} for row in rows]
        if name == "grasps.csv":  # an export says what it took
            wanted = [{"closed_gap_mm": "16.0", "tip_below_mm": "5.0"} | row for row in wanted]
        found = read_csv(root / "back" / name) if (root / "back" / name).exists() else []
        assert sorted(found, key=lambda r: r[key]) == sorted(wanted, key=lambda r: r[key])


READER = """
import pyarrow as pa
from fast.lake.handoff import HandoffTables

def read(path):
    text = (path / "forces.txt").read_text().split()
    return HandoffTables(
        designs={designs},
        grasps=pa.table({grasps}),
        traces={{
            "grasp_id": ["g"] * len(text), "time_s": [i / 10 for i in range(len(text))],
            "lift_mm": [float(i) for i in range(len(text))], "force_n": [float(force) for force in text],
        }},
    )
"""


@pytest.fixture
def foreign(tmp_path):
    """A folder of another format and the reader for it."""
    folder = tmp_path / "strange"
    folder.mkdir()
    (folder / "forces.txt").write_text("0.5 2.25 1.0")
    designs = {"design_id": ["theirs"], **{name: [value] for name, value in DESIGN.items()}}
    grasps = {name: [value] for name, value in grasp("g", design_id="theirs", order=None).items()}
    assert set(grasps) == set(GRASP_COLUMNS)
    (tmp_path / "mylab.py").write_text(READER.format(designs=designs, grasps=grasps))
    return folder


def test_a_reader_gives_another_labs_files(lake, foreign, tmp_path):
    with handoff_folder(foreign, load_reader(f"{tmp_path}/mylab.py:read")) as folder:
        import_handoff(lake, folder, PROVENANCE, Origin(source="strange"))
    (row,) = lake.rows(GraspRow)
    assert (row["campaign_id"], row["design_id"], row["peak_force_n"], row["order"]) == (
        "import-strange", "theirs", 2.25, None,
    )  # fmt: skip
    assert lake.trace("g").force_n.tolist() == [0.5, 2.25, 1.0]


def test_faults_of_a_readers_tables_name_its_source(lake, foreign, tmp_path):
    (foreign / "forces.txt").write_text("0.5 nan")
    with (
        pytest.raises(HandoffError, match=r"strange.*\n.*traces\.parquet row 2, force_n = 'nan'"),
        handoff_folder(foreign, load_reader(f"{tmp_path}/mylab.py:read")) as folder,
    ):
        import_handoff(lake, folder, PROVENANCE)
    assert lake.rows(GraspRow) == []


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("none.py:read", "", "names no Python file"),
        ("bad.py:read", "import nowhere", "does not run .ModuleNotFoundError"),
        ("bad.py:read", "x = 1", "has no function `read`"),
    ],
)
def test_a_reader_that_is_none_is_named(tmp_path, name, text, said):
    if text:
        (tmp_path / "bad.py").write_text(text)
    with pytest.raises(UsageError, match=said):
        load_reader(f"{tmp_path}/{name}")


@pytest.mark.parametrize("returned", [None, HandoffTables({"a": [1]}, {"b": 7}, pa.table({}))])
def test_a_reader_that_fails_is_told_in_one_sentence(tmp_path, returned):
    with pytest.raises(UsageError, match="The reader failed on .*; nothing was imported"):
        handoff_folder(tmp_path, lambda path: returned).__enter__()


def test_a_reader_may_leave_columns_out_and_hears_of_it(lake, tmp_path):
    tables = HandoffTables(pa.table({"design_id": ["d"]}), pa.table({"grasp_id": ["g"]}), pa.table({"x": [1]}))
    with pytest.raises(HandoffError) as caught, handoff_folder(tmp_path, lambda path: tables) as folder:
        import_handoff(lake, folder, PROVENANCE)
    assert {(fault.file, fault.row) for fault in caught.value.faults} == {("designs.csv", None)}  # the rest hangs on it
    assert len(caught.value.faults) == len(PARAMETERS)
