"""What a grasp says when it ends: inside the band of the simulator or not, like its repeats or not."""

import pytest

from fast.models.traces.verdict import judge_grasp

GAPS_N = [-1.0, -0.5, 0.0, 0.5, 1.0, 0.2, -0.2, 0.4, -0.4, 0.1, 2.0]


def test_the_band_holds_nine_of_ten_gaps():
    inside = judge_grasp(10.9, 10.0, GAPS_N, [], None)
    assert inside.sentence == "10.9 N; simulated 10.0 N, inside the band of ±1.0 N"
    assert not inside.is_strange
    outside = judge_grasp(8.5, 10.0, GAPS_N, [], None)
    assert "outside the band of ±1.0 N" in outside.sentence
    assert outside.is_strange


def test_without_enough_gaps_there_is_no_band():
    few = judge_grasp(30.0, 10.0, GAPS_N[:4], [], None)
    assert few.sentence == "30.0 N; simulated 10.0 N"
    assert not few.is_strange


@pytest.mark.parametrize(("peak_n", "is_strange"), [(9.2, False), (10.1, False), (11.0, True), (7.5, True)])
def test_repeats_are_compared_with_the_spread_of_all_repeats(peak_n, is_strange):
    verdict = judge_grasp(peak_n, None, [], [9.0, 9.4], 0.3)
    assert verdict.is_strange is is_strange
    assert ("not like its repeats (9.0 and 9.4 N)" in verdict.sentence) is is_strange
