"""Grasps at other setups and grasps that a search asked for: they stand in the lake and change no tool's quality."""

from pathlib import Path
from typing import Any

import pytest

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.lake.tables.requests import GraspRequestRow, setup_columns
from fast.models.records import GraspRequest, GraspSetup, Placement
from tests.lake.query import query_lake

TOOL, OBJECT = "quick/B01T0", 6
FASTER = GraspSetup(lift_speed_mm_per_s=20.0)
ASIDE = Placement(offset_y_mm=2.0)
REQUESTS = [
    GraspRequest(tool_id=TOOL, object_id=OBJECT, setup=FASTER, purpose="lag or shift"),
    GraspRequest(tool_id=TOOL, object_id=OBJECT, placement=ASIDE, purpose="lag or shift"),
    GraspRequest(tool_id=TOOL, object_id=OBJECT, purpose="lag or shift"),
]


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    made = Lake.open(tmp_path / "lake", create=True)
    query_lake.build(made)
    made.append([GraspRequestRow.of("A1", place, one) for place, one in enumerate(REQUESTS)], current_provenance())
    return made


def answer(lake: Lake, request: GraspRequest, request_id: str, /, **changes: Any) -> GraspRow:
    """A grasp of 99 N as a request asks for it."""
    (row,) = lake.records(GraspRow, grasp_id=GraspRow.make_id(TOOL, OBJECT, 0))
    grasp_id = GraspRow.make_id(TOOL, OBJECT, request.repeat, changes.get("attempt", 0), request_id)
    how = setup_columns(request.setup, request.placement)
    more = {"grasp_id": grasp_id, "peak_force_n": 99.0, "request_id": request_id, **how, **changes}
    return row.model_copy(update=more)


def test_asked_grasps_are_valid_and_change_no_quality(lake: Lake) -> None:
    sql = "SELECT n_grasps, tool_quality_n FROM tool_quality ORDER BY tool_id"
    before = lake.query(sql).to_pylist()
    asked = lake.records(GraspRequestRow)
    lake.append([answer(lake, row.request, row.request_id) for row in asked], current_provenance())
    elsewhere = answer(lake, REQUESTS[0], "", grasp_id="Kfaster").model_copy(update={"request_id": None})
    lake.append([elsewhere], current_provenance())
    assert lake.query(sql).to_pylist() == [pytest.approx(row) for row in before]
    sql = "SELECT is_valid, is_base, offset_y_mm FROM grasp_summary WHERE peak_force_n = 99"
    found = lake.query(sql).to_pylist()
    assert [row["is_valid"] for row in found] == [True] * 4
    assert not any(row["is_base"] for row in found)
    assert sorted(row["offset_y_mm"] for row in found) == [0.0, 0.0, 0.0, 2.0]
    setups = lake.query("FROM campaign_setups ORDER BY n_grasps DESC").to_pylist()
    assert [(row["is_base"], row["lift_speed_mm_per_s"], row["offset_y_mm"]) for row in setups] == [
        (True, 5.0, 0.0),
        (False, 20.0, 0.0),
        (False, 5.0, 2.0),
    ]


def test_requests_come_back_as_they_were_asked(lake: Lake) -> None:
    found = [row.request for row in sorted(lake.records(GraspRequestRow), key=lambda row: row.place)]
    assert [one.model_copy(update={"request_id": ""}) for one in found] == REQUESTS
    assert len({one.request_id for one in found}) == 3


def test_a_request_is_open_until_it_is_made_or_failed_twice(lake: Lake) -> None:
    def states() -> list[str]:
        return lake.query("SELECT state FROM asked_grasps ORDER BY place").column(0).to_pylist()

    def failed(place: int, **changes: Any) -> GraspRow:
        request_id = GraspRequestRow.make_id("A1", place)
        return answer(lake, REQUESTS[place], request_id, status="failed", peak_force_n=None, **changes)

    assert states() == ["open"] * 3
    lake.append([answer(lake, REQUESTS[0], GraspRequestRow.make_id("A1", 0)), failed(1)], current_provenance())
    assert states() == ["made", "open", "open"]
    lake.append([failed(1, attempt=1)], current_provenance())
    lake.append([failed(2, attempt=n, details_json='{"end":"bench_fault"}') for n in range(2)], current_provenance())
    assert states() == ["made", "given up", "open"]
