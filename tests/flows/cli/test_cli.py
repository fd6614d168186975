"""Right use of the command line: results for people and, with --json, for machines."""

import csv
import json
from importlib.metadata import version

import pyarrow.parquet as pq
import pytest

from fast.flows.cli.common import table_text
from fast.hardware.parts.safe_state import StopAskedError
from fast.hardware.questions import BenchQuestion
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, GraspRow, ToolRow
from fast.models.design.space import BEST_PUBLISHED
from fast.tasks.bench.questions import make_ask
from fast.tasks.campaign.requests import requested_verb
from tests.flows.cli.cli_lakes import WORLD, Fast, proposed_lake
from tests.flows.synthetic_lake import Campaign, build

N_TOOLS = 4  # of the first batch of campaigns/quick.toml


@pytest.fixture
def fast(capsys, monkeypatch):
    monkeypatch.delenv("FAST_LAKE", raising=False)
    return Fast(capsys)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A lake with a measured campaign `demo`."""
    return build(Lake.open(tmp_path_factory.mktemp("cli") / "lake", create=True), Campaign()).root


def test_status_and_list_say_what_is_waited_for(fast, tmp_path, monkeypatch):
    lake = proposed_lake(tmp_path)
    monkeypatch.setenv("FAST_LAKE", str(lake))
    assert f"fast print confirm quick/B01 --operator NAME --lake {lake}\n" in fast("campaign", "status").out
    status = fast("campaign", "status", "--json").json
    assert (status["campaign"], status["waiting_for_print"]) == ("quick", ["quick/B01"])
    assert [row["campaign"] for row in fast("campaign", "list", "--json").json] == ["quick"]


def test_status_says_what_the_bench_asks(fast, tmp_path):
    lake = proposed_lake(tmp_path)
    question = BenchQuestion(key="pads", sentence="The pads are worn.", choices=("go on",))
    with pytest.raises(StopAskedError):
        make_ask(Lake.open(lake), "quick", lambda: True)(question)
    told = f"for an answer: The pads are worn. See fast campaign answer quick --lake {lake}\n"
    assert told in fast("campaign", "status", "--lake", lake).out
    assert fast("campaign", "status", "--lake", lake, "--json").json["waiting_for_answers"] == ["The pads are worn."]


def test_print_sheet_and_confirm(fast, tmp_path):
    lake = proposed_lake(tmp_path)
    sheet = fast("print", "sheet", "B01", "--out", tmp_path / "tray", "--lake", lake, "--json").json["sheet"]
    assert sheet == str(tmp_path / "tray" / "sheet.html")
    assert "quick/B01" in (tmp_path / "tray" / "sheet.html").read_text()
    words = [
        "--operator",
        "ada",
        "--material-lot",
        "L7",
        "--reject",
        "1=tip torn",
        "--measured",
        "0:front=2.5,rib=2",
        "--sure",
    ]
    answer = fast("print", "confirm", "quick/B01", *words, "--lake", lake, "--json")
    said = {"batch": "quick/B01", "n_mounted": N_TOOLS - 1, "n_rejected": 1, "operator": "ada"}
    assert answer.json == said | {"again": [], "sheet": None}
    tools = {row["slot"]: row for row in Lake.open(lake).rows(ToolRow)}
    assert (tools[0]["measured_front_thickness_mm"], tools[0]["measured_rib_thickness_mm"]) == (2.5, 2.0)
    assert (tools[1]["status"], tools[1]["reason"], tools[1]["material_lot"]) == ("rejected", "tip torn", "L7")
    assert "already confirmed" in fast.refused("print", "confirm", "B01", "--operator", "bob", "--lake", lake)


@pytest.mark.parametrize("verb", ["pause", "stop", "abort"])
def test_requests_reach_a_running_campaign(fast, tmp_path, verb):
    root = proposed_lake(tmp_path)
    with exclusive(Lake.open(root).storage, "campaign-quick", "busy"):
        assert fast("campaign", "status", "--lake", root, "--json").json["state"] == "running"
        answer = fast("campaign", verb, "--lake", root, "--json")
    assert answer.json == {"campaign": "quick", "asked": verb}
    lake = Lake.open(root)
    assert requested_verb(lake, "quick") == verb
    assert len(lake.rows(EventRow)) == 1


def test_sql_in_every_format(fast, measured, tmp_path):
    query = "SELECT tool_id, round(tool_quality_n, 6) AS q FROM tool_quality ORDER BY tool_id LIMIT 2"
    rows = fast("sql", query, "--json", "--lake", measured).json
    assert [row["tool_id"] for row in rows] == ["demo/B01T0", "demo/B01T1"]
    assert json.loads(fast("sql", query, "--format", "json", "--lake", measured).out) == rows
    lines = fast("sql", query, "--lake", measured).out.splitlines()
    assert lines[0].split() == ["tool_id", "q"]
    assert len(lines) == 4
    table = list(csv.DictReader(fast("sql", query, "--format", "csv", "--lake", measured).out.splitlines()))
    assert [float(row["q"]) for row in table] == [row["q"] for row in rows]
    out = tmp_path / "q.parquet"
    assert (
        fast("sql", query, "--format", "parquet", "--out", out, "--lake", measured).err == f"2 rows written to {out}\n"
    )
    assert pq.read_table(out).to_pylist() == rows


def test_a_table_cuts_long_values(fast, measured):
    answer = fast("sql", "SELECT time_s, 'a' || chr(10) || 'b' AS t FROM traces LIMIT 1", "--lake", measured)
    lines = answer.out.splitlines()
    assert len(lines) == 3
    assert max(map(len, lines)) < 80
    assert "..." in lines[2]


def test_lake_round_trip(fast, measured, tmp_path):
    folder, lake = tmp_path / "out", tmp_path / "lake"
    exported = fast("lake", "export", folder, "--lake", measured, "--campaign", "demo", "--json").json
    assert exported["n_real"] > 0
    assert fast("lake", "import", folder, "--lake", lake, "--json").json == exported | {"is_dry": False}
    assert fast("lake", "export", tmp_path / "again", "--lake", lake, "--campaign", "import-out").status == 0
    stats = {row["table"]: row["n_rows"] for row in fast("lake", "stats", "--lake", lake, "--json").json}
    assert stats["grasps"] == exported["n_real"] == len(Lake.open(measured).ids(GraspRow, campaign_id="demo"))
    assert stats["traces"] == len(Lake.open(measured).ids(GraspRow, campaign_id="demo", status="ok"))


@pytest.mark.parametrize(("separator", "decimal", "quote"), [(",", ".", ""), (";", ",", ""), (",", ".", '"')])
def test_import_says_what_is_taken_as_usual_only_where_the_folder_does_not_say_it(
    fast, tmp_path, separator, decimal, quote
):
    """In the dialects that are read: of spreadsheets with decimal commas, and with names in quotation marks."""
    columns = ["grasp_id", "closed_gap_mm", "tip_below_mm"]
    for named, is_said in ((columns, False), (columns[:2], True)):
        header = separator.join(f"{quote}{name}{quote}" for name in named)
        row = separator.join(["G1", f"20{decimal}0", f"5{decimal}0"][: len(named)])
        (tmp_path / "grasps.csv").write_text(f"{header}\n{row}\n")
        refused = fast("lake", "import", tmp_path, "--lake", tmp_path / "lake").err
        assert ("taken as usual: tip_below_mm 5. " in refused) is is_said
        assert "closed_gap_mm 16" not in refused


def test_compact_says_what_it_merged(fast, tmp_path):
    lake = proposed_lake(tmp_path)
    Lake.open(lake)
    before = len(list((lake / "designs").glob("rows-*")))
    rows = {row["table"]: row for row in fast("lake", "compact", "--lake", lake, "--json").json}
    assert rows["designs"]["n_files_before"] == before
    assert fast("lake", "compact", "--lake", lake).out == "nothing to merge.\n"


def test_check_knows_what_belongs_to_fast_and_fails_on_the_rest(fast, tmp_path):
    lake = proposed_lake(tmp_path)
    for known in (".state", "outputs/quick"):
        (lake / known).mkdir(parents=True)
    assert fast("lake", "check", "--lake", lake).out == "every file of the lake is whole.\n"
    (lake / "designs" / "rows-torn.parquet").write_text("no parquet")
    answer = fast("lake", "check", "--lake", lake, "--json")
    assert answer.status == 1
    assert [finding["kind"] for finding in answer.json] == ["torn"]
    answer = fast("lake", "check", "--quarantine", "--lake", lake)
    assert answer.status == 1
    assert "Now set aside: " in answer.out
    assert fast("lake", "check", "--lake", lake).status == 0


def test_view_takes_grasps_designs_and_campaigns(fast, measured, tmp_path):
    grasp = Lake.open(measured).rows(GraspRow, status="ok")[0]
    for what in (grasp["grasp_id"], grasp["design_id"], grasp["tool_id"], "demo"):
        out = tmp_path / f"{what.replace('/', '-')}.rrd"
        answer = fast("view", what, "--save", out, "--lake", measured, "--json")
        assert answer.json == {"shown": what, "recording": str(out)}
        assert out.stat().st_size > 10_000


def test_report_says_where_it_is(fast, measured, tmp_path, monkeypatch):
    """What the report holds is the claim of the tests of reports."""
    monkeypatch.setattr("fast.flows.report.campaign.page.write_report", lambda lake, name, out, others: write_page(out))
    answer = fast("report", "--lake", measured, "--out", tmp_path / "report", "--json")
    assert answer.json == {
        "campaign": "demo",
        "report": str(tmp_path / "report" / "index.html"),
        "insights": None,
    }


def write_page(out):
    out.mkdir()
    (out / "index.html").write_text("a report")
    return out / "index.html"


WRITTEN = {"result.json", "trace.csv", "trace.png", "grasp.png", "grasp.rrd"}


def test_simulate_writes_what_it_says(fast, measured, tmp_path):
    design = tmp_path / "design.json"
    design.write_text(BEST_PUBLISHED.model_dump_json())
    version = fast("sql", "SELECT version_id FROM simulator_versions LIMIT 1", "--json", "--lake", measured).json
    words = ["--design", design, "--object", "2", "--set", "max_lift_mm=2", "--out", tmp_path / "out"]
    data = fast("simulate", *words, "--version", version[0]["version_id"], "--lake", measured, "--json").json
    assert data["version_id"] == version[0]["version_id"]
    assert data["design_id"] == BEST_PUBLISHED.design_id
    assert data["peak_force_n"] > 0
    assert {p.name for p in (tmp_path / "out").iterdir()} == WRITTEN
    stiffer = fast("simulate", "--object", "2", "--set", "max_lift_mm=2", "--set", "young_modulus_mpa=20", "--json")
    assert stiffer.json["peak_force_n"] > data["peak_force_n"]
    assert stiffer.json["version_id"] != data["version_id"]


def test_gantry_by_hand(fast):
    home = fast("gantry", "home", "--vent", "--world", WORLD, "--json").json
    assert (home["x_mm"], home["z_mm"]) == (1500.0, 180.0)
    assert fast("gantry", "park", "--world", WORLD, "--json").json == {"parked": True}
    assert fast("gantry", "tare", "--world", WORLD, "--json").json["gross_n"] > 0
    assert fast("gantry", "faults", "--world", WORLD, "--json").json["is_estop_pressed"] is False
    assert "no fault" in fast("gantry", "faults", "--world", WORLD).out


def test_gantry_grasps(fast):
    (row,) = fast("gantry", "grasp", "--object", "2", "--slot", "1", "--world", WORLD, "--json").json
    assert (row["status"], row["object_id"]) == ("ok", 2)
    assert row["peak_force_n"] > 1


def test_doctor_passes_here_and_names_the_fix_elsewhere(fast, tmp_path, monkeypatch):
    answer = fast("doctor", "--lake", tmp_path / "none", "--json")
    assert answer.status == 0, answer.out
    assert not (tmp_path / "none").exists()
    assert "mesher fTetWild" in {check["name"] for check in answer.json}
    (tmp_path / "notes.txt").write_text("not a lake")
    monkeypatch.setattr("fast.flows.cli.doctor._small_mesh", _broken)
    monkeypatch.setattr("fast.flows.cli.doctor._small_grasp", lambda: "solved above")
    monkeypatch.setattr("fast.flows.cli.doctor.is_installed", lambda name: name != "pymc")
    answer = fast("doctor", "--lake", tmp_path)
    assert answer.status == 1
    failed = [line for line in answer.out.splitlines() if line.startswith("FAIL")]
    assert [line.split()[1] for line in failed] == ["packages", "lake", "mesher"]
    assert "`pymc` is not installed; run `make setup`" in failed[0]
    assert "give another --lake" in failed[1]
    assert "it broke; run `make clean setup`" in failed[2]


def _broken():
    raise RuntimeError("it broke.")


def test_the_version_is_that_of_the_package(fast):
    assert fast("--version").out.strip() == version("fast-gripper-lab")


def test_a_table_that_is_too_wide_is_cut_into_tables_with_the_same_first_column():
    rows = [{"strategy": "measured only", **{f"number_{place}": 1.5 for place in range(8)}}]
    text = table_text(rows, width=50)
    assert max(map(len, text.splitlines())) <= 50
    heads = [line.split() for line in text.splitlines() if line.startswith("strategy")]
    assert len(heads) == 3
    assert [name for head in heads for name in head[1:]] == [f"number_{place}" for place in range(8)]
    assert table_text(rows, width=500) == table_text(rows)
