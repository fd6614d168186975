"""What the study of the page's pace makes of the times that it saw."""

import pytest

from tests.studies.platform.page_pace import Pace, summarise


def test_first_grasps_are_left_out_and_the_difference_has_an_interval():
    near, far = ("B01T0", 2), ("B01T0", 30)
    first = [Pace(60.0, near, True, 0), Pace(90.0, near, True, 20)]
    paces = [
        Pace(14.0 + 0.1 * (n % 2) + 4.0 * (cell == far), cell, False, 0) for cell in (near, far) for n in range(10)
    ]
    paces += [
        Pace(14.7 + 0.1 * (n % 2) + 4.0 * (cell == far), cell, False, 20) for cell in (near, far) for n in range(10)
    ]
    found = summarise(first + paces)
    assert (found["grasps_without"], found["grasps_with"]) == (20, 20)
    assert found["slower_percent"] == pytest.approx(100 * 0.7 / 16.4)
    assert found["slower_percent_low"] < found["slower_percent"] < found["slower_percent_high"]
    assert found["slower_percent_high"] - found["slower_percent_low"] < 1.0
