"""Ids of records are of what they mean, not of how it was written; names are spelled for people."""

from fast.models.records import GraspSetup
from fast.models.units import spell_name


def test_a_setup_has_one_id_however_its_numbers_are_written() -> None:
    default = GraspSetup()
    assert GraspSetup(closed_gap_mm=16.0, open_gap_mm=70).setup_id == default.setup_id
    assert GraspSetup.model_validate_json(default.model_dump_json()).setup_id == default.setup_id
    assert GraspSetup(closed_gap_mm=16.5).setup_id != default.setup_id


def test_a_name_is_spelled_with_or_without_its_unit():
    assert spell_name("rib_angle_deg") == "rib angle"
    assert spell_name("rib_angle_deg", with_unit=True) == "rib angle (deg)"
    assert spell_name("rib_count", with_unit=True) == "rib count"
    assert spell_name("slope_n_per_mm", with_unit=True) == "slope (N/mm)"
