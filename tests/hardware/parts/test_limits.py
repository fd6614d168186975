"""The ends of a bench's limits are allowed, what lies beyond is refused."""

import pytest

from fast.hardware.parts.limits import BenchLimits
from fast.models.errors import UsageError
from fast.models.records import GraspSetup, Placement

LIMITS = BenchLimits(offset_x_mm=(-3.0, 4.0), dwell_s=(1.0, 8.0))


@pytest.mark.parametrize(("dwell_s", "offset_x_mm"), [(1.0, 0.0), (8.0, 0.0), (1.0, -3.0), (1.0, 4.0)])
def test_ends_are_allowed(dwell_s: float, offset_x_mm: float) -> None:
    LIMITS.check(GraspSetup(dwell_s=dwell_s), Placement(offset_x_mm=offset_x_mm))


@pytest.mark.parametrize(
    ("dwell_s", "offset_x_mm", "named"),
    [(0.99, 0.0, "dwell_s"), (8.01, 0.0, "dwell_s"), (1.0, -3.01, "offset_x_mm"), (1.0, 4.01, "offset_x_mm")],
)
def test_what_is_beyond_is_refused_by_name(dwell_s: float, offset_x_mm: float, named: str) -> None:
    with pytest.raises(UsageError, match=named):
        LIMITS.check(GraspSetup(dwell_s=dwell_s), Placement(offset_x_mm=offset_x_mm))


def test_jaws_must_close() -> None:
    with pytest.raises(UsageError):
        BenchLimits(dwell_s=(0.0, 8.0)).check(GraspSetup(open_gap_mm=20.0, closed_gap_mm=20.0))
