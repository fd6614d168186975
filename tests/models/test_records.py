"""Ids of records are of what they mean, not of how it was written."""

from models.records import GraspSetup


def test_a_setup_has_one_id_however_its_numbers_are_written() -> None:
    default = GraspSetup()
    assert GraspSetup(closed_gap_mm=16.0, open_gap_mm=70).setup_id == default.setup_id
    assert GraspSetup.model_validate_json(default.model_dump_json()).setup_id == default.setup_id
    assert GraspSetup(closed_gap_mm=16.5).setup_id != default.setup_id
