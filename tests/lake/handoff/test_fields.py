"""One cell of the hand-off format: each end of a range, and what an empty cell means."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from fast.lake.handoff import fields
from fast.lake.handoff.files import END_FIELDS, SETTING_FIELDS, SIMULATION_FIELDS
from fast.models.design.fin_ray import FinRay


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [
        (END_FIELDS["bench"], "", "real"),
        (END_FIELDS["bench"], "ur5-left", "ur5-left"),
        (fields.lab_name, "", None),
        (fields.lab_name, "a" * 41, "a" * 41),
        (END_FIELDS["world_hash"], "", None),
        (END_FIELDS["world_hash"], "W1", "W1"),
        (END_FIELDS["peak_force_n"], "", None),
        (END_FIELDS["peak_force_n"], "-5", -5.0),
        (END_FIELDS["peak_force_n"], "2000", 2000.0),
        (fields.one_of("nominal", "placed"), "", "nominal"),
        (fields.one_of("nominal", "placed"), "placed", "placed"),
        (fields.integer(0, 9), "0", 0),
        (fields.integer(0, 9), "9.0", 9),
        (fields.integer(1, None), str(2**53), 2**53),
        (fields.number_of(FinRay, "rib_count"), "10", 10),
        (fields.number_of(FinRay, "height_mm"), "120", 120.0),
        (SIMULATION_FIELDS["poisson_ratio"], "", None),
        (SIMULATION_FIELDS["contact_force_n"], "-3.5", -3.5),
        (SETTING_FIELDS["dwell_s"], "", None),
        (SETTING_FIELDS["offset_x_mm"], "-1", -1.0),
        (fields.one_of_designs({"D1"}), "D1", "D1"),
        (fields.fidelity, "sim", "sim"),
        (fields.time, "", None),
        (fields.time, "2026-03-01T14:05:00", datetime(2026, 3, 1, 14, 5, tzinfo=UTC)),
        (fields.time, "2000-01-01T01:00:00+01:00", datetime(2000, 1, 1, tzinfo=UTC)),
    ],
)
def test_a_cell_has_its_value(read: Any, text: str, value: object) -> None:
    assert read(text) == value


@pytest.mark.parametrize(
    ("read", "text", "limit"),
    [
        (END_FIELDS["bench"], "UR 5", "must be virtual, real, or a name of at most 41 of a-z, 0-9 and -."),
        (fields.lab_name, "a" * 42, "must be a name of at most 41 of a-z, 0-9 and -, or empty."),
        (END_FIELDS["world_hash"], "W 1", "must be a hash of letters and digits, or empty."),
        (END_FIELDS["peak_force_n"], "2000.1", "must be a number from -5 to 2000 N; look at unit and sign."),
        (END_FIELDS["peak_force_n"], "-5.1", "must be a number from -5 to 2000 N; look at unit and sign."),
        (END_FIELDS["peak_force_n"], "1_0", "must be a number from -5 to 2000 N; look at unit and sign."),
        (END_FIELDS["peak_force_n"], "nan", "must be a number from -5 to 2000 N; look at unit and sign."),
        (fields.one_of("nominal", "placed"), "off", "must be nominal or placed, or empty for nominal."),
        (fields.integer(0, 9), "10", "must be an integer from 0 to 9."),
        (fields.integer(0, 9), "0.5", "must be an integer from 0 to 9."),
        (fields.integer(1, None), "0", "must be an integer of at least 1."),
        (fields.integer(1, None), str(2**53 + 2), f"must be an integer of at most {2**53}."),
        (fields.number_of(FinRay, "rib_count"), "2.5", "must be an integer, at least 1 and at most 10."),
        (SIMULATION_FIELDS["contact_force_n"], "inf", "must be a finite number, in N."),
        (fields.one_of_designs({"D1"}), "D2", "must be a design_id of designs.csv, or of a design in the lake."),
        (fields.fidelity, "", "must be `real` or `sim`."),
        (fields.time, "1999-12-31T23:59:59Z", "must be from 2000 to now; correct the date, or leave it empty."),
        (fields.time, "soon", "must be an ISO 8601 time such as 2026-03-01T14:05:00+00:00, or empty."),
    ],
)
def test_what_is_beyond_a_limit_is_told_with_it(read: Any, text: str, limit: str) -> None:
    with pytest.raises(ValueError, match="must be") as error:
        read(text)
    assert str(error.value) == limit


def test_clocks_of_two_labs_may_differ_by_a_day() -> None:
    now = datetime.now(UTC)
    assert fields.time((now + timedelta(hours=23)).isoformat()) is not None
    with pytest.raises(ValueError, match="to now"):
        fields.time((now + timedelta(hours=25)).isoformat())


@pytest.mark.parametrize(("name", "low", "high"), [("young_modulus_mpa", "0.49", "0.5"), ("friction", "-0.01", "0.01")])
def test_theta_keeps_the_bounds_of_its_record(name: str, low: str, high: str) -> None:
    read = SIMULATION_FIELDS[name]
    assert read(high) == float(high)
    with pytest.raises(ValueError, match=r"^must be a number, "):
        read(low)
