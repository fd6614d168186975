"""`fast gantry log` and `fast gantry replay`."""

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from fast.hardware.wire.log import WireLog
from fast.hardware.wire.log_files import GANTRY, PLC, WireFiles
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.tasks.campaign.campaign import stored_provenance
from fast.tasks.campaign.requests import bench_log_folder
from tests.flows.cli.cli_lakes import ROOT, WORLD, Fast, proposed_lake

DATA = ROOT / "tests" / "data" / "wire"


@pytest.fixture
def fast(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return Fast(capsys)


def test_a_recorded_session_is_replayed(fast):
    answer = fast("gantry", "replay", DATA / "gantry.log")
    assert answer.status == 0, answer
    assert "pieces were sent as recorded" in answer.out
    assert fast("gantry", "replay", DATA / "plc.log", "--json").json["difference"] is None


def test_a_difference_is_shown_with_both_sides_and_its_time(fast, tmp_path):
    path = tmp_path / "field.log"
    path.write_text((DATA / "gantry.log").read_text().replace("> b'$I\\n'", "> b'$N\\n'"))
    answer = fast("gantry", "replay", path)
    assert answer.status == 1
    for words in ("first difference at", "while connecting", "24 4e 0a   b'$N\\n'", "24 49 0a   b'$I\\n'", "+00:00"):
        assert words in answer.out
    data = fast("gantry", "replay", path, "--json").json
    assert data["difference"]["recorded_hex"] == "24 4e 0a"
    assert data["difference"]["sent_hex"] == "24 49 0a"


def test_what_is_no_log_is_refused(fast, tmp_path):
    assert "is no wire log" in fast.refused("gantry", "replay", WORLD)
    assert "cannot be read" in fast.refused("gantry", "log", tmp_path / "none.log")
    assert "--grasp needs --lake" in fast.refused("gantry", "log", "--grasp", "K1")


def test_a_bench_moved_by_hand_leaves_logs_of_all_devices(fast, tmp_path):
    assert fast("gantry", "log").out == f"no wire logs in {tmp_path / 'state' / 'fast' / 'bench-log'}\n"
    assert fast("gantry", "home", "--world", WORLD).status == 0
    rows = fast("gantry", "log", "--json").json
    assert sorted(row["device"] for row in rows) == ["gantry", "load-cell", "plc"]
    path = next(row["file"] for row in rows if row["device"] == "gantry")
    assert "> b'$H\\n'" in fast("gantry", "log", path).out
    assert len(fast("gantry", "log", path, "--last", "3").out.splitlines()) == 3
    times = [row["time_s"] for row in fast("gantry", "log", path, "--json").json]
    cut = fast("gantry", "log", path, "--from-s", times[2], "--until-s", times[5], "--json").json
    assert [row["time_s"] for row in cut] == [time_s for time_s in times if times[2] <= time_s <= times[5]]
    assert fast("gantry", "replay", path).status == 0


def grasp_row(grasp_id, details):
    return GraspRow(
        grasp_id=grasp_id, campaign_id="quick", tool_id="quick/B01T0", design_id="D1", object_id=2, repeat=0,
        status="failed", reason="x", started_at=datetime.now(UTC), setup_id="S", setup_json="{}", bench="virtual",
        details_json=json.dumps(details),
    )  # fmt: skip


def test_a_grasp_leads_to_its_bytes(fast, tmp_path):
    root = proposed_lake(tmp_path)
    lake = Lake.open(root)
    times = iter([10.0, 11.0, 10.5, 30.0])
    gantry, plc = WireLog(now_s=lambda: next(times)), WireLog(now_s=lambda: next(times))
    with WireFiles(Path(bench_log_folder(lake))) as files:
        for log, device, words in ((gantry, GANTRY, (b"G1", b"ok")), (plc, PLC, (b"lock", b"later"))):
            files.follow(log, device, "somewhere")
            for word in words:
                log.record("sent", word)
    details = {"wire_log": files.session, "wire_from_s": 9.5, "wire_until_s": 12.0}
    rows = [grasp_row("K1", details), grasp_row("K2", {}), grasp_row("K3", {**details, "wire_log": "gone"})]
    lake.append(rows, stored_provenance(lake, "quick"))
    lake.close()
    said = fast("gantry", "log", "--lake", root, "--grasp", "K1").out.splitlines()
    assert said == ["10.000000 gantry    > b'G1'", "10.500000 plc       > b'lock'", "11.000000 gantry    > b'ok'"]
    assert "has no grasp `K9`" in fast.refused("gantry", "log", "--lake", root, "--grasp", "K9")
    for grasp_id in ("K2", "K3"):
        said = fast.refused("gantry", "log", "--lake", root, "--grasp", grasp_id)
        assert "not kept, or removed to make room" in said
