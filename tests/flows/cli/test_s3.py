"""Every command that takes a lake, with one in an object store."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fast.flows.cli import campaign, doctor
from fast.lake.leases import exclusive, is_held
from fast.lake.maintenance import check
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ToolRow
from tests.flows.campaign.test_campaign import CONFIG as TINY
from tests.flows.cli.cli_lakes import ROOT, Fast, proposed_lake, write_config
from tests.flows.synthetic_lake import Campaign, build
from tests.lake.storage.object_server import BUCKET, ObjectServer

ADDRESS = f"s3://{BUCKET}/lab"
NAME = "quick"


@pytest.fixture(scope="module")
def there(tmp_path_factory):
    """A campaign in a lake on a server; the environment points at it."""
    folder = tmp_path_factory.mktemp("objects")
    server = ObjectServer(folder / "server")
    server.start()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in server.environment().items():
            patch.setenv(name, value)
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        patch.delenv("FAST_LAKE", raising=False)
        patch.chdir(folder)
        for n_batches in (1, 2):  # two objects of each table
            build(Lake.open(ADDRESS, create=True), Campaign(campaign_id=NAME, n_measured_batches=n_batches))
        yield server
    server.kill()


@pytest.fixture
def fast(capsys, there):
    def run(*words):
        answer = Fast(capsys)(*words, "--lake", ADDRESS)
        assert answer.status == 0, answer.err
        return answer

    return run


def test_sql_finds_the_lake_in_the_environment(there, capsys, monkeypatch):
    monkeypatch.setenv("FAST_LAKE", ADDRESS)
    (row,) = Fast(capsys)("sql", "SELECT count(*) AS n FROM grasps", "--format", "json").json
    assert row["n"] == len(Lake.open(ADDRESS).query("SELECT grasp_id FROM grasps"))


def test_export_and_import_move_a_lake(fast, capsys, tmp_path):
    assert fast("lake", "export", tmp_path / "out", "--json").json["n_real"] > 0
    copy = f"{ADDRESS}-copy"
    answer = Fast(capsys)("lake", "import", tmp_path / "out", "--lake", copy, "--json")
    assert answer.status == 0, answer.err
    grasps = "SELECT grasp_id, peak_force_n FROM grasps WHERE status = 'ok' ORDER BY 1"
    original, copied = Lake.open(ADDRESS).query(grasps), Lake.open(copy).query(grasps)
    assert copied.column("grasp_id") == original.column("grasp_id")


def test_compact_check_and_stats(fast, there):
    n_before = len(there.keys(ADDRESS))
    counts = fast("sql", "SELECT count(*) AS n, max(peak_force_n) AS peak FROM grasp_summary", "--format", "json").json
    assert any(row["n_files_after"] < row["n_files_before"] for row in fast("lake", "compact", "--json").json)
    assert len(there.keys(ADDRESS)) < n_before
    assert fast("lake", "check").out == "every file of the lake is whole.\n"
    stats = {row["table"]: row for row in fast("lake", "stats", "--json").json}
    assert stats["grasps"]["n_rows"] == counts[0]["n"]
    assert (
        counts
        == fast("sql", "SELECT count(*) AS n, max(peak_force_n) AS peak FROM grasp_summary", "--format", "json").json
    )


def test_lineage_report_and_recording(fast, tmp_path, no_figures):
    grasp_id = Lake.open(ADDRESS).query("SELECT grasp_id FROM grasps LIMIT 1")["grasp_id"][0].as_py()
    assert NAME in fast("lake", "lineage", grasp_id).out
    fast("report", NAME)
    pages = list(Lake.open(ADDRESS).root.glob("outputs/*/report/index.html"))
    assert len(pages) == 1  # in the working folder, as what a person reads is in a lake that is a folder
    fast("view", grasp_id, "--save", tmp_path / "grasp.rrd")
    assert (tmp_path / "grasp.rrd").stat().st_size > 0


def test_a_campaign_waits_for_its_print(there, capsys, tmp_path):
    waiting, fast = f"{ADDRESS}-waiting", Fast(capsys)
    proposed_lake(tmp_path, waiting)
    assert fast("campaign", "status", "--lake", waiting, "--json").json["campaign"] == "quick"
    with exclusive(Lake.open(waiting).storage, "campaign-quick", "busy"):
        assert is_held(Lake.open(waiting).storage, "campaign-quick")
        assert fast("campaign", "pause", "--lake", waiting).status == 0
    answer = fast("print", "confirm", "quick/B01", "--operator", "A. Person", "--lake", waiting)
    assert answer.status == 0, answer.err
    assert Lake.open(waiting).ids(ToolRow)


def test_doctor_writes_to_the_bucket(there, capsys, monkeypatch):
    assert lake_check(ADDRESS) == (True, f"{ADDRESS} can be read and written")
    assert lake_check(f"{ADDRESS}-none")[1] == f"none yet at {ADDRESS}-none; `fast campaign run` makes one"
    assert lake_check("s3://no-bucket/lab")[1].endswith("(there is no such bucket): make it, or give another --lake.")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "wrong")
    assert "could not be read (access denied)" in lake_check(ADDRESS)[1]


def test_the_next_commands_can_be_typed(there):
    data = {"campaign": NAME, "best_tool": None, "tools": [], "report": "report/index.html"}
    tries = [line.split("  ")[2] for line in campaign._next_lines(data, Path(ADDRESS))[2:4]]
    assert tries == [f"fast view {NAME} --lake {ADDRESS}", f'fast sql "FROM tool_quality" --lake {ADDRESS}']


def lake_check(address: str) -> tuple[bool, str]:
    found = doctor._lake(Path(address))
    return found.ok, found.note


@pytest.mark.study
@pytest.mark.timeout(600)
def test_a_campaign_killed_and_continued_measures_every_grasp_once(there, tmp_path):
    write_config(tmp_path)
    config = tmp_path / "tiny.toml"
    config.write_text(TINY)
    address = f"{ADDRESS}-tiny"
    command = [
        sys.executable,
        "-m",
        "fast.flows.cli.main",
        "campaign",
        "run",
        str(config),
        "--auto-print",
        "--lake",
        address,
    ]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    first = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    deadline = time.monotonic() + 200
    while not (Lake.exists(address) and Lake.open(address).ids(GraspRow)):
        assert first.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.5)
    first.kill()
    first.communicate()
    before = {row["grasp_id"]: row["created_at"] for row in Lake.open(address).rows(GraspRow)}
    second = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=400)
    assert second.returncode == 0, second.stderr
    lake = Lake.open(address)
    after = {row["grasp_id"]: row["created_at"] for row in lake.rows(GraspRow, status="ok")}
    assert before.items() <= after.items()
    assert len(after) == 4 * 2 * 2
    assert (lake.root / "outputs" / "tiny" / "report" / "index.html").is_file()
    assert check(lake) == []


def test_an_unknown_name_names_the_address(there, capsys):
    refused = Fast(capsys).refused("lake", "lineage", "nothing", "--lake", ADDRESS)
    assert f"No row of {ADDRESS} has the id `nothing`" in refused
