"""Labs side by side: which grasps are compared, and what counts as one finger in two labs."""

from pathlib import Path

import pytest

from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.lake.tables.requests import setup_columns
from fast.models.errors import UsageError
from fast.models.records import GraspSetup
from fast.tasks.traces.labs import read_labs
from tests.tasks.calibration.calibration_lake import PROVENANCE


def grasp(lab: str, tool: str, design: str, repeat: int, dwell_s: float = 0.0) -> GraspRow:
    return GraspRow(
        grasp_id=GraspRow.make_id(tool, 3, repeat, lab=lab),
        campaign_id=lab,
        tool_id=tool,
        design_id=design,
        object_id=3,
        repeat=repeat,
        status="ok",
        peak_force_n=20.0 + repeat,
        bench="virtual",
        lab=lab,
        **setup_columns(GraspSetup(dwell_s=dwell_s)),
    )


def lake_of(root: Path, *rows: GraspRow) -> Lake:
    lake = Lake.open(root, create=True)
    lake.append(rows, PROVENANCE)
    return lake


def test_a_tool_that_travelled_is_itself_and_others_are_their_designs(tmp_path: Path) -> None:
    """T1 went from A to B; of design D2 each lab printed its own tool; D3 is in one lab alone."""
    rows = [grasp(lab, "T1", "D1", repeat) for lab in "AB" for repeat in range(2)]
    rows += [grasp("A", "T2", "D2", 0), grasp("B", "T3", "D2", 0), grasp("A", "T4", "D3", 0)]
    rows += [grasp("A", "T1", "D1", repeat, dwell_s=2.0) for repeat in range(2, 5)]
    found = read_labs(lake_of(tmp_path / "lake", *rows))
    assert {finger for finger, _ in found.compared.means_n} == {"T1", "D2"}
    assert (found.n_travelled, found.n_printed, found.n_left_out) == (1, 1, 3)


def test_labs_without_a_common_finger_are_told_how_to_get_one(tmp_path: Path) -> None:
    lake = lake_of(tmp_path / "lake", grasp("A", "T1", "D1", 0), grasp("B", "T2", "D2", 0))
    with pytest.raises(UsageError, match=r"\(labs with grasps: A, B\); bring the other lab's data"):
        read_labs(lake)
    with pytest.raises(UsageError, match=r"\(labs with grasps: none\)"):
        read_labs(Lake.open(tmp_path / "empty", create=True))
