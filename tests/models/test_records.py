"""Ids of records are of what they mean, not of how it was written; names are spelled for people."""

import numpy as np
import pandas as pd
import pytest

from fast.models.design.space import BEST_PUBLISHED, from_unit, to_unit
from fast.models.errors import UsageError
from fast.models.records import GraspSetup, Trace
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


def test_a_trace_takes_lists_and_columns_and_shows_how_long_it_is() -> None:
    trace = Trace([0, 1, 2], pd.Series([0, 0, 3]), (0, 1.5, 2))
    assert [channel.dtype for channel in (trace.time_s, trace.lift_mm, trace.force_n)] == [np.float64] * 3
    assert trace.is_lift.tolist() == [False, True, True]
    assert repr(trace) == "Trace(3 samples, lift_mm to 3.0)"
    with pytest.raises(UsageError, match="differ in shape"):
        Trace([0, 1], [0, 1], [0])


def test_what_is_no_point_or_design_of_the_space_is_named() -> None:
    point = to_unit([BEST_PUBLISHED])
    with pytest.raises(UsageError, match=r"shape \(1, 10\), the last axis must be the 9 parameters length_mm"):
        from_unit(np.hstack([point, [[1.0]]]))
    with pytest.raises(UsageError, match="not finite numbers"):
        from_unit(np.full((1, 9), np.nan))
    with pytest.raises(UsageError, match=r"points have the value 29\.68, each must be from 0 to 1"):
        from_unit(np.hstack([point[:, :8], [[29.68]]]))
    rounded = np.where(np.arange(9) % 2, 1 + 1e-12, -1e-12)
    assert from_unit(rounded[None]) == from_unit(np.round(rounded)[None])
    with pytest.raises(UsageError, match="designs are of type FinRay; give a list of designs"):
        to_unit(BEST_PUBLISHED)  # type: ignore[arg-type]  # a record is a sequence of its fields
