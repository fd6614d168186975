"""`fast gap next`: the plan of what is asked for, and its answer, which is checked before anything is written."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fast.flows.cli.main import run
from fast.lake.handoff.export_folder import export_handoff
from fast.lake.handoff.import_folder import import_handoff
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ToolRow
from fast.models.errors import UsageError
from fast.models.records import GraspRequest, GraspSetup, Placement
from fast.tasks.bench.asked import read_open_requests, write_requests
from tests.lake.query import query_lake

TOOLS, OBJECT = ("quick/B01T0", "quick/B02T0"), 6
FASTER = GraspSetup(lift_speed_mm_per_s=20.0, dwell_s=2.0)
ASKED = [
    GraspRequest(tool_id=tool_id, object_id=OBJECT, setup=setup, placement=placement, purpose="lag or shift")
    for tool_id in TOOLS
    for setup, placement in ((FASTER, Placement()), (GraspSetup(), Placement(offset_x_mm=2.0)))
]


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    made = Lake.open(tmp_path / "lake", create=True)
    query_lake.build(made)
    grasps = made.query("SELECT DISTINCT tool_id, batch, slot, design_id FROM grasps ORDER BY 1").to_pylist()
    tools = [ToolRow(campaign_id="quick", status="printed", confirmed_by="person", **row) for row in grasps]
    made.append(tools, current_provenance())
    write_requests(made, "A1", ASKED, "quick", current_provenance())
    return made


@pytest.fixture
def answer(lake: Lake, tmp_path: Path) -> Callable[..., Path]:
    """Write the plan, and the samples beside it as a person would; `change` alters rows of grasps.csv before."""

    def write(change: Callable[[list[dict[str, str]]], None] = lambda rows: None) -> Path:
        folder = tmp_path / "plan"
        assert run(["gap", "next", "--lake", str(lake.root), "--out", str(folder)]) == 0
        with (folder / "grasps.csv").open() as file:
            rows = list(csv.DictReader(file))
        change(rows)
        with (folder / "grasps.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)
        lift_mm = np.linspace(0.0, 20.0, 81)
        lines = [f"{row['grasp_id']},{z / 5 + 1},{z},{9 * np.sin(z / 7)}" for row in rows for z in lift_mm]
        (folder / "traces.csv").write_text("grasp_id,time_s,lift_mm,force_n\n" + "\n".join(lines) + "\n")
        return folder

    return write


def states(lake: Lake) -> list[str]:
    return lake.query("SELECT state FROM asked_grasps ORDER BY place").column(0).to_pylist()


def test_requests_are_numbered_after_what_was_made_and_asked(lake: Lake) -> None:
    more = write_requests(lake, "A2", [ASKED[0], ASKED[0]], "quick", current_provenance())
    assert [one.repeat for one in more] == [4, 5]  # two repeats were made, two asked for by the first search
    assert [request.repeat for request, _ in read_open_requests(lake, search_id="A1")] == [2, 3, 2, 3]
    assert len(read_open_requests(lake, tool_id=TOOLS[1])) == 2


def test_a_plan_is_answered_and_the_lake_has_it_as_asked(lake: Lake, answer: Callable[..., Path]) -> None:
    folder = answer()
    sheet = (folder / "sheet.html").read_text()
    assert sheet.count("Mount tool") == 2
    assert "lift speed 20 mm/s" in sheet
    assert "wait 2 s before the lift" in sheet
    assert "object: offset x 2 mm" in sheet
    assert run(["lake", "import", str(folder), "--lake", str(lake.root)]) == 0
    assert states(lake) == ["made"] * 4
    rows = lake.query("SELECT * FROM grasp_summary WHERE request_id IS NOT NULL ORDER BY tool_id, repeat").to_pylist()
    assert [(row["campaign_id"], row["is_base"], row["offset_x_mm"]) for row in rows] == [
        ("quick", False, 0.0),
        ("quick", False, 2.0),
    ] * 2
    assert read_open_requests(lake) == []
    assert run(["lake", "import", str(folder), "--lake", str(lake.root)]) == 0  # again: nothing new
    assert states(lake) == ["made"] * 4


def test_part_of_an_answer_leaves_the_rest_open(lake: Lake, answer: Callable[..., Path]) -> None:
    import_handoff(lake, answer(lambda rows: rows.__delitem__(slice(2, None))), current_provenance())
    assert states(lake) == ["made", "made", "open", "open"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"request_id": "Iunknown"}, "answers request Iunknown, which this lake does not have"),
        ({"object_id": "2"}, "has object_id 2, its request .* asks for 6"),
        ({"lift_speed_mm_per_s": "5"}, "was made with lift_speed_mm_per_s 5, its request .* asks for 20"),
        ({"offset_x_mm": "1"}, "was made with offset_x_mm 1, its request .* asks for 0"),
        ({"request_id": ""}, "names no request, but 3 others of its folder do"),
        ({"order": "7"}, "was made before .*, the plan asks for it after"),
    ],
)
def test_an_answer_to_something_else_is_refused_and_nothing_is_lost(
    lake: Lake, answer: Callable[..., Path], change: dict[str, str], message: str
) -> None:
    before = lake.ids(GraspRow)
    folder = answer(lambda rows: rows[0].update(change))
    with pytest.raises(UsageError, match=message) as refused:
        import_handoff(lake, folder, current_provenance())
    assert "nothing was imported, the search keeps what it had" in str(refused.value)
    assert lake.ids(GraspRow) == before
    assert states(lake) == ["open"] * 4


@pytest.mark.parametrize("factor", [100.0, 1.0 / 9.81])
def test_an_answer_in_another_unit_is_refused(lake: Lake, answer: Callable[..., Path], factor: float) -> None:
    folder = answer()
    header, *lines = (folder / "traces.csv").read_text().splitlines()
    cells = [line.split(",") for line in lines]
    rows = [",".join([*row[:3], str(factor * float(row[3]))]) for row in cells]
    (folder / "traces.csv").write_text("\n".join([header, *rows]))
    with pytest.raises(
        UsageError, match="times those of the same tools on the same objects before; .* give forces in N"
    ):
        import_handoff(lake, folder, current_provenance())
    assert "ok" not in states(lake)


def test_a_tool_that_is_gone_is_named(lake: Lake, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (row,) = lake.records(ToolRow, tool_id=TOOLS[1])
    lake.append([row.model_copy(update={"status": "rejected", "reason": "broke"})], current_provenance())
    assert run(["gap", "next", "--lake", str(lake.root), "--out", str(tmp_path / "plan")]) == 2
    said = capsys.readouterr().err
    assert f"2 of 4 grasps are asked of tool {TOOLS[1]}, which was rejected (broke); mount it again" in said
    assert not (tmp_path / "plan").exists()


def test_settings_and_requests_survive_export_into_another_lake(
    lake: Lake, answer: Callable[..., Path], tmp_path: Path
) -> None:
    import_handoff(lake, answer(), current_provenance())
    export_handoff(lake, tmp_path / "out")
    other = Lake.open(tmp_path / "other", create=True)
    import_handoff(other, tmp_path / "out", current_provenance())
    columns = "grasp_id, setup_id, offset_x_mm, request_id"
    sql = f"SELECT {columns} FROM grasps WHERE status = 'ok' ORDER BY grasp_id"
    assert other.query(sql).to_pylist() == lake.query(sql).to_pylist()
